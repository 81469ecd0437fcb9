"""The paper's Table 1: operations of each method, counted by a scalar that counts (paper 001).

The kernels run as plain Python on scalars that note each operation with a value known only at run time. What involves
constants alone is folded; products with 0 and 1 and sums with 0 cost nothing. Run as a program, with compilation
switched off: ``python -m gateway_plants.steering.study.operations`` prints the counts as JSON.
"""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
from collections import Counter
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

from gateway_fdi.filters import ekf_alpha_beta, feedforward, gaussian, motor, transforms
from gateway_fdi.jit import zeros
from gateway_plants.steering.study.filters import ekf_dq, luenberger, reduced_luenberger

_COUNTS: Counter[str] = Counter()


def _plain(x: Any) -> float | None:
    return None if isinstance(x, Scalar) else float(x)


class Scalar:
    """A number that counts what is done with it."""

    def __init__(self, value: float) -> None:
        self.value = value

    def __add__(self, other: Any) -> Any:
        if _plain(other) == 0.0:
            return self
        _COUNTS["additions"] += 1
        return Scalar(self.value + _value(other))

    def __sub__(self, other: Any) -> Any:
        return self + -other

    def __rsub__(self, other: Any) -> Any:
        return -self + other

    def __neg__(self) -> Scalar:
        return Scalar(-self.value)

    def __mul__(self, other: Any) -> Any:
        plain = _plain(other)
        if plain == 0.0:
            return 0.0
        if plain in (1.0, -1.0):
            return Scalar(self.value * plain)
        _COUNTS["multiplications"] += 1
        return Scalar(self.value * _value(other))

    def __truediv__(self, other: Any) -> Any:
        plain = _plain(other)
        if plain is not None:
            return self * (1.0 / plain)
        _COUNTS["divisions"] += 1
        return Scalar(self.value / _value(other))

    def __rtruediv__(self, other: Any) -> Scalar:
        _COUNTS["divisions"] += 1
        return Scalar(_value(other) / self.value)

    def __lt__(self, other: Any) -> bool:
        _COUNTS["logic"] += 1
        return self.value < _value(other)

    def __gt__(self, other: Any) -> bool:
        _COUNTS["logic"] += 1
        return self.value > _value(other)

    def __abs__(self) -> Scalar:
        _COUNTS["logic"] += 1
        return Scalar(abs(self.value))

    def __float__(self) -> Any:
        raise TypeError("a counting scalar is not a float")

    __radd__, __rmul__ = __add__, __mul__


def _value(x: Any) -> float:
    return x.value if isinstance(x, Scalar) else float(x)


def _counting(name: str) -> Any:
    function = getattr(math, name)

    def counted(*arguments: Any) -> Any:
        if not any(isinstance(a, Scalar) for a in arguments):
            return function(*arguments)
        _COUNTS["logic" if name == "floor" else "trigonometric"] += 1
        return Scalar(function(*(_value(a) for a in arguments)))

    return counted


def _fields(record: Any, wrap: Any) -> SimpleNamespace:
    """Return a record as a namespace; its numbers go through ``wrap``."""
    parts: dict[str, Any] = {}
    for name in record.dtype.names:
        value = record[name]
        form = record.dtype[name]
        if form.names:
            parts[name] = _fields(value, wrap)
        elif form.kind in "iu":
            parts[name] = int(value)
        elif form.shape:
            parts[name] = [wrap(float(x)) for x in value]
        else:
            parts[name] = wrap(float(value))
    return SimpleNamespace(**parts)


def _pair(module: Any, **options: Any) -> tuple[Any, Any]:
    c = zeros(1, module.Const)
    module.prepare(c[0], motor.Motor(), 1e-3, **options)
    return _fields(zeros(1, module.State)[0], Scalar), _fields(c[0], float)


def _measure(step: Any) -> dict[str, int]:
    step()  # the first step of some starts them
    _COUNTS.clear()
    step()
    return dict(_COUNTS)


