"""How fast the states of a residual generator are, and whether its period can follow them.

The generator's own code says what the Jacobian J of its states is (:mod:`gateway_fdi.structure.generator.propagation`):
it takes one sample, in plain Python, at the configured parameters. A mode lambda of J [1/s] is exp(h lambda) from
sample to sample, h the period: that is what the step makes of it, exactly. Known variables have values drawn around 1,
states around where they begin; where J depends on them, the modes are those of some points, and are told as such.
"""

from __future__ import annotations

import math
import types
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gateway_fdi.errors import InputError
from gateway_fdi.jit import zeros
from gateway_fdi.structure.generator.records import JACOBIAN, field_name, fill
from gateway_fdi.structure.generator.sources import load_source
from gateway_fdi.structure.model import Model, Quantity
from gateway_plants.structural.monitor import uncertain
from gateway_plants.structural.monitor.params import Params
from gateway_plants.structural.monitor.plan import Plan, Test

#: Share of a state by which it is moved for a difference.
_SHARE = 1e-3
#: Points at which a Jacobian is computed; what of a mode is rounding.
_POINTS, _ROUNDING = 3, 1e-6
#: Phase by which an oscillation may run away, and still be followed [rad].
_FAR = 1.0
#: Samples of a turn at which an oscillation is followed.
_A_TURN = 4.0


@dataclass(frozen=True)
class Modes:
    """Modes of a generator.

    Attributes:
        values: of each point, complex [1/s], shape (modes,).
        linear: they are the same at all points.
    """

    values: tuple[NDArray[np.complex128], ...]
    linear: bool

    @property
    def every(self) -> NDArray[np.complex128]:
        """Those of all points, shape (modes,) [1/s]."""
        return np.concatenate(self.values)

    @property
    def growing(self) -> complex | None:
        """The mode that grows fastest, if one does so at each point."""
        worst = [v[np.argmax(v.real)] for v in self.values]
        grows = [w.real > _ROUNDING * np.abs(v).max() for w, v in zip(worst, self.values, strict=True)]
        return complex(min(worst, key=lambda w: float(w.real))) if all(grows) else None


def _plain(step: Any, scope: dict[str, Any]) -> Any:
    """Return a kernel as plain Python, calls and all; nothing is moved in it."""
    function = getattr(step, "py_func", step)
    names = {name: getattr(value, "py_func", value) for name, value in scope.items()}
    return types.FunctionType(function.__code__, names | {"advance": lambda *_: None})


def modes(model: Model, test: Test, p: Params) -> Modes | None:
    """Return the modes of a generator at the configured parameters; None: no state acts on one, or there is no number.

    Args:
        test: the generator.
        p: the parameters of the monitor.
    """
    module = load_source(test.name, test.source)
    fields = [name for name in module.State.dtype.names or () if name.startswith(JACOBIAN)]
    if not fields:
        return None
    step, rng, found = _plain(module.step, vars(module)), np.random.default_rng(1), []
    begins = {x: p.start.get(x, model.quantities.get(x, Quantity()).value) for x in model.states}
    for _ in range(_POINTS):
        s, c = (zeros(1, record.dtype)[0] for record in (module.State, module.Const))
        start = dict.fromkeys(test.guessed, 0.0) | p.start
        fill(c, model, values=p.parameters, start=start)
        for x, begin in begins.items():
            if field_name(x) in (module.State.dtype.names or ()):
                s[field_name(x)] = (begin or 1.0) * rng.uniform(0.5, 1.5)
        u = types.SimpleNamespace(**{field_name(z): float(rng.uniform(0.5, 1.5)) for z in model.knowns})
        try:
            with np.errstate(all="ignore"):
                step(s, c, u, 0.0)
        except (ArithmeticError, ValueError):
            continue
        rows = [row for name in fields for row in np.atleast_2d(np.asarray(s[name]))]
        square = [row.reshape(math.isqrt(len(row)), -1) for row in rows]
        found.append((np.concatenate(rows), np.concatenate([np.linalg.eigvals(m) for m in square]).astype(complex)))
    if not found:
        return None
    same = all(np.allclose(rows, found[0][0], rtol=1e-9, atol=0.0) for rows, _ in found)
    return Modes(tuple(values for _, values in found), same)


@dataclass(frozen=True)
class Linear:
    """A generator at one point.

    Attributes:
        states: their fields in its State, n of them.
        jacobian: of their derivatives by them, shape (n, n) [1/s].
        residual: its derivatives by them, shape (n,).
    """

    states: tuple[str, ...]
    jacobian: NDArray[np.float64]
    residual: NDArray[np.float64]


