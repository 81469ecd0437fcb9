"""``@monitor``: a function or a class of plain Python becomes a monitor.

.. code-block:: python

    @monitor(signals=["ECM.Coolant [degC]"], fault="P0128-00")
    def cold(coolant, limit: float = 70.0):
        return Result(coolant < limit, coolant, limit)

It is called with each frame that carries one of its signals, once all of them have come. It returns whether it failed;
or a ratio, above 1 a failure; or a :class:`Result`; or None: nothing is judged now. Of several faults it returns these
by their names. State is the object's. Its kernel (:func:`step`) hands inputs to Python and takes results from there.
"""

from __future__ import annotations

import math
import numbers
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from hashlib import sha256
from pathlib import Path
from typing import Annotated, Any, NamedTuple, NoReturn

import numpy as np

from gateway.monitors import contract
from gateway.monitors.capabilities import Capability
from gateway.monitors.contract import (
    API,
    EVIDENCE,
    FAILED,
    NOT_TESTED,
    PASSED,
    TIMER,
    Debounce,
    Evidence,
    Family,
    Fault,
    Monitor,
    MonitorParams,
    Out,
    Signal,
    report,
)
from gateway.monitors.plain import calls
from gateway.monitors.plain.compilation import Compiled
from gateway.monitors.plain.signature import TIMES, Written, read
from gateway_fdi.errors import InputError, nearest
from gateway_fdi.jit import COMPILED, Record, call_entry, f8s, i8, kernel, means

#: Room for inputs, and for faults.
MOST_INPUTS, MOST_FAULTS = 64, 16
_NAME = re.compile(r"[A-Za-z0-9_-]+")
#: Limit of a verdict that is a yes or no: 1 is a failure.
_HALF = 0.5


class Result(NamedTuple):
    """Result of a test.

    Attributes:
        failed: the verdict.
        value: that was tested; NaN: nothing is.
        limit: of it, in its unit.
    """

    failed: bool
    value: float
    limit: float


class State(Record):
    """Values that the kernel gives to Python, and gets from it."""

    value: Annotated[f8s, MOST_INPUTS] = means("inputs")
    time: Annotated[f8s, 2] = means("time of the event, and since the step before", "s")
    last_ns: i8 = means("time of the step before", "ns")
    number: i8 = means("of the function that is called")
    steps: i8 = means("steps so far")
    result: Annotated[f8s, MOST_FAULTS] = means("verdict of each fault")
    tested: Annotated[f8s, MOST_FAULTS] = means("value that was tested")
    limit: Annotated[f8s, MOST_FAULTS] = means("limit of it")


class Const(Record):
    """Constants."""

    call: i8 = means("address of Python's function")
    inputs: i8 = means("inputs that are connected")
    faults: i8 = means("faults")


class Inputs(contract.Inputs):
    """Inputs of a step."""

    value: Annotated[f8s, MOST_INPUTS] = means("each input")


@kernel
def step(s: State, c: Const, u: Inputs, out: Out[Evidence, Record]) -> None:
    """Have Python take the inputs, and report what it says."""
    if u.trigger == TIMER:
        return
    for k in range(c.inputs):
        s.value[k] = u.value[k]
    s.time[0] = u.t_ns * 1e-9
    s.time[1] = (u.t_ns - s.last_ns) * 1e-9 if s.steps > 0 else 0.0
    s.last_ns, s.steps = u.t_ns, s.steps + 1
    if call_entry(c.call, s.number, 0, 0, 0) != 0:
        raise ValueError("its step failed")
    for k in range(c.faults):
        if s.result[k] == NOT_TESTED:
            continue
        e = report(out, k, s.result[k] == FAILED, s.tested[k], s.limit[k])
        for j in range(min(c.inputs, EVIDENCE)):
            e.value[j] = s.value[j]


@dataclass(frozen=True, kw_only=True)
class OfPython(Monitor[Any]):
    """A monitor whose kernel is the gateway's own, and calls an author's Python.

    Attributes:
        place: the author's file.
    """

    place: Path

    @property
    def file(self) -> Path:
        """Where it is written."""
        return self.place

    @property
    def digest(self) -> str:
        """Digest of its author's file."""
        return sha256(self.file.read_bytes()).hexdigest()