def count() -> dict[str, dict[str, int]]:
    """Return the operations of one step of each method; kernels must not be compiled.

    Raises:
        RuntimeError: they are.
    """
    if os.environ.get("NUMBA_DISABLE_JIT") != "1":
        raise RuntimeError("operations are counted with NUMBA_DISABLE_JIT=1")
    filters = (feedforward, ekf_alpha_beta, ekf_dq, luenberger, reduced_luenberger)
    for module in (transforms, motor, gaussian, *filters):
        for name in ("sin", "cos", "atan2", "hypot", "floor"):
            if hasattr(module, name):
                setattr(module, name, _counting(name))
        module.float = _value_or_same  # type: ignore[attr-defined]
    i_u, i_v, u_a, u_b, theta = (Scalar(x) for x in (10.0, -3.0, 1.0, 2.0, 0.4))
    lo, lo_c = _pair(luenberger)
    red, red_c = _pair(reduced_luenberger)
    e3, e3_c = _pair(ekf_dq, load=False, steps=1)
    e4, e4_c = _pair(ekf_dq, load=True, steps=1)
    ff, ff_c = _pair(feedforward)
    a4, a4_c = _pair(ekf_alpha_beta, load=False, steps=1)
    a5, a5_c = _pair(ekf_alpha_beta, load=True, steps=1)
    a4.resistance = a5.resistance = 0.06
    a4.started = a5.started = 1

    def dq() -> tuple[Any, Any, Any, Any]:
        i_a, i_b = transforms.clarke(i_u, i_v)  # type: ignore[arg-type]
        return (*transforms.park(u_a, u_b, theta), *transforms.park(i_a, i_b, theta))  # type: ignore[arg-type]

    def alpha_beta(step: Any, s: Any, c: Any, *turned: float) -> None:
        step(s, c, u_a, u_b, *turned, *transforms.clarke(i_u, i_v))  # type: ignore[arg-type]

    return {
        "Luenberger": _measure(lambda: luenberger.step(lo, lo_c, *dq()[1::2])),
        "reduced Luenberger": _measure(lambda: reduced_luenberger.step(red, red_c, *dq()[1::2])),
        "EKF3 dq": _measure(lambda: ekf_dq.step(e3, e3_c, *dq())),
        "feedforward": _measure(lambda: alpha_beta(feedforward.step, ff, ff_c)),
        "EKF4 dq + load": _measure(lambda: ekf_dq.step(e4, e4_c, *dq())),
        "EKF4 ab": _measure(lambda: alpha_beta(ekf_alpha_beta.step, a4, a4_c, 0.0, 0.0)),
        "EKF5 ab": _measure(lambda: alpha_beta(ekf_alpha_beta.step, a5, a5_c, 0.0, 0.0)),
    }


def _value_or_same(x: Any) -> Any:
    """Stand in for float() in the kernels: it keeps counting scalars."""
    return x if isinstance(x, Scalar) else float(x)


@dataclass(frozen=True)
class Load:
    """Operations of a step; ``integrators``: values that it carries to the next, symmetric covariances once."""

    method: str
    multiplications: int
    additions: int
    divisions: int
    trigonometric_and_logic: int
    integrators: int


#: Integrators: states, covariances, angle.
_INTEGRATORS = {
    "Luenberger": 3,
    "reduced Luenberger": 2,
    "EKF3 dq": 3 + 6 + 1,
    "feedforward": 2,
    "EKF4 dq + load": 4 + 10 + 1,
    "EKF4 ab": 4 + 10,
    "EKF5 ab": 5 + 15,
}


def table() -> list[Load]:
    """Return Table 1, counted in a process of its own that does not compile."""
    ended = subprocess.run(
        [sys.executable, "-m", "gateway_plants.steering.study.operations"],
        env={**os.environ, "NUMBA_DISABLE_JIT": "1"},
        capture_output=True,
        text=True,
        check=True,
    )
    return [
        Load(
            method,
            counts.get("multiplications", 0),
            counts.get("additions", 0),
            counts.get("divisions", 0),
            counts.get("trigonometric", 0) + counts.get("logic", 0),
            _INTEGRATORS[method],
        )
        for method, counts in json.loads(ended.stdout).items()
    ]


if __name__ == "__main__":
    print(json.dumps(count()))
