"""When the model of T3 and T4 holds, told from the bus: the clutch holds, and the engine is above idle.

Paper 004, VI-B: the clutch's model is known only while it is engaged. Slip and engine speed are low-pass filtered; the
slip's filter begins anew with each gear. What has held for 0.3 s holds.

The speed that states begin with, (37) and (38), is low-pass filtered too. A first-order low-pass lags behind a ramp by
its time constant, and the state keeps that: LP + (LP - LP(LP)) does not.
"""

from __future__ import annotations

from math import exp

from gateway.jit import Record, f8, i8, kernel

#: Time constants [s] of slip and engine speed, and of the speed that states begin with.
SLIP, START = 0.05, 0.07
#: Greatest slip [rad/s], least engine speed [rad/s], time to settle [s], clutch that is engaged.
MOST_SLIP, LEAST_SPEED, SETTLES, ENGAGED = 3.0, 66.0, 0.3, 0.995
#: Slip at which a clutch that holds lets go, and the speed below which the engine does: noise of either opens no window
#: anew.
LETS_GO, STALLS = 9.0, 64.0


class State(Record):
    """State."""

    slip: f8
    speed: f8
    since: f8
    gear: i8
    low: f8
    lower: f8
    begun: i8


@kernel
def restart(s: State) -> None:
    """Forget what came before a gap."""
    s.begun = 0
    s.since = 0.0


@kernel
def update(s: State, clutch: float, gear: int, ratio: float, engine: float, gearbox: float, dt: float) -> None:
    """Take a set of signals.

    Args:
        s: state.
        clutch: 0 to 1.
        gear: 0 is neutral.
        ratio: of the gear.
        engine: speed of the engine [rad/s].
        gearbox: speed of the gearbox's output [rad/s].
        dt: since the set before [s].
    """
    slip = engine - ratio * gearbox
    if s.begun == 0:
        s.begun = 1
        s.slip, s.speed, s.low, s.lower, s.gear = slip, engine, gearbox, gearbox, gear
    if gear != s.gear:
        s.gear = gear
        s.slip = slip
    share = 1.0 - exp(-dt / SLIP)
    s.slip += share * (slip - s.slip)
    s.speed += share * (engine - s.speed)
    share = 1.0 - exp(-dt / START)
    s.low += share * (gearbox - s.low)
    s.lower += share * (s.low - s.lower)
    held = s.since >= SETTLES
    slips = abs(s.slip) >= (LETS_GO if held else MOST_SLIP)
    fast = s.speed > (STALLS if held else LEAST_SPEED)
    holds = clutch >= ENGAGED and gear > 0 and fast and not slips
    s.since = s.since + dt if holds else 0.0


@kernel
def valid(s: State) -> bool:
    """Tell whether the model holds."""
    return bool(s.since >= SETTLES)


@kernel
def speed(s: State) -> float:
    """Return the filtered speed of the gearbox's output without the lag of a ramp [rad/s]."""
    return float(2.0 * s.low - s.lower)
