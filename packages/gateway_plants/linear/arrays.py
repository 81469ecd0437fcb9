"""Observers of a linear plant over arrays: one that detects, and the bank of PI-observers that isolates.

::

    bank = PiBank(A, B, C, 0.1, noise=0.01, actuator=0.01, sensor=0.1)
    found = bank.run(y, u)                  # shapes (n, sensors), (n, commands)
    print(found.actuators.any(0), found.sensors.any(0), found.fault[-1])
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gateway_fdi.detectors import numbers
from gateway_fdi.errors import InputError, as_input
from gateway_fdi.jit import kernel, zeros
from gateway_fdi.quantiles import chi2_above
from gateway_plants.linear.mathematics.gains import from_noise
from gateway_plants.linear.mathematics.plant import LinearPlant, discretised
from gateway_plants.linear.mathematics.uncertainty import entries
from gateway_plants.linear.model_set import decision, isolation, records
from gateway_plants.linear.model_set.design import EXACT_OFFSET, Told, isolable
from gateway_plants.linear.pi_bank.design import Noise, check

__all__ = ["Found", "Observer", "PiBank"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Found:
    """What a bank found at each of n samples, for m actuators and p sensors.

    Attributes:
        actuators: flags, shape (n, m).
        sensors: flags, shape (n, p).
        fault: sizes of the faults of actuators that are named, in the commands' units, shape (n, m).
        offset: of sensors that are, in the readings' units, shape (n, p).
        unexplained: whether what happened is not isolated, shape (n,).
        tested: whether the sample was judged, shape (n,).
    """

    actuators: NDArray[np.int64]
    sensors: NDArray[np.int64]
    fault: Array
    offset: Array
    unexplained: NDArray[np.int64]
    tested: NDArray[np.int64]


@kernel
def _walk(s: Any, c: Any, y: Any, u: Any, unsure: Any, flags: Any, sizes: Any) -> None:
    """Step through samples; ``flags``: actuators, sensors, unexplained, tested; ``sizes``: of actuators, sensors."""
    parts = c.filters.m + c.filters.p
    for t in range(y.shape[0]):
        decision.step(s, c, y[t], u[t], unsure)
        for part in range(parts):
            flags[t, part] = 1 if isolation.at_fault(s, part) else 0
            sizes[t, part] = s.magnitude[part] if flags[t, part] == 1 else 0.0
        flags[t, parts] = s.unexplained
        flags[t, parts + 1] = s.tested


def exact(
    a: ArrayLike, b: ArrayLike, plant: LinearPlant, noise: Noise, actuator: Array, sensor: Array, *, discrete: bool
) -> Told:
    """Return what is told of a plant that is known exactly, with thresholds of actuators (m,) and sensors (p,)."""
    none, offsets = np.zeros(plant.outputs), (EXACT_OFFSET * sensor, EXACT_OFFSET * actuator)
    a, b = np.asarray(a, np.float64), np.asarray(b, np.float64)
    known, left_out = entries(a, b, 0.0, 0.0), isolable(plant)
    return Told(plant, a, b, discrete, noise, known, actuator, sensor, left_out, none, *offsets, none, counted=False)


def walk(s: Any, c: Any, y: Array, u: Array) -> Found:
    """Step a bank's records through samples y (n, p) with commands u (n, m)."""
    m, p = u.shape[1], y.shape[1]
    flags, sizes = np.zeros((len(y), m + p + 2), np.int64), np.zeros((len(y), m + p))
    _walk(s, c, y, u, np.zeros(m, np.int64), flags, sizes)
    found = flags[:, :m], flags[:, m : m + p], sizes[:, :m], sizes[:, m:]
    return Found(*found, flags[:, m + p], flags[:, m + p + 1])


def _per(values: ArrayLike, count: int, key: str) -> Array:
    """Return a positive number for each, from one for all or one each."""
    with as_input(key):
        made = np.broadcast_to(np.asarray(values, np.float64), (count,)).copy()
    if not ((made > 0.0) & (made < np.inf)).all():
        raise InputError("above 0", key=key, value=values)
    return made


def _taken(y: ArrayLike, u: ArrayLike, plant: LinearPlant) -> tuple[Array, Array]:
    readings, commands = numbers(y, "y", plant.outputs), numbers(u, "u", plant.inputs)
    if len(readings) != len(commands):
        raise InputError(f"{len(commands)} samples, y has {len(readings)}", key="u")
    return readings, commands