class _Written:
    """A monitor that can be called as the function or class that it is made of.

    Attributes:
        written: as its author wrote it.
    """

    written: Written

    def __call__(self, *values: Any, **parameters: Any) -> Any:
        """Call what it is made of."""
        return self.written.made(*values, **parameters)

    @property
    def file(self) -> Path:
        """Where it is written."""
        return self.written.file


@dataclass(frozen=True, kw_only=True)
class Plain(_Written, OfPython):
    """A monitor of plain Python, or compiled of it."""

    written: Written

    @property
    def gets_numbers(self) -> bool:
        """Whether its inputs are always there: unless its author said otherwise of one."""
        return not any(one.optional or one.may_be_nan or one.spare for one in self.written.inputs.values())

    @property
    def outside(self) -> bool:
        """Whether it does not come with the gateway: always, as far as it is its author's."""
        return True

    @cached_property
    def checked_entry(self) -> int:
        """Address of its kernel; that which calls Python is the gateway's own, and needs no check."""
        return self.entry if self.step is step else self._entry(checked=True)


@dataclass(frozen=True, kw_only=True)
class PlainFamily(_Written, Family[Any]):
    """A compiled monitor, whose records depend on its parameters."""

    written: Written


def monitor(
    *,
    signals: Sequence[str | Signal] | Mapping[str, str | Signal],
    fault: str | Mapping[str, str],
    debounce: Debounce | None = None,
    tested: str = "",
    compiled: bool = False,
) -> Callable[[Any], Plain | PlainFamily]:
    """Return what makes a monitor of a function, or of a class with ``update``.

    Arguments that signals stand for are inputs; ``t_s`` and ``dt_s`` are the time of the event and since the step
    before [s]; all others of a function, and those of a class' ``__init__``, are parameters: keys of its table
    ``[[monitor]]``, by their annotations.

    Args:
        signals: of the first arguments, in order; or of arguments by name. ``"Message.Signal [unit]"`` each, the
            database must say the same unit; or a :class:`gateway.monitors.contract.Signal`.
        fault: DTC of its fault, as ``"P0128-00"``; or of several: name -> DTC.
        debounce: of each fault; default: each result counts.
        tested: what is tested, with its unit, for people: ``"coolant [degC]"``.
        compiled: whether it is compiled, as :mod:`gateway.monitors.plain.compilation` can; it has one fault then.

    Raises:
        InputError: what stands below is no such function or class, signals and arguments do not go together, or it
            cannot be compiled.
    """

    def decorate(made: Any) -> Plain | PlainFamily:
        written = read(made, signals)

        def refuse(text: str) -> NoReturn:
            raise InputError(text, file=written.file, line=written.line, key=f"@monitor {written.name}")

        dtcs = {"fault": fault} if isinstance(fault, str) else fault
        if not isinstance(dtcs, Mapping) or not all(isinstance(one, str) for one in [*dtcs, *dtcs.values()]):
            refuse(f'fault is a DTC, as "P0128-00", or a dictionary of names and DTCs, not {fault!r}')
        if (wrong := next((name for name in dtcs if not _NAME.fullmatch(name)), None)) is not None:
            refuse(f"a fault's name has letters, digits, _ and -: not {wrong!r}")
        if not isinstance(debounce, Debounce | None):
            refuse(f"debounce is a Debounce(failed_after=5, passed_after=5), not {debounce!r}")
        for what, count, most in (("signals", len(written.inputs), MOST_INPUTS), ("faults", len(dtcs), MOST_FAULTS)):
            if not 1 <= count <= most:
                refuse(f"{count} {what}: 1 to {most}")
        if compiled and len(dtcs) > 1:
            refuse("compiled=True takes one fault: results by name are a dictionary")
        found = _Made(written, dtcs, debounce or Debounce(), tested)
        return found.family(Compiled(written)) if compiled and COMPILED else found.plain()

    return decorate


