"""How the error of the motor's angle grows: with time or with the angle, by the last parities."""

from __future__ import annotations

from typing import Annotated

from gateway_fdi.jit import Record, f8s, i8, kernel, means

#: Parities that are kept, and those needed at least.
HISTORY, LEAST = 64, 16
#: Share of what a slope makes of all parities from which on one step of them is no growth.
STEP = 0.5
#: How an error grows.
UNKNOWN, WITH_TIME, WITH_ANGLE = range(3)


class State(Record):
    """State: the last parities, with the motor's angle."""

    at: i8 = means("place of the next one")
    held: i8 = means("parities that there are")
    parity: Annotated[f8s, HISTORY] = means("parity of the gear", "deg")
    motor: Annotated[f8s, HISTORY] = means("motor angle", "deg")


@kernel
def keep(s: State, parity: float, motor: float) -> None:
    """Keep a parity [deg] with the motor's angle [deg]."""
    s.parity[s.at] = parity
    s.motor[s.at] = motor
    s.at = (s.at + 1) % HISTORY
    s.held = min(s.held + 1, HISTORY)


@kernel
def growth(s: State) -> int:
    """Tell by regression whether the parity grows with time, with the angle, or neither can be told."""
    n = s.held
    if n < LEAST:
        return UNKNOWN
    t = p = tt = tp = pp = mm = mp = mean_m = largest = 0.0
    for k in range(n):
        j = (s.at - n + k) % HISTORY
        y, x = s.parity[j], s.motor[j]
        t += k
        p += y
        tt += k * k
        tp += k * y
        pp += y * y
        mm += x * x
        mp += x * y
        mean_m += x
        if k > 0:
            largest = max(largest, abs(y - s.parity[(j - 1) % HISTORY]))
    spread_t = tt - t * t / n
    slope = (tp - t * p / n) / spread_t
    around = max(pp - p * p / n, 0.0)
    with_time = max(around - slope * slope * spread_t, 0.0)
    with_angle = max(pp - mp * mp / mm, 0.0) if mm > 0.0 else pp
    moving = mm - mean_m * mean_m / n > 1e-3 * mm + n * 400.0  # more than 20 deg of the motor
    floor = n * 1.5e-3  # of quantisation and lash [deg^2]
    if moving and with_angle < 0.5 * with_time + floor and with_angle < 0.5 * around:
        return WITH_ANGLE
    stepped = largest > STEP * abs(slope) * n  # by far more than in any other interval: nobody saw it begin
    if not stepped and with_time < 0.6 * with_angle and with_time < 0.5 * around + floor:
        return WITH_TIME
    return UNKNOWN
