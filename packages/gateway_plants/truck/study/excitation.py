"""When a dynamic test is updated: while a fault, if it is there, shows in the residual (paper 004, VI-D).

From the start of a residual generator at t0 on:

- (39): t > t0 + t_d;
- (41): |int u_gb I_em eta^sign(I_em) dt| > J_1, for faults whose internal form (40) is that integral;
- (45): int u_gb |I_em| eta^sign(I_em) dt > J_2, for those that drift the same way as motor and as generator.
"""

from __future__ import annotations

from gateway_fdi.jit import Record, f8, kernel, means

#: The conditions, by their place.
FIXED, SIGNED, ABSOLUTE = range(3)


class Const(Record):
    """Constants."""

    after: f8 = means("t_d of (39)", "s")
    signed: f8 = means("J_1 of (41)", "A s")
    absolute: f8 = means("J_2 of (45)", "A s")
    efficiency: f8 = means("efficiency of the machine")


class State(Record):
    """State."""

    time: f8 = means("since the generator began", "s")
    signed: f8 = means("integral of (41)", "A s")
    absolute: f8 = means("integral of (45)", "A s")


@kernel
def restart(s: State) -> None:
    """Begin with the residual generator."""
    s.time, s.signed, s.absolute = 0.0, 0.0, 0.0


@kernel
def update(s: State, c: Const, current: float, ratio: float, dt: float) -> None:
    """Take a sample: current of the machine [A] as the test computes it, ratio of the gearbox."""
    s.time += dt
    share = c.efficiency if current > 0.0 else 1.0 / c.efficiency
    step = dt * ratio * current * share
    if abs(step) < 1e6:  # a current that is no number excites nothing
        s.signed += step
        s.absolute += abs(step)


@kernel
def excited(s: State, c: Const, condition: int) -> bool:
    """Tell whether a condition holds."""
    if condition == FIXED:
        return bool(s.time > c.after)
    if condition == SIGNED:
        return bool(abs(s.signed) > c.signed)
    return bool(s.absolute > c.absolute)
