"""The author's filter: made, and checked, before anything is stepped. Each slip is one line."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from gateway.common.plugins import Registry
from gateway.monitors.plain import calls
from gateway_fdi.errors import InputError, named
from gateway_plants.filter.kernel import MOST
from gateway_plants.filter.params import Params
from gateway_plants.filter.python import Made, Stepper, pair

#: Samples that a filter is tried on.
_TRIED = 3
#: How far a covariance may be from symmetric and positive, as a share of its largest entry.
_ROUNDED = 1e-9
#: What the second of the pair that make() may return has.
OPTIONS = ("HJacobian", "Hx")
TAKEN = ("KalmanFilter", "ExtendedKalmanFilter", "UnscentedKalmanFilter", "IMMEstimator")
_REFUSED = {
    "FixedLagSmoother": "it says what was, some samples late, and gives no innovation of now",
    "EnsembleKalmanFilter": "it draws random numbers: a replay would not give the same",
}


def _function(found: object, place: str) -> Callable[[], Any]:
    if not inspect.isfunction(found):
        raise InputError(f"a function that returns a filter, not {type(found).__name__}", value=place)
    return found


_MAKERS: Registry[Callable[[], Any]] = Registry("gateway.filters", _function)


def maker(p: Params) -> Callable[[], Any]:
    """Return the function that ``filter`` names.

    Raises:
        InputError: there is none, or it is not trusted.
    """
    module, _, name = p.filter.partition(":")
    if not module or not name:
        raise InputError('"module:make"', key="filter", value=p.filter)
    try:
        return _MAKERS[p.filter]
    except InputError as error:
        raise InputError(error.message, file=error.file, line=error.line, key="filter", value=p.filter) from error


def file_of(make: Callable[[], Any]) -> Path:
    """Return the file of the function."""
    return Path(inspect.getfile(inspect.unwrap(make)))


def within_limit(function: Callable[[], Any]) -> Any:
    """Return what a function of the author's returns.

    Raises:
        InputError: it fails, or takes too long; with file and line.
    """
    found: list[Any] = []
    token = np.zeros(1)  # the function is forgotten with it
    try:
        calls.call(calls.enter(lambda: found.append(function()), token))
    except RuntimeError as error:
        raise InputError(str(error), key="filter") from None
    return found[0]


def checked(p: Params, make: Callable[[], Any]) -> Made:
    """Have a filter made, and check it.

    Raises:
        InputError: the first that is wrong.
    """
    return _Check(p, make).made()


class _Check:
    def __init__(self, p: Params, make: Callable[[], Any]) -> None:
        self._p, self._make = p, make

    def _refuse(self, text: str) -> NoReturn:
        raise InputError(text, key="filter", value=self._p.filter)

    def made(self) -> Made:
        p = self._p
        found, options = pair(self._run(self._make))
        kind = self._kind(found)
        if (kind == "ExtendedKalmanFilter") != (set(options) == set(OPTIONS)) or (options and kind not in TAKEN[1:2]):
            self._refuse(
                'make returns (filter, {"HJacobian": ..., "Hx": ...}) for an ExtendedKalmanFilter, else the filter'
            )
        for name, function in options.items():
            if not callable(function):
                self._refuse(f"{name} is a function of x, not {type(function).__name__}")
        if kind == "IMMEstimator":
            return self._imm(found)
        if p.modes:
            raise InputError("an IMMEstimator has modes", key="modes", value=p.modes)
        states = self._sizes(found, kind)
        if type(found).__name__ == "KalmanFilter" and states <= MOST and found.inv is np.linalg.inv:
            return Made(self._make, kind, found, options, states, self._linear(found, states))
        if p.continuous:
            raise InputError(f"of a KalmanFilter of at most {MOST} states", key="continuous", value="true")
        self._covariances(found, "")
        return self._tried(Made(self._make, kind, found, options, states))

    def _run(self, function: Callable[[], Any]) -> Any:
        try:
            return within_limit(function)
        except InputError as error:
            self._refuse(f"{self._p.filter.partition(':')[2]}: {error.message}")

    def _kind(self, found: Any) -> str:
        bases = [base.__name__ for base in type(found).__mro__ if base.__module__.startswith("filterpy.")]
        kind = next((name for name in bases if name in TAKEN), "")
        if not kind:
            name = bases[0] if bases else type(found).__name__
            self._refuse(f"{name} is not taken: {_REFUSED.get(name, 'it is none of ' + ', '.join(TAKEN))}")
        return kind

    def _imm(self, found: Any) -> Made:
        p = self._p
        if p.continuous or "tests" in p.model_fields_set:
            key = "continuous" if p.continuous else "tests"
            raise InputError("an IMMEstimator is tested by its modes, and steps as it is", key=key)
        if len(p.modes) != len(found.filters) or len(set(p.modes)) < len(p.modes):
            text = f"a name of its own for each of the {len(found.filters)} filters"
            raise InputError(text, key="modes", value=p.modes)
        self._matrix("M", found.M, (found.N, found.N))
        self._matrix("mu", found.mu, (found.N,))
        if not np.allclose(np.sum(found.M, axis=1), 1.0) or np.min(found.M) < 0 or np.min(found.mu) < 0:
            self._refuse("M: each row is of probabilities that add up to 1, and so is mu")
        for k, part in enumerate(found.filters):
            self._sizes(part, self._kind(part))
            self._covariances(part, f"filters[{k}].")
        return self._tried(Made(self._make, "IMMEstimator", found, {}, found.x.size, modes=len(p.modes)))

    def _sizes(self, found: Any, kind: str) -> int:
        p = self._p
        of = "_" if kind == "UnscentedKalmanFilter" else ""
        states, measured = int(getattr(found, f"{of}dim_x")), int(getattr(found, f"{of}dim_z"))
        if measured != len(p.z):
            raise InputError(f"dim_z of the filter is {measured}: so many signals", key="z", value=len(p.z))
        if np.size(found.x) != states:
            self._refuse(f"x has the shape {np.shape(found.x)}, and dim_x is {states}")
        self._matrix("x", found.x, np.shape(found.x))
        if kind == "UnscentedKalmanFilter" and abs(1e3 * found._dt - p.period_ms) > 1e-6 * p.period_ms:
            raise InputError(f"dt of the filter is {found._dt:g} s", key="period_ms", value=p.period_ms)
        if kind == "KalmanFilter":
            self._inputs(found, states)
        return states

    def _inputs(self, found: Any, states: int) -> None:
        count = len(self._p.u)
        if found.B is None and count:
            raise InputError("the filter has no B", key="u", value=self._p.u)
        if found.B is not None and not (np.isscalar(found.B) and not found.B):
            shape = np.shape(found.B)
            if len(shape) == 2 and shape[1] != count:
                raise InputError(f"B of the filter takes {shape[1]} inputs: so many signals", key="u", value=count)
            self._matrix("B", found.B, (states, count))

    def _matrix(self, name: str, value: Any, shape: tuple[int, ...]) -> Any:
        try:
            made = np.array(value, np.float64)
        except (TypeError, ValueError):
            self._refuse(f"{name} is no matrix of numbers")
        if made.shape != shape:
            self._refuse(f"{name} has the shape {made.shape}, not {shape}")
        if not np.isfinite(made).all():
            self._refuse(f"{name} has a value that is no number: {made[~np.isfinite(made)][0]}")
        return made

    def _covariance(self, name: str, value: Any, size: int, *, above: bool = False) -> Any:
        made = self._matrix(name, value, (size, size))
        room = _ROUNDED * np.abs(made).max()
        if np.abs(made - made.T).max() > room:
            self._refuse(f"{name} is not symmetric")
        least = float(np.linalg.eigvalsh(made).min())
        if least < -room or (above and least <= room):
            self._refuse(f"{name} is not {'positive definite' if above else 'positive'}: an eigenvalue is {least:g}")
        return made

    def _covariances(self, found: Any, of: str) -> None:
        size = np.size(found.x)
        self._covariance(f"{of}P", found.P, size)
        self._covariance(f"{of}Q", found.Q, size)
        self._covariance(f"{of}R", found.R, len(self._p.z), above=True)

    def _linear(self, found: Any, n: int) -> Mapping[str, Any]:
        m = len(self._p.z)
        f, h = self._matrix("F", found.F, (n, n)), self._matrix("H", found.H, (m, n))
        b = np.zeros((n, 0)) if found.B is None else np.asarray(found.B, np.float64).reshape(n, len(self._p.u))
        p, q = self._covariance("P", found.P, n), self._covariance("Q", found.Q, n)
        r = self._covariance("R", found.R, m)
        if self._p.continuous:
            f, b, q = _of_a_period(f, b, q, self._p.period_ms / 1e3)
        self._covariance("S = H P H' + R", h @ (found._alpha_sq * f @ p @ f.T + q) @ h.T + r, m, above=True)
        return {"f": f, "b": b, "q": q, "h": h, "r": r, "x": np.ravel(found.x).astype(float), "p": p}

    def _tried(self, made: Made) -> Made:
        """Step another filter as Python will, so that what fails does so now."""

        def some() -> None:
            stepper = Stepper(self._p, made)
            z = np.zeros(len(self._p.z))
            for _ in range(_TRIED):
                z = stepper.take(z, np.zeros(len(self._p.u)), 0)

        self._run(some)
        return made


def _of_a_period(f: Any, b: Any, q: Any, dt_s: float) -> tuple[Any, Any, Any]:
    """Return F, B and Q of a period of those of dx/dt = F x + B u + w."""
    from filterpy.common import van_loan_discretization  # noqa: PLC0415 - slow to load
    from scipy.linalg import expm  # noqa: PLC0415 - slow to load

    n, k = b.shape
    values, vectors = np.linalg.eigh(q)
    phi, noise = van_loan_discretization(f, vectors * np.sqrt(np.maximum(values, 0.0)), dt_s)
    whole = expm(np.block([[f, b], [np.zeros((k, n + k))]]) * dt_s)
    return np.asarray(phi), whole[:n, n:], 0.5 * (noise + noise.T)


def names(p: Params, made: Made) -> tuple[str, ...]:
    """Return the names of the faults, in their order.

    Raises:
        InputError: a code is of none of them.
    """
    if made.modes:
        found = [f"mode_{name}" for name in p.modes[1:]]
    else:
        found = [test for test in ("nis", "fading") if test in p.tests]
        if "bias" in p.tests:
            found += [f"bias_{k + 1}_{one.name.rpartition('.')[2]}" for k, one in enumerate(p.measured)]
    for name in p.codes:
        if name not in found:
            raise InputError(named("the faults are", name, found), key=f"codes.{name}")
    return tuple(found)
