"""Plausibility of the road wheel angle (paper 001, (2) to (4)).

The controller makes the motor add what is missing to an overall ratio i_V(v_X): road wheel = wheel / i_V, (3). (2) is
the inverse of what its text says: the pinion follows from the road wheel, delta_G = F_SG(delta_F); here
F_SG(x) = gear x (1 + cubic x^2), solved for x by Newton's method. (4)'s dependence on the pinion angle is left out.
"""

from __future__ import annotations

from math import pi
from typing import Annotated

from gateway_fdi.jit import Record, f8, f8s, i8, kernel, means
from gateway_plants.steering.monitor.params import Ratio

#: Points of i_V(v_X).
POINTS = 8
#: Share of a new value in the average; frames of the steering wheel.
AVERAGE = 0.1


class Const(Record):
    """Constants."""

    points: i8 = means("points of i_V(v_X); 0: nothing is checked")
    speed: Annotated[f8s, POINTS] = means("speed of each point", "km/h")
    ratio: Annotated[f8s, POINTS] = means("steering wheel over road wheel at each point")
    gear: f8 = means("pinion over road wheel, for small angles")
    cubic: f8 = means("how that grows with the angle", "1/rad^2")
    tolerance: f8 = means("what the road wheel angle may be off", "deg")


class State(Record):
    """State."""

    off: f8 = means("road wheel angle less the one asked for, averaged", "deg")
    taken: i8 = means("values in that average")


def prepare(c: Const, ratio: Ratio | None) -> None:
    """Fill a record of Const; without a ratio nothing is checked."""
    if ratio is None:
        return
    n = len(ratio.speed)
    c.points, c.gear, c.cubic = n, ratio.gear, ratio.cubic
    c.speed[:n], c.ratio[:n] = ratio.speed, ratio.ratio
    c.tolerance = ratio.tolerance


@kernel
def overall_ratio(c: Const, v: float) -> float:
    """Return i_V at a speed [km/h], along straight lines, (4)."""
    if v <= c.speed[0]:
        return float(c.ratio[0])
    for k in range(1, c.points):
        if v <= c.speed[k]:
            share = (v - c.speed[k - 1]) / (c.speed[k] - c.speed[k - 1])
            return float(c.ratio[k - 1] + share * (c.ratio[k] - c.ratio[k - 1]))
    return float(c.ratio[c.points - 1])


@kernel
def road_wheel(c: Const, pinion: float) -> float:
    """Return the road wheel's angle for a pinion angle, both [deg]: (2) solved for delta_F."""
    target = pinion * pi / 180.0 / c.gear
    x = target
    for _ in range(8):
        x -= (x * (1.0 + c.cubic * x * x) - target) / (1.0 + 3.0 * c.cubic * x * x)
    return float(x * 180.0 / pi)


@kernel
def check(s: State, c: Const, pinion: float, wheel: float, v: float) -> bool:
    """Take pinion and wheel angle [deg] at a speed [km/h]; tells whether ``s.off`` may be judged."""
    off = road_wheel(c, pinion) - wheel / overall_ratio(c, v)
    s.off += AVERAGE * (off - s.off)
    s.taken += 1
    return bool(s.taken > 20)
