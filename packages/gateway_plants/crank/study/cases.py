"""Pulse trains with a fault in them, and what every pulse really is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from gateway_plants.crank.ecu.kinematics import tooth_times
from gateway_plants.crank.wheel import Wheel

Kind = Literal["missed", "added"]

#: Below this speed the engine does not go in a ramp [rpm].
FLOOR_RPM = 200.0
#: Revolutions before the fault and after it.
BEFORE, AFTER = 6.0, 4.0
#: Added pulses lie in this part of the interval.
SHARES = (0.02, 0.98)
#: Torsional ripple of the cases: orders 2 and 4 per revolution, shares of the speed.
RIPPLE = ((2.0, 0.05), (4.0, 0.015))
JITTER, TOOTH_ERROR = 0.01, 0.003


@dataclass(frozen=True)
class Train:
    """A pulse train.

    Attributes:
        times_us: shape (n,), pulse times [us].
        teeth: shape (n,), the tooth of each pulse, -1 for one that no tooth made.
        fault: place of the first pulse that the fault concerns: the added one, or the first behind
            the missed ones.
    """

    times_us: NDArray[np.float64]
    teeth: NDArray[np.int64]
    fault: int


def ramp(rpm: float, acceleration: float) -> tuple[list[tuple[float, float]], float, float]:
    """Return breakpoints of a speed that passes ``rpm`` with an acceleration, from the floor if need be.

    Args:
        rpm: speed at the fault.
        acceleration: [rpm/s].

    Returns:
        breakpoints (time [s], speed [rpm]), the fault's time, the end [s].
    """
    step = 0.002

    def walk(direction: int, turns: float) -> list[tuple[float, float]]:
        points, angle, t, v = [], 0.0, 0.0, rpm
        while angle < turns:
            t += direction * step
            after = max(FLOOR_RPM, rpm + acceleration * t)
            angle += (v + after) / 2 / 60 * step
            v = after
            points.append((t, v))
        return points

    before = walk(-1, BEFORE)[::-1]
    points = [*before, (0.0, rpm), *walk(1, AFTER)]
    start = points[0][0]
    return [(t - start, v) for t, v in points], -start, points[-1][0] - start


def healthy(
    wheel: Wheel,
    breakpoints: Sequence[tuple[float, float]],
    duration_s: float,
    rng: np.random.Generator,
    *,
    ripple: Sequence[tuple[float, float]] = RIPPLE,
    jitter: float = JITTER,
) -> NDArray[np.float64]:
    """Return the pulse times [us] of an engine with ripple of any phase, jitter and tooth errors."""
    phases = rng.uniform(0, 2 * np.pi, len(ripple))
    times = tooth_times(
        wheel,
        breakpoints,
        duration_s,
        ripple=[(order, share, phase) for (order, share), phase in zip(ripple, phases, strict=True)],
        jitter=jitter,
        tooth_error=TOOTH_ERROR,
        rng=rng,
    )
    return times / 1e3


def with_fault(
    wheel: Wheel,
    rpm: float,
    acceleration: float,
    kind: Kind,
    count: int,
    rng: np.random.Generator,
    *,
    near_gap: int | None = None,
) -> Train:
    """Return a train with one fault.

    Args:
        wheel: the wheel.
        rpm: speed at the fault.
        acceleration: [rpm/s].
        kind: pulses missed, or added within one interval.
        count: how many.
        rng: source of everything random.
        near_gap: the fault's place: within so many teeth of the gap; None: anywhere on the wheel.
    """
    breakpoints, fault_s, duration_s = ramp(rpm, acceleration)
    times = healthy(wheel, breakpoints, duration_s, rng)
    pulses = wheel.pulses
    middle = int(np.searchsorted(times, fault_s * 1e6))
    if near_gap is None:
        at = middle - pulses // 2 + int(rng.integers(pulses))
    else:
        at = middle - middle % pulses + int(rng.integers(-near_gap, near_gap + 1))
    teeth = np.arange(len(times)) % pulses
    if kind == "missed":
        keep = np.ones(len(times), bool)
        keep[at : at + count] = False
        return Train(times[keep], teeth[keep], at)
    width = times[at + 1] - times[at]
    extra = np.sort(np.rint(times[at] + rng.uniform(*SHARES, count) * width))
    all_times = np.concatenate([times[: at + 1], extra, times[at + 1 :]])
    labels = np.concatenate([teeth[: at + 1], np.full(count, -1), teeth[at + 1 :]])
    order = np.argsort(all_times, kind="stable")
    return Train(all_times[order], labels[order], at + 1)


def sweep(wheel: Wheel, pulses: int, jitter: float, rng: np.random.Generator) -> NDArray[np.float64]:
    """Return a healthy train of about ``pulses`` between 300 and 8000 rpm at 3000 rpm/s, back and forth [us]."""
    low, high, rate = 300.0, 8000.0, 3000.0
    half = (high - low) / rate
    duration = pulses / wheel.pulses / ((low + high) / 2 / 60)
    points = [(0.0, low)]
    while points[-1][0] < duration:
        points.append((points[-1][0] + half, high if points[-1][1] == low else low))
    return healthy(wheel, points, duration, rng, jitter=jitter)


def cranking(wheel: Wheel, pulses: int, rng: np.random.Generator, ripple: float = 0.25) -> NDArray[np.float64]:
    """Return a healthy train at 250 rpm with strong compression ripple, 2 per revolution [us]."""
    duration = pulses / wheel.pulses / (250.0 / 60)
    return healthy(wheel, [(0.0, 250.0)], duration, rng, ripple=((2.0, ripple),))
