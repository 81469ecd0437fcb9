"""Crank kinematics: when each tooth of a trigger wheel passes the sensor.

The mean angle follows a speed profile; torsional ripple modulates the speed with the angle::

    theta = Theta + sum_k (a_k / k) sin(k Theta + phi_k),   Theta' = omega(t)

so that the speed is ``omega (1 + sum a_k cos(k Theta + phi_k))``. Each tooth's time is found by inverting
the first relation (Newton) and then the profile's integral, which is exact between breakpoints.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gateway_plants.crank.wheel import Wheel

#: (order per revolution, amplitude as a fraction of the speed, phase [rad]).
Ripple = tuple[float, float, float]


def profile_angle(times_s: NDArray[np.float64], breakpoints: Sequence[tuple[float, float]]) -> NDArray[np.float64]:
    """Return the mean crank angle [revolution] at given times.

    Args:
        times_s: shape (n,) [s].
        breakpoints: (time [s], speed [rpm]), times rising; linear in between, constant outside.
    """
    knots, speeds, angles = _knots(breakpoints)
    k = np.clip(np.searchsorted(knots, times_s, side="right") - 1, 0, len(knots) - 1)
    dt = times_s - knots[k]
    slope = np.append(np.diff(speeds) / np.diff(knots), 0.0)[k]
    return np.asarray(angles[k] + speeds[k] * dt + slope * dt**2 / 2)


def _knots(
    breakpoints: Sequence[tuple[float, float]],
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return knots [s], speeds there [rev/s] and angles there [rev], the first knot at zero."""
    knots = np.array([t for t, _ in breakpoints], float)
    speeds = np.array([rpm for _, rpm in breakpoints], float) / 60
    if knots[0] > 0:
        knots, speeds = np.insert(knots, 0, 0.0), np.insert(speeds, 0, speeds[0])
    steps = np.diff(knots) * (speeds[1:] + speeds[:-1]) / 2
    return knots, speeds, np.concatenate([[0.0], np.cumsum(steps)])


def profile_time(angles_rev: NDArray[np.float64], breakpoints: Sequence[tuple[float, float]]) -> NDArray[np.float64]:
    """Return when the mean crank angle reaches given values [s]; infinity for never.

    Args:
        angles_rev: shape (n,), rising [revolution].
        breakpoints: as for :func:`profile_angle`.
    """
    knots, speeds, reached = _knots(breakpoints)
    # Of several knots at one angle (standstill) the last counts: the tooth passes when it moves on.
    k = np.clip(np.searchsorted(reached, angles_rev, side="right") - 1, 0, len(knots) - 1)
    slope = np.append(np.diff(speeds) / np.diff(knots), 0.0)[k]
    rest = angles_rev - reached[k]
    with np.errstate(divide="ignore", invalid="ignore"):
        # 2 c / (b + sqrt(b^2 + 2 a c)) holds for any slope, zero included.
        root = np.sqrt(np.maximum(speeds[k] ** 2 + 2 * slope * rest, 0.0))
        dt = np.where(rest > 0, 2 * rest / (speeds[k] + root), 0.0)
    return np.asarray(knots[k] + dt)


def tooth_times(
    wheel: Wheel,
    breakpoints: Sequence[tuple[float, float]],
    duration_s: float,
    *,
    ripple: Sequence[Ripple] = (),
    jitter: float = 0.0,
    tooth_error: float = 0.0,
    rng: np.random.Generator,
) -> NDArray[np.int64]:
    """Return the times of all tooth pulses of a run [ns], whole microseconds, strictly rising.

    Args:
        wheel: the trigger wheel; pulse 0 passes at time 0.
        breakpoints: speed profile, (time [s], speed [rpm]).
        duration_s: length of the run [s].
        ripple: torsional ripple.
        jitter: standard deviation of each edge's time [pitch at the speed there].
        tooth_error: standard deviation of each tooth's place [pitch], the same in every turn.
        rng: source of jitter and tooth errors.
    """
    turns = float(profile_angle(np.array([duration_s]), breakpoints)[0])
    error = rng.normal(0, tooth_error, wheel.pulses) if tooth_error else np.zeros(wheel.pulses)
    places = (np.array(wheel.positions) + error) / wheel.turn
    angles = (np.arange(int(turns) + 1)[:, None] + places[None, :]).ravel()
    mean = angles.copy()
    for _ in range(6):
        value, slope = mean.copy(), np.ones_like(mean)
        for order, amplitude, phase in ripple:
            inner = 2 * np.pi * order * mean + phase
            value += amplitude / (2 * np.pi * order) * (np.sin(inner) - np.sin(phase))
            slope += amplitude * np.cos(inner)
        mean -= (value - angles) / slope
    times = profile_time(mean, breakpoints)
    times = times[times <= duration_s]
    if jitter and len(times) > 2:
        pitch = np.gradient(times, angles[: len(times)] * wheel.turn)
        times = times + rng.normal(0, jitter, len(times)) * pitch
    # Pulse 0 stays pulse 0: jitter does not move it before the start.
    return np.unique(np.maximum(np.rint(times * 1e6).astype(np.int64), 0)) * 1000


def cam_edges(
    edges: Sequence[tuple[float, int]],
    breakpoints: Sequence[tuple[float, float]],
    duration_s: float,
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return times [ns] and levels of the edges of a cam sensor, by the mean angle of the crank.

    Args:
        edges: (crank angle from tooth 0, 0..720 [deg], level after it).
        breakpoints: speed profile, (time [s], speed [rpm]).
        duration_s: length of the run [s].
    """
    cycles = int(profile_angle(np.array([duration_s]), breakpoints)[0] / 2) + 1
    ordered = sorted(edges)
    angles = np.array([angle for angle, _ in ordered]) / 360
    at = (2 * np.arange(cycles)[:, None] + angles[None, :]).ravel()
    levels = np.tile([level for _, level in ordered], cycles)
    times = profile_time(at, breakpoints)
    inside = times <= duration_s
    return np.rint(times[inside] * 1e9).astype(np.int64), levels[inside].astype(np.int64)
