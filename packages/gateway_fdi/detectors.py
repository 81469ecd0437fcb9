"""Detectors over arrays: a stopping rule, a CUSUM test; each owns its records.

::

    rule = StoppingRule("cusum", 5.0, drift=0.5)
    alarms = rule.run(residual)             # or rule.update(x), value by value
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gateway_fdi import cusum, stopping
from gateway_fdi.errors import InputError, as_input, named
from gateway_fdi.jit import f8s, kernel, zeros

#: Parameters of stopping rules.
PARAMETERS = ("forget", "drift", "shift", "sigma", "low", "most", "window")


def numbers(values: ArrayLike, key: str, columns: int | None = None) -> NDArray[np.float64]:
    """Return numbers, shape (n,), or (n, columns).

    Args:
        values: of the caller.
        key: name of the argument.
        columns: None: one value a sample.

    Raises:
        InputError: no numbers, or of another shape.
    """
    try:
        made = np.ascontiguousarray(values, np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"numbers: {error}", key=key) from error
    shape = made.shape
    if made.ndim != (1 if columns is None else 2) or (columns is not None and shape[1] != columns):
        raise InputError(f"shape {'(n,)' if columns is None else f'(n, {columns})'}, not {shape}", key=key)
    return made


@kernel
def _levels(s: Any, c: Any, x: f8s, level: f8s) -> None:
    for k in range(x.shape[0]):
        stopping.update(s, c, x[k])
        level[k] = s.level


@kernel
def _norms(s: Any, c: Any, r: f8s, norm: f8s) -> None:
    for k in range(r.shape[0]):
        norm[k] = cusum.update(s, c, r[k])


class StoppingRule:
    """From a symptom to an alarm, by a rule of :mod:`gateway_fdi.stopping`.

    Args:
        rule: ``direct``, ``gma``, ``cusum``, ``sprt`` or ``chi_square``.
        threshold: of the level, from which on it alarms.
        parameters: of the rule (:func:`gateway_fdi.stopping.prepare`).

    Raises:
        InputError: no such rule or parameter.
    """

    def __init__(self, rule: str, threshold: float, **parameters: float) -> None:
        if rule not in stopping.RULES:
            raise InputError(named("the rules are", rule, stopping.RULES), key="rule", value=rule)
        for name, value in parameters.items():
            if name not in PARAMETERS:
                raise InputError(named("the parameters are", name, PARAMETERS), key=name, value=value)
        self.rule, self.threshold = rule, float(threshold)
        self._s, self._c = zeros(1, stopping.State)[0], zeros(1, stopping.Const)[0]
        with as_input("parameters"):
            stopping.prepare(self._c, rule, self.threshold, **parameters)  # type: ignore[arg-type]

    def __repr__(self) -> str:
        return f"StoppingRule({self.rule}, threshold {self.threshold:g}, level {self.level:.4g})"

    @property
    def level(self) -> float:
        """The level at present."""
        return float(self._s["level"])

    @property
    def alarm(self) -> bool:
        """Whether it has reached the threshold."""
        return self.level >= self.threshold

    def update(self, x: float) -> bool:
        """Take a value of the symptom; returns whether it alarms."""
        return bool(stopping.update(self._s, self._c, float(x)))

    def levels(self, x: ArrayLike) -> NDArray[np.float64]:
        """Take values of the symptom, shape (n,); returns the level after each."""
        values = numbers(x, "x")
        level = np.empty(len(values))
        _levels(self._s, self._c, values, level)
        return level

    def run(self, x: ArrayLike) -> NDArray[np.bool_]:
        """Take values of the symptom, shape (n,); returns whether it alarms after each."""
        return np.asarray(self.levels(x) >= self.threshold)

    def reset(self) -> None:
        """Start again."""
        stopping.reset(self._s)


class Cusum:
    """CUSUM of a residual, normalised: above 1 it has fired (:mod:`gateway_fdi.cusum`; paper 004, (26), (46)).

    Args:
        nu: drift: typical modulus of a healthy residual, its unit.
        threshold: J, in the residual's unit.

    Raises:
        InputError: no positive number.
    """

    def __init__(self, nu: float, threshold: float) -> None:
        for key, value in (("nu", nu), ("threshold", threshold)):
            if not 0.0 < value < np.inf:
                raise InputError("a number above 0", key=key, value=value)
        self.nu, self.threshold = float(nu), float(threshold)
        self._s, self._c = zeros(1, cusum.State)[0], zeros(1, cusum.Const)[0]
        cusum.prepare(self._c, self.nu, self.threshold)

    @classmethod
    def learned(cls, healthy: ArrayLike, *, margin: float = cusum.MARGIN, floor: float = cusum.FLOOR) -> Cusum:
        """Return the test whose nu and J healthy residuals give.

        Args:
            healthy: shape (n,), n at least 100.
            margin: largest healthy T as a share of J.
            floor: least largest T, in units of nu.

        Raises:
            InputError: too few of them, or none that is finite.
        """
        r = numbers(healthy, "healthy")
        if len(r) < cusum.LEAST or not np.isfinite(r).all():
            text = f"{len(r)} residuals: at least {cusum.LEAST} finite ones say what is typical"
            raise InputError(text, key="healthy")
        nu = cusum.typical(len(r), float(np.abs(r).sum()), float((r * r).sum()))
        trial = cls(nu, nu * 1e12)  # so high that T is not cut off
        largest = float(trial.run(r).max()) * trial.threshold / nu
        return cls(nu, nu * cusum.threshold(largest, margin, floor))

    def __repr__(self) -> str:
        return f"Cusum(nu {self.nu:.4g}, J {self.threshold:.4g})"

    def update(self, residual: float) -> float:
        """Take a residual; returns T over J."""
        return float(cusum.update(self._s, self._c, float(residual)))

    def run(self, residual: ArrayLike) -> NDArray[np.float64]:
        """Take residuals, shape (n,); returns T over J after each."""
        r = numbers(residual, "residual")
        norm = np.empty(len(r))
        _norms(self._s, self._c, r, norm)
        return norm