def linearised(model: Model, test: Test, p: Params) -> Linear | None:
    """Return a generator's derivatives where its states begin, by differences; None: there is no number.

    Args:
        test: the generator.
        p: the parameters of the monitor.
    """
    module = load_source(test.name, test.source)
    names = module.State.dtype.names or ()
    states = tuple(name.removeprefix("d_") for name in names if name.startswith("d_") and name[2:] in names)
    step = _plain(module.step, vars(module))
    c = zeros(1, module.Const.dtype)[0]
    start = dict.fromkeys(test.guessed, 0.0) | p.start
    fill(c, model, values=p.parameters, start=start)
    begins = {field_name(x): p.start.get(x, model.quantities.get(x, Quantity()).value) for x in model.states}
    here = np.array([begins.get(x) or 1.0 for x in states])
    u = types.SimpleNamespace(**{field_name(z): 1.0 for z in model.knowns})

    def at(x: NDArray[np.float64]) -> NDArray[np.float64]:
        s = zeros(1, module.State.dtype)[0]
        for name, value in zip(states, x, strict=True):
            s[name] = value
        residual = step(s, c, u, 0.0)
        return np.array([*(s[f"d_{name}"] for name in states), residual])

    rows = np.empty((len(states) + 1, len(states)))
    try:
        with np.errstate(all="ignore"):
            for k, value in enumerate(here):
                moved = np.zeros(len(here))
                moved[k] = _SHARE * max(abs(value), _SHARE)
                rows[:, k] = (at(here + moved) - at(here - moved)) / (2.0 * moved[k])
    except (ArithmeticError, ValueError):
        return None
    return Linear(states, rows[:-1], rows[-1]) if states and np.isfinite(rows).all() else None


def _mode(value: complex, h: float) -> str:
    """Return a mode in words: its rate, its damping where it turns, and what a sample leaves of it."""
    size = abs(value)
    if size == 0.0:
        return "0 (an integral)"
    damping = f", damping {-value.real / size:.2g}" if value.imag else ""
    return f"{size:.3g} rad/s{damping} ({math.exp(min(value.real * h, 700.0)):.4g} left a sample)"


def in_words(found: Modes, p: Params) -> str:
    """Return the fastest and the slowest mode against the period."""
    h, every = p.period_ms / 1e3, found.every
    fastest, slowest = every[np.argmax(np.abs(every))], every[np.argmax(every.real)]
    one = abs(fastest - slowest) <= _ROUNDING * abs(fastest) or abs(fastest - slowest.conjugate()) <= 1e-9
    told = _mode(fastest, h) if one else f"{_mode(fastest, h)}, slowest {_mode(slowest, h)}"
    return f"{'mode' if one else 'fastest mode'} {told}{'' if found.linear else ', at values around 1 and the start'}"


def refuse_diverging(model: Model, plan: Plan, p: Params) -> None:
    """Refuse a generator whose error grows without end.

    Raises:
        InputError: one that is linear has a mode that grows; names it, and what helps.
    """
    h = p.period_ms / 1e3
    for test in plan.generators:
        found = modes(model, test, p)
        worst = found.growing if found is not None else None
        if found is None or worst is None or not found.linear or test.observed:
            continue
        raise InputError(
            f"residual {test.name} (it checks {test.consistency}, by {test.sequence}) diverges: its mode"
            f" of {worst.real:+.3g} 1/s grows {math.exp(min(worst.real * h, 700.0)):.4g} times a sample of period_ms ="
            f" {p.period_ms:g}, and as fast a second at any period, for the plant does so itself: take other tests"
            f' (tests = [...], gateway structure lists them; or causality = "mixed"), or mend the parameters',
            key="tests",
            value=test.name,
        )


def warnings(model: Model, plan: Plan, p: Params) -> Iterator[str]:
    """Yield what the period cannot follow, with one that can."""
    h = p.period_ms / 1e3
    for test in plan.tests:
        found = modes(model, test, p)
        if found is None:
            continue
        if found.growing is not None and not test.observed:
            yield f"{test.name}: a mode of {found.growing.real:+.3g} 1/s grows at values around 1: it may diverge"
        turn = min(np.abs(v.imag).max() for v in found.values)
        if turn * h > math.pi:
            good = 2e3 * math.pi / _A_TURN / turn
            yield (
                f"{test.name}: a mode turns with {turn:.3g} rad/s, more than half a turn a sample of period_ms ="
                f" {p.period_ms:g}: period_ms = {good:.2g} would follow it"
            )


def runs_away(model: Model, plan: Plan, p: Params) -> Iterator[str]:
    """Yield tests whose oscillation leaves the plant's by more than can be followed, as its frequency is uncertain.

    A mode sigma + i omega forgets in 1 / sigma; a parameter that is off by a share b changes omega by a share of b / 2,
    as a stiffness or a mass does, so that the phase is off by omega b / (2 sigma) in the end. Above :data:`_FAR` what
    is off no longer acts on the residual in proportion.
    """
    for test in (one for one in plan.tests if not one.observed):
        bounds = [
            one.bound for one in uncertain.slow_of(model, p) if one.kind == "parameter" and uncertain.acts_on(one, test)
        ]
        found = modes(model, test, p) if bounds else None
        if found is None:
            continue
        turning = [v for v in found.every if v.imag > 0.0]
        far = max((v.imag * max(bounds) / (2.0 * max(-v.real, 1e-9 * v.imag)) for v in turning), default=0.0)
        if far > _FAR:
            yield (
                f"{test.name}: with parameters off by {100 * max(bounds):g} % its oscillation runs {min(far, 1e6):.2g}"
                f" rad away from the plant's before it forgets, which cannot be followed: name the parameters better,"
                " or take other tests"
            )
