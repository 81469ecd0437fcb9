"""When the model of T3, T4 and T7 holds, told from the bus: the clutch holds, and the engine is above idle.

Paper 004, VI-B: the clutch's model is known only while it is engaged. Slip and engine speed are low-pass filtered; the
slip's filter begins anew with each gear. What has held for 0.3 s holds. A clutch that creeps has little slip, too, but
it has it for long: a second, slow filter tells it from noise, and whether it still changes. T7 waits for that; T3 and
T4 are the paper's.

In a low gear noise hides the end of the creeping: the gearbox's speed counts by the ratio. But a slip that dies away
takes about as long below what can be seen as it took above, and the same clutch takes as long the next time. T7 waits
for that, too, behind each gear change; the clutch is that of the bus then, and not the model's.

The speed that states begin with, (37) and (38), is low-pass filtered too. A first-order low-pass lags behind a ramp by
its time constant, and the state keeps that: LP + (LP - LP(LP)) does not.
"""

from __future__ import annotations

from math import exp

from gateway_fdi.jit import Record, f8, i8, kernel, means

#: Time constants [s] of slip and engine speed, and of the speed that states begin with.
SLIP, START = 0.05, 0.07
#: Greatest slip [rad/s], least engine speed [rad/s], time to settle [s], clutch that is engaged.
MOST_SLIP, LEAST_SPEED, SETTLES, ENGAGED = 3.0, 66.0, 0.3, 0.995
#: Slip at which a clutch that holds lets go, and the speed below which the engine does: noise of either opens no window
#: anew.
LETS_GO, STALLS = 9.0, 64.0


#: Time constants of the slow filters of the slip [s]; greatest slip that a sensor's error explains [rad/s], and once
#: the slip of a clutch that holds has been seen for some seconds; greatest change [rad/s2]; what lets it go again, in
#: these.
SLOW, SLOWER = 0.25, 0.5
CREEPS, KNOWN, CHANGES, AGAIN = 1.0, 0.3, 1.0, 1.5
#: Times as long as its slip could be seen, for which a clutch is thought to creep; no longer than that [s]; a pause in
#: which it is not seen that does not end it [s]; what is kept of it from one gear to the next.
GOES_ON, LONGEST, PAUSE, KEEPS = 2.0, 8.0, 0.7, 0.9
#: Time in which a clutch has held, before its slip is that of a clutch that holds; and time of it until that is known
#: [s].
STEADY, LEARNED = 3.0, 5.0
#: Noise of the slow slip by ratio: three standard deviations of the gearbox's speed (0.2 rad/s at 100 Hz), filtered
#: [rad/s].
NOISE = 0.1


class State(Record):
    """State."""

    slip: f8 = means("slip, filtered", "rad/s")
    slow: f8 = means("slip, filtered for longer", "rad/s")
    slower: f8 = means("slow, filtered again", "rad/s")
    zero: f8 = means("slip of a clutch that holds", "rad/s")
    learned: f8 = means("time in which zero was found", "s")
    closed: f8 = means("time since the clutch closed last", "s")
    creeps: f8 = means("time since then, until which it was seen to creep", "s")
    usual: f8 = means("creeps, behind the gear changes before", "s")
    speed: f8 = means("speed of the engine, filtered", "rad/s")
    since: f8 = means("for how long the model has held", "s")
    gear: i8 = means("gear of the last set")
    low: f8 = means("speed of the gearbox's output, filtered", "rad/s")
    lower: f8 = means("low, filtered again", "rad/s")
    begun: i8 = means("1: there is a set before")


@kernel
def restart(s: State) -> None:
    """Forget what came before a gap."""
    s.begun = 0
    s.since = 0.0


@kernel
def _watch(s: State, closed: bool, far: float, dt: float) -> None:
    """Note for how long a clutch that has closed is seen to creep; ``far``: slip that is some."""
    if not closed:
        if s.closed > 0.0:
            s.usual = max(min(s.creeps, LONGEST), KEEPS * s.usual)
        s.closed = s.creeps = 0.0
        return
    s.closed += dt
    if abs(s.slow - s.zero) > far and s.closed <= s.creeps + PAUSE:
        s.creeps = s.closed


@kernel
def update(s: State, clutch: float, gear: int, ratio: float, engine: float, gearbox: float, dt: float) -> None:
    """Take a set of signals.

    Args:
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
        s.slow = s.slower = slip
        s.slip, s.speed, s.low, s.lower, s.gear = slip, engine, gearbox, gearbox, gear
    if gear != s.gear:
        s.gear = gear
        _watch(s, False, 0.0, dt)
        s.slip = s.slow = s.slower = slip
    share = 1.0 - exp(-dt / SLIP)
    s.slip += share * (slip - s.slip)
    s.speed += share * (engine - s.speed)
    s.slow += (1.0 - exp(-dt / SLOW)) * (slip - s.slow)
    s.slower += (1.0 - exp(-dt / SLOWER)) * (s.slow - s.slower)
    share = 1.0 - exp(-dt / START)
    s.low += share * (gearbox - s.low)
    s.lower += share * (s.low - s.lower)
    held = s.since >= SETTLES
    slips = abs(s.slip) >= (LETS_GO if held else MOST_SLIP)
    if slips:
        s.slow = s.slower = s.slip
    fast = s.speed > (STALLS if held else LEAST_SPEED)
    holds = clutch >= ENGAGED and gear > 0 and fast and not slips
    s.since = s.since + dt if holds else 0.0
    _watch(s, clutch >= ENGAGED and gear > 0, (CREEPS if s.learned < LEARNED else KNOWN) + NOISE * ratio, dt)
    if s.since > STEADY:
        s.learned += dt
        s.zero += dt / min(max(s.learned, 1.0), 20.0) * (slip - s.zero)


@kernel
def grips(s: State, ratio: float, goes_on: bool) -> bool:
    """Tell whether a clutch that holds does not creep.

    Args:
        ratio: of the gear.
        goes_on: it was taken not to creep before.
    """
    most = AGAIN if goes_on else 1.0
    noise = NOISE * ratio
    far = CREEPS if s.learned < LEARNED else KNOWN
    changes = abs(s.slow - s.slower) > most * (CHANGES * SLOWER + noise)
    waits = s.closed < GOES_ON * min(max(s.creeps, s.usual), LONGEST)
    return not (changes or waits or abs(s.slow - s.zero) > most * (far + noise))


@kernel
def valid(s: State) -> bool:
    """Tell whether the model holds."""
    return bool(s.since >= SETTLES)


@kernel
def speed(s: State) -> float:
    """Return the filtered speed of the gearbox's output without the lag of a ramp [rad/s]."""
    return float(2.0 * s.low - s.lower)