@dataclass(frozen=True)
class _Made:
    """Makes monitors of what an author wrote."""

    written: Written
    dtcs: Mapping[str, str]
    debounce: Debounce
    tested: str

    def plain(self) -> Plain:
        """Return one that calls Python."""
        written, names = self.written, tuple(self.dtcs)
        return self._monitor(
            State, Const, step, lambda p, s, c: _prepare(written, names, p, s, c), capabilities=(calls.FAILURE,)
        )

    def family(self, compiled: Compiled) -> PlainFamily:
        """Return one that is compiled: its records depend on the parameters."""
        written = self.written

        @lru_cache(maxsize=32)
        def of(text: str) -> Plain:
            state, const, fill = compiled.records(written.params.model_validate_json(text))
            return self._monitor(state, const, compiled.source(), lambda _, s, c: fill(s, c))

        def made(params: MonitorParams, _: Path) -> Plain:
            return of(params.model_dump_json())

        return PlainFamily(type=written.name, api=API, params=written.params, made=made, written=written)

    def _monitor(
        self,
        state: type[Record],
        const: type[Record],
        kernel_: Callable[..., None],
        prepare: Callable[[Any, Any, Any], None],
        capabilities: tuple[Capability, ...] = (),
    ) -> Plain:
        written = self.written
        shown = tuple(_label(name, signal) for name, signal in written.inputs.items())[:EVIDENCE]
        found = tuple(
            Fault(
                name,
                dtc,
                written.text if len(self.dtcs) == 1 else f"{written.text}: {name.replace('_', ' ')}",
                shown,
                self.debounce,
                tested=self.tested,
            )
            for name, dtc in self.dtcs.items()
        )
        room = [*written.inputs.values(), *[None] * (MOST_INPUTS - len(written.inputs))]
        return Plain(
            type=written.name,
            api=API,
            params=written.params,
            state=state,
            const=const,
            inputs=Inputs,
            evidence=Evidence,
            step=kernel_,
            connect=lambda _: {"value": room},
            prepare=prepare,
            faults=lambda _: found,
            capabilities=capabilities,
            place=written.file,
            written=written,
        )


def _label(name: str, signal: Signal) -> str:
    return f"{name} [{signal.unit}]" if signal.unit else name


def _prepare(written: Written, faults: tuple[str, ...], p: MonitorParams, s: Any, c: Any) -> None:
    c.call, c.inputs, c.faults = calls.address(), len(written.inputs), len(faults)
    s.number = calls.enter(_stepper(written, faults, p, s), s)


def _stepper(written: Written, faults: tuple[str, ...], p: MonitorParams, s: Any) -> Callable[[], None]:
    """Return what takes the inputs from the state, and puts the results there."""
    update, names = written.instance(p), list(written.inputs)
    places = [names.index(name) if name in names else len(names) + TIMES.index(name) for name in written.arguments]
    value, time = s.value[: len(names)], s.time
    results = [(s.result[k : k + 1], s.tested[k : k + 1], s.limit[k : k + 1]) for k in range(len(faults))]
    plain = written.arguments == tuple(names)

    def put(k: int, found: Any) -> None:
        result, tested, limit = results[k]
        result[0], tested[0], limit[0] = _judged(found)

    def take() -> Any:
        if plain:
            return update(*value.tolist())
        all_ = value.tolist() + time.tolist()
        return update(*[all_[place] for place in places])

    def one() -> None:
        put(0, take())

    def several() -> None:
        found = take()
        for k in range(len(faults)):
            put(k, None)
        for name, result in _by_name(found, faults):
            put(faults.index(name), result)

    return one if len(faults) == 1 else several


def _by_name(found: Any, faults: Sequence[str]) -> Iterable[tuple[str, Any]]:
    if found is None:
        return ()
    if not isinstance(found, Mapping):
        raise TypeError(f"of several faults it returns results by name, {{{faults[0]!r}: ...}}, not {found!r}")
    for name in found:
        if name not in faults:
            raise ValueError(f"it returns a result of {name!r}, which is none of its faults{nearest(name, faults)}")
    return found.items()


def _judged(found: Any) -> tuple[int, float, float]:
    """Return verdict, tested value and limit of what a step returned."""
    if found is None:
        return NOT_TESTED, 0.0, 0.0
    if isinstance(found, bool | np.bool_):
        return FAILED if found else PASSED, float(found), _HALF
    if isinstance(found, Result):
        failed, value, limit = found
        if not isinstance(failed, bool | np.bool_):
            raise TypeError(f"Result(failed, value, limit): failed is True or False, not {failed!r}")
        return FAILED if failed else PASSED, float(value), float(limit)
    if isinstance(found, numbers.Real):
        ratio = float(found)
        return NOT_TESTED if math.isnan(ratio) else FAILED if ratio > 1.0 else PASSED, ratio, 1.0
    raise TypeError(f"it returns True, False, a ratio, a Result or None, not {found!r}")
