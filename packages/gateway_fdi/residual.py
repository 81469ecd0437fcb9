"""Residuals of a model over arrays: its equations become code, and that is run."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gateway_fdi.common.log import get_logger
from gateway_fdi.detectors import numbers
from gateway_fdi.errors import InputError, as_input, named
from gateway_fdi.jit import zeros
from gateway_fdi.structure.analysis import Analysis, analyse
from gateway_fdi.structure.generator.records import field_name
from gateway_fdi.structure.isolability import signatures
from gateway_fdi.structure.model import Model, ResidualChoice, with_sizes

if TYPE_CHECKING:
    from gateway_fdi.structure.generator.loading import Loaded

log = get_logger(__name__)


class Residual:
    """A residual generator: an equation that is not needed, checked by all others of its set.

    Args:
        model: with relations (:func:`gateway_fdi.load_model`).
        test: the name of one of its residuals, ``"SET:EQUATION"`` with a set of :func:`gateway_fdi.analyse`, or the
            equations themselves.
        values: values of parameters instead of the model's.
        filter_bandwidth: of what is checked [rad/s].
        differentiate: whether known variables may be differentiated, by a filter.

    Attributes:
        name: of the test.
        faults: of the model, that it sees.
        knowns: variables that it reads.

    Raises:
        InputError: no such test, or one that cannot be computed.
    """

    def __init__(
        self,
        model: Model,
        test: str | ResidualChoice,
        *,
        values: Mapping[str, float] | None = None,
        filter_bandwidth: float = 0.5,
        differentiate: bool = False,
    ) -> None:
        if isinstance(test, ResidualChoice):
            choice, self.name = test, test.consistency
        else:
            known = test in model.residuals
            choice, self.name = model.residuals[test] if known else analyse(model).choice(test), test
        self._model, self._choice, self._differentiate = model, choice, differentiate
        self._values, self._bandwidth = dict(values or {}), filter_bandwidth
        with as_input("test", self.name):
            self._loaded = _made(model, choice, self.name, differentiate=differentiate)
        row = np.array([[equation.name in choice.equations for equation in model.equations]])
        seen = signatures(model, row)[0]
        self.faults = tuple(fault for fault, there in zip(model.faults, seen, strict=True) if there)
        self._fields = {field_name(name): name for name in model.knowns}
        self.knowns = tuple(self._fields.get(field, field) for field in self._loaded.generated.knowns)
        with as_input("values"):
            self._c = self._constants(self._loaded, {})

    def __repr__(self) -> str:
        return f"Residual({self.name}: reads {', '.join(self.knowns)}; sees {', '.join(self.faults) or 'no fault'})"

    def run(self, t_s: ArrayLike, known: Mapping[str, ArrayLike]) -> NDArray[np.float64]:
        """Return the residual of a whole record; its states begin with the first sample.

        Args:
            t_s: times, shape (n,), n at least 2, rising [s].
            known: variable -> values, shape (n,) or a number; those that it does not read are left out.

        Raises:
            InputError: a variable is missing, or has another shape; times that do not rise.
        """
        times = self._times(t_s)
        rows = self._rows(self._loaded, times, known)
        s = _begun(self._loaded, self._c, rows[0])
        return self._loaded.over(s, self._c, rows, np.diff(times, prepend=times[0]))

    def gain(
        self, fault: str, t_s: ArrayLike, known: Mapping[str, ArrayLike], *, size: float = 1e-4, since: int = 0
    ) -> NDArray[np.float64]:
        """Return the residual that a fault leaves, for each 1 of its size, shape (n,).

        The set of equations is solved once more, with the fault in it: what is left then is what the fault does not
        explain, r(0) - r(size) = gain size. With a small size that is the slope, with the fault's own it is exact. So
        a fault explains residuals if one size explains each (directional residuals: Gertler, "Fault detection and
        diagnosis in engineering systems", 1998).

        Args:
            fault: one of :attr:`faults`.
            t_s: as :meth:`run` takes them.
            known: likewise.
            size: of the fault, in its unit, not 0.
            since: first sample with the fault, 0 to n - 1.

        Raises:
            InputError: as of :meth:`run`; it does not see the fault, or algebra does not solve the set with it;
                the size is 0 or no number, or the sample is not in the record.
        """
        if fault not in self.faults:
            raise InputError(
                named(f"the faults that {self.name} sees are", fault, self.faults), key="fault", value=fault
            )
        if not math.isfinite(size) or size == 0.0:
            raise InputError("a number that is not 0", key="size", value=size)
        times = self._times(t_s)
        if not 0 <= since < len(times):
            raise InputError(f"a sample of the record: 0 to {len(times) - 1}", key="since", value=since)
        rows = self._rows(self._faulty, times, known)
        steps = np.diff(times, prepend=times[0])
        fine, faulty = (self._constants(self._faulty, {fault: each}) for each in (0.0, size))
        s = _begun(self._faulty, fine, rows[0])
        self._faulty.over(s, fine, rows[:since], steps[:since])
        other = np.array([s])[0] if since else _begun(self._faulty, faulty, rows[0])
        found = np.zeros(len(times))
        found[since:] = self._faulty.over(s, fine, rows[since:], steps[since:])
        found[since:] -= self._faulty.over(other, faulty, rows[since:], steps[since:])
        return found / size

    @cached_property
    def _faulty(self) -> Loaded:
        """The same residual with each fault as a parameter."""
        with as_input("test", self.name):
            return _made(with_sizes(self._model), self._choice, self.name, differentiate=self._differentiate)

    def _constants(self, loaded: Loaded, more: Mapping[str, float]) -> np.void:
        c: np.void = zeros(1, loaded.const)[0]
        loaded.prepare(c, values={**self._values, **more}, filter_bandwidth=self._bandwidth)
        return c

    def _times(self, t_s: ArrayLike) -> NDArray[np.float64]:
        times = numbers(t_s, "t_s")
        if len(times) < 2 or not (np.diff(times) > 0.0).all():
            raise InputError("two times at least, each after the one before", key="t_s")
        return times

    def _rows(self, loaded: Loaded, times: NDArray[np.float64], known: Mapping[str, ArrayLike]) -> NDArray[np.void]:
        rows: NDArray[np.void] = zeros(len(times), loaded.inputs)
        for field in loaded.generated.knowns:
            name = self._fields.get(field, field)
            if name not in known:
                raise InputError(named("this residual reads; there are", name, known), key=name)
            with as_input(name):
                rows[field] = np.broadcast_to(np.asarray(known[name], np.float64), times.shape)
        for field in loaded.generated.rates:
            rows[field] = _rate(field, rows, times)
        return rows


def _begun(loaded: Loaded, c: np.void, row: np.void) -> np.void:
    s: np.void = zeros(1, loaded.state)[0]
    loaded.reset(s, c)
    loaded.start(s, c, row)
    return s


def _made(model: Model, choice: ResidualChoice, name: str, *, differentiate: bool) -> Loaded:
    try:
        from gateway_fdi.structure.generator.loading import residual_generator  # noqa: PLC0415 - slow, and an extra
    except ImportError as error:
        told = "code of equations needs sympy: pip install '.[structure]' in the checkout"
        raise InputError(told, value=name) from error
    return residual_generator(model, choice.equations, choice.consistency, name=name, differentiate=differentiate)


def _rate(field: str, rows: NDArray[np.void], times: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the derivative that a field named ``<known>_rate<order>`` is for, of the record's beginning."""
    name, _, order = field.rpartition("_rate")
    values: NDArray[np.float64] = rows[name]
    for _ in range(int(order)):
        values = np.gradient(values, times)
    return values


def residuals(model: Model, **options: bool | float) -> list[Residual]:
    """Return the fewest residuals that tell apart as much as all that the structure gives.

    A set of equations that algebra does not solve is left out. Faults that no residual sees then are logged: sets that
    could stand for it often integrate what hardly forgets, and name healthy parts.

    Args:
        model: with relations.
        options: of :class:`Residual`.

    Raises:
        InputError: no set of them can be computed.
    """
    analysis = analyse(model)
    made: list[Residual] = []
    for number in analysis.fewest:
        made += list(of_set(analysis, int(number), options))[:1]
    if not made:
        raise InputError("no equation of the model can be checked by the others", key="model", value=model.name)
    unseen = [fault for fault in model.faults if not any(fault in one.faults for one in made)]
    if unseen:
        log.warning("no residual that can be computed sees some faults", model=model.name, faults=", ".join(unseen))
    return made


def of_set(analysis: Analysis, number: int, options: Mapping[str, bool | float]) -> Iterator[Residual]:
    """Yield what checks a set, best first: without a derivative, then of the fewest solutions."""
    candidates = analysis.candidates
    mine = np.flatnonzero((candidates.mso == number) & candidates.chosen("SDI", "unique"))
    for k in sorted(mine.tolist(), key=lambda k: (bool(candidates.derivative_in_sequence[k]), candidates.causality(k))):
        name = f"{number + 1}:{analysis.structure.equations[candidates.equation[k]]}"
        try:
            yield Residual(analysis.model, analysis.choice(name), **options)  # type: ignore[arg-type]
        except InputError as error:
            if error.key != "test":  # else the structure says that it can be solved, and algebra does not find it
                raise
