"""A model run over time: inputs and faults by courses, the states by SciPy's solver (LSODA: stiff and smooth systems).

The solver starts again wherever an input bends or a fault sets in, so that no step goes over one.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.optimize import root

from gateway_fdi.structure.generator.symbols import Symbols
from gateway_fdi.structure.model import Model, Quantity
from gateway_fdi.structure.simulation.reduction import NotSimulatedError, reduce
from gateway_fdi.structure.simulation.system import System, system_of

Values = NDArray[np.float64]

#: Relative and absolute tolerance of the solver.
TOLERANCE, FLOOR = 1e-7, 1e-9
#: A jump at the last time lies before the end [s].
_BEHIND = 1e-6
#: Points in time at which variables are computed at once.
_PORTION = 20_000


@dataclass(frozen=True)
class Course:
    """A value over time: breakpoints, linear between them, constant beyond.

    Attributes:
        t: times [s], rising; two at the same time are a jump.
        value: at these.
        repeat_s: it starts again after this time [s]; 0: never.
    """

    t: tuple[float, ...]
    value: tuple[float, ...]
    repeat_s: float = 0.0

    def local(self, t: Values) -> Values:
        """Return times within the course."""
        return t % self.repeat_s if self.repeat_s else t

    def at(self, t: Values, inside: float) -> Values:
        """Return the values at times of one segment, of which ``inside`` is one where nothing jumps."""
        first, rate = self._line(inside)
        return first + rate * (t - inside)

    def rate(self, inside: float) -> float:
        """Return the slope in the segment around a time."""
        return self._line(inside)[1]

    def _line(self, inside: float) -> tuple[float, float]:
        here = inside % self.repeat_s if self.repeat_s else inside
        k = int(np.searchsorted(self.t, here, side="right"))
        if k == 0 or k == len(self.t):
            return self.value[min(k, len(self.t) - 1)], 0.0
        rate = (self.value[k] - self.value[k - 1]) / (self.t[k] - self.t[k - 1])
        return self.value[k - 1] + rate * (here - self.t[k - 1]), rate

    def bends(self, until: float) -> Iterable[float]:
        """Return the times at which it bends or jumps."""
        rounds = math.ceil(until / self.repeat_s) if self.repeat_s else 1
        for k in range(rounds):
            yield from (k * self.repeat_s + t for t in self.t)
            if self.repeat_s:
                yield (k + 1) * self.repeat_s


def constant(value: float) -> Course:
    """Return the course that stays at a value."""
    return Course((0.0,), (value,))


class Plant:
    """A model that can be run.

    Args:
        inputs: a course for each variable that is given: commands, loads; the others are computed.
        parameters: values instead of the model's.
        start: where states begin; those that it does not name begin at the model's start value.
        rest: states without a start value begin where they stay; else at 0.

    Raises:
        NotSimulatedError: it cannot be simulated.
    """

    def __init__(
        self,
        model: Model,
        inputs: Mapping[str, Course],
        *,
        parameters: Mapping[str, float] | None = None,
        start: Mapping[str, float] | None = None,
        rest: bool = False,
    ) -> None:
        self.model, self.inputs = model, dict(inputs)
        own = {p: model.quantities.get(p, Quantity()).value for p in model.parameters}
        self.values = {p: v for p, v in own.items() if v is not None} | dict(parameters or {})
        lacking = [p for p in model.parameters if p not in self.values]
        if lacking:
            raise NotSimulatedError(f"parameter {', '.join(lacking)} has no value")
        begins = {x: model.quantities.get(x, Quantity()).value for x in model.states}
        given = {x: v for x, v in begins.items() if v is not None} | dict(start or {})
        symbols = Symbols(model, faulty=True)
        there = self.values | given | {z: float(c.at(np.zeros(1), 1e-9)[0]) for z, c in self.inputs.items()}
        reduced = reduce(model, symbols, tuple(self.inputs), there, tuple(start or {}))
        for x in start or {}:
            if x in reduced.bound:
                raise NotSimulatedError(f"{x} follows from other states, and cannot begin at a given value")
        self.system: System = system_of(model, symbols, reduced, tuple(self.inputs), self.values)
        names = self.system.names[: self.system.states]
        self.start = np.array([given.get(x, 0.0) for x in names], np.float64)
        if rest:
            self._rest([k for k, x in enumerate(names) if x not in given])

    def _told(self, inside: float) -> tuple[Values, Values]:
        courses = self.inputs.values()
        at = np.array([inside])
        return np.array([c.at(at, inside)[0] for c in courses]), np.array([c.rate(inside) for c in courses])

    def _rest(self, free: Sequence[int]) -> None:
        """Let states begin where they stay."""
        if not free:
            return
        told, _ = self._told(1e-9)
        nothing, none = np.zeros(len(told)), np.zeros(len(self.model.faults))

        def slopes(values: Values) -> Values:
            s = self.start.copy()
            s[free] = values
            found = self.system.rate(s, told, nothing, none)
            return np.where(np.isfinite(found), found, 1e6)[free]

        for guess in (self.start[free], np.ones(len(free)), np.full(len(free), 100.0)):
            with np.errstate(all="ignore"):
                found = root(slopes, guess)
                off = np.abs(slopes(found.x)).max()
            if np.isfinite(found.x).all() and off < 1e-6 * (1.0 + np.abs(found.x).max()):
                self.start[free] = found.x
                return
        names = ", ".join(self.system.names[k] for k in free)
        raise NotSimulatedError(f"no state of rest of {names} is found: say where they begin")

    def run(
        self, times: Values, faults: Mapping[str, Course] | None = None, *, longest_s: float = 1.0
    ) -> dict[str, Values]:
        """Return all variables, derivatives and known ones too, at times.

        Args:
            times: rising from 0 on [s], shape (n,).
            faults: a course for each fault that is not always zero.
            longest_s: step of the solver [s].

        Raises:
            NotSimulatedError: the equations give no number somewhere, or the solver gets no further.
        """
        courses = [(faults or {}).get(f, constant(0.0)) for f in self.model.faults]
        end = float(times[-1]) + _BEHIND
        marks = {t for c in (*self.inputs.values(), *courses) for t in c.bends(end) if 0.0 < t < end}
        edges = [0.0, *sorted(marks), end]
        edges = [edges[0], *(b for a, b in pairwise(edges) if b - a > 1e-9)]
        rows = np.empty((len(self.system.names), len(times)))
        told = np.empty((len(self.inputs), len(times)))
        state, done = self.start.copy(), 0
        for k, (begin, until) in enumerate(zip(edges, edges[1:] or [end], strict=False)):
            last = k == len(edges) - 2 or len(edges) == 1
            stop = len(times) if last else int(np.searchsorted(times, until))
            state = self._segment(begin, until, state, times[done:stop], courses, (rows, told), done, longest_s)
            done = stop
        return dict(zip(self.system.names, rows, strict=True)) | dict(zip(self.inputs, told, strict=True))

    def _segment(
        self,
        begin: float,
        end: float,
        state: Values,
        times: Values,
        faults: Sequence[Course],
        out: tuple[Values, Values],
        first: int,
        longest_s: float,
    ) -> Values:
        """Run one segment, in which nothing bends; returns the states at its end."""
        inside = 0.5 * (begin + end)
        u0, du = self._told(inside)
        f0 = np.array([c.at(np.array([inside]), inside)[0] for c in faults])
        df = np.array([c.rate(inside) for c in faults])
        broken: list[float] = []

        def slopes(t: float, s: Values) -> Values:
            found = self.system.rate(s, u0 + du * (t - inside), du, f0 + df * (t - inside))
            if not np.isfinite(found).all():
                broken.append(t)
                raise FloatingPointError
            return found

        wanted = np.unique(np.append(np.clip(times, begin, end), [begin, end]))
        grid = np.empty((len(state), len(wanted)))
        if len(state) and end > begin:
            try:
                with np.errstate(all="ignore"):
                    solved = solve_ivp(
                        slopes, (begin, end), state, "LSODA", wanted, rtol=TOLERANCE, atol=FLOOR, max_step=longest_s
                    )
            except FloatingPointError:
                raise NotSimulatedError(self._broken(broken[0])) from None
            if not solved.success or solved.y.shape[1] != len(wanted):
                raise NotSimulatedError(f"the solver gets no further than t = {solved.t[-1]:.6g} s: {solved.message}")
            grid = solved.y
        elif len(state):
            grid[:] = state[:, None]
        if len(times):
            at = np.searchsorted(wanted, np.clip(times, begin, end))
            for low in range(0, len(times), _PORTION):
                part = slice(low, min(low + _PORTION, len(times)))
                t = times[part] - inside
                u = u0[:, None] + du[:, None] * t
                f = f0[:, None] + df[:, None] * t
                rows = self.system.all_of(grid[:, at[part]], u, np.broadcast_to(du[:, None], u.shape), f)
                where = slice(first + low, first + low + len(t))
                out[0][:, where], out[1][:, where] = rows, u
                wrong = ~np.isfinite(rows).all(0)
                if wrong.any():
                    raise NotSimulatedError(self._broken(float(times[part][wrong][0])))
        return np.asarray(grid[:, -1], np.float64)

    def _broken(self, t: float) -> str:
        return f"the equations of {self.model.name} give no number at t = {t:.6g} s (a division by zero, or a root)"