class PiBank:
    """A bank of PI-observers: which actuator or sensor is at fault, and how large (paper 003; docs/linear).

    Args:
        a: shape (n, n): of dx/dt = A x + B u, or of x(k+1) if ``discrete``.
        b: shape (n, m).
        c: shape (p, n), p above m.
        period_s: time between two samples [s].
        noise: standard deviation of the sensors, one for all or one each.
        actuator: least faults of actuators that count, likewise, in the commands' units.
        sensor: likewise of sensors.
        disturbance: of each state, per root of a second.
        drift: of the actuators' faults, per root of a second; None: a tenth of ``actuator``.
        mtfa_s: mean time between false alarms that is asked for [s].
        start_s: time in which nothing is judged [s].
        hold_s: a sensor's fault is gone after it has been for this time [s].
        discrete: the matrices are of discrete time.

    Raises:
        InputError: shapes that do not fit, or a plant that no bank can isolate faults of (Theorem 1); says why.
    """

    def __init__(
        self,
        a: ArrayLike,
        b: ArrayLike,
        c: ArrayLike,
        period_s: float,
        *,
        noise: ArrayLike,
        actuator: ArrayLike,
        sensor: ArrayLike,
        disturbance: ArrayLike = 1e-4,
        drift: ArrayLike | None = None,
        mtfa_s: float = 1e6,
        start_s: float = 5.0,
        hold_s: float = 2.0,
        discrete: bool = False,
    ) -> None:
        with as_input("plant"):
            self._plant = plant = discretised(a, b, c, period_s, discrete=discrete)
            check(plant)
            limits = _per(actuator, plant.inputs, "actuator")
            drifts = 0.1 * limits if drift is None else _per(drift, plant.inputs, "drift")
            noises = Noise(_per(noise, plant.outputs, "noise"), _per(disturbance, plant.states, "disturbance"), drifts)
            self._s, self._c = zeros(1, records.State)[0], zeros(1, records.Const)[0]
            told = exact(a, b, plant, noises, limits, _per(sensor, plant.outputs, "sensor"), discrete=discrete)
            decision.prepare(self._s, self._c, told, mtfa_s=mtfa_s, start_s=start_s, hold_s=hold_s)

    def __repr__(self) -> str:
        return f"PiBank({self._plant.states} states, {self._plant.inputs} commands, {self._plant.outputs} sensors)"

    def run(self, y: ArrayLike, u: ArrayLike) -> Found:
        """Take samples; it goes on where it stopped.

        Args:
            y: readings, shape (n, p).
            u: commands, each held from its sample to the next, shape (n, m).

        Raises:
            InputError: other shapes.
        """
        return walk(self._s, self._c, *_taken(y, u, self._plant))


class Observer:
    """The stationary Kalman filter of a plant: what it leaves of each sensor. It detects, and isolates nothing.

    Args:
        a: as of :class:`PiBank`.
        b: likewise.
        c: likewise.
        period_s: time between two samples [s].
        noise: standard deviation of the sensors, one for all or one each.
        disturbance: of each state, per root of a second.
        discrete: the matrices are of discrete time.

    Attributes:
        x: the estimate, shape (n,).
        covariance: of what is left, shape (p, p).

    Raises:
        InputError: shapes that do not fit, or there is no such filter.
    """

    def __init__(
        self,
        a: ArrayLike,
        b: ArrayLike,
        c: ArrayLike,
        period_s: float,
        *,
        noise: ArrayLike,
        disturbance: ArrayLike,
        discrete: bool = False,
    ) -> None:
        with as_input("plant"):
            self._plant = plant = discretised(a, b, c, period_s, discrete=discrete)
            q = np.diag(_per(disturbance, plant.states, "disturbance") ** 2 * period_s)
            r = np.diag(_per(noise, plant.outputs, "noise") ** 2)
            gain = from_noise(plant.phi, plant.c, q, r)
        self._gain, self.covariance = gain.gain, gain.innovation
        self.x = np.zeros(plant.states)

    def run(self, y: ArrayLike, u: ArrayLike) -> Array:
        """Take samples as :meth:`PiBank.run` does; returns what is left of each sensor, shape (n, p)."""
        readings, commands = _taken(y, u, self._plant)
        left = np.empty_like(readings)
        for k, (reading, command) in enumerate(zip(readings, commands, strict=True)):
            left[k] = reading - self._plant.c @ self.x
            self.x = self._plant.phi @ self.x + self._plant.gamma @ command + self._gain @ left[k]
        return left

    def squared(self, left: ArrayLike) -> Array:
        """Return e^T V^-1 e of what is left, shape (n,): chi-squared with p degrees without a fault."""
        e = numbers(left, "left", self._plant.outputs)
        return np.asarray(np.einsum("ki,ij,kj->k", e, np.linalg.inv(self.covariance), e))

    def threshold(self, false_alarm: float) -> float:
        """Return the value that :meth:`squared` exceeds with a probability without a fault."""
        return float(chi2_above(false_alarm, self._plant.outputs))
