"""The contract between a monitor and the engine: parameters, records, inputs, kernel, faults, outputs.

A monitor steps when its event arrives (a frame that carries its inputs, or a timer that it asked for) and reports
**test results**, never DTCs. Debounce and the fault memory decide what becomes of them.

Its kernel is ``step(s, c, u, out)`` over four records: state, constants, inputs of this event, and :class:`Out`. It
never reads a clock; ``u.t_ns`` is the event's own time. It need not report each time: debounce holds while nothing is
reported.

:mod:`gateway.monitors.conformance` checks all of it once, when the engine is built.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, ClassVar, Generic, Protocol, TypeAlias, TypeVar, cast

import numpy as np
from pydantic import model_validator

from gateway.monitors.authors import by_author
from gateway.monitors.capabilities import (
    TOGETHER,
    VAGUE,
    Behind,
    Blame,
    Blames,
    C,
    Calibration,
    Capability,
    CusumCalibration,
    Failure,
    Gain,
    LastResult,
    Measured,
    Notes,
    Numbered,
    Parts,
    Quantities,
    Quantity,
    Reading,
    Readout,
    Refined,
    Refinement,
    Residuals,
    Sampled,
    SensorCalibration,
    Suspects,
    Warnings,
)
from gateway.monitors.sampling import MOST_MESSAGES
from gateway_fdi.common.tomlfile import StrictModel
from gateway_fdi.errors import GatewayError, InputError
from gateway_fdi.jit import Closure, Record, entry_point, f8, f8s, failure_of, i4, i8, kernel, means, record

#: Those of capabilities.py: authors import all from here.
__all__ = [
    "TOGETHER",
    "VAGUE",
    "Behind",
    "Blame",
    "Blames",
    "Calibration",
    "Capability",
    "CusumCalibration",
    "Failure",
    "Gain",
    "LastResult",
    "Measured",
    "Notes",
    "Numbered",
    "Parts",
    "Quantities",
    "Quantity",
    "Reading",
    "Readout",
    "Refined",
    "Refinement",
    "Residuals",
    "Sampled",
    "SensorCalibration",
    "Suspects",
    "Warnings",
]

#: Version of this contract. A monitor says for which it was written.
API = 2

#: Values of evidence that one test result can carry.
EVIDENCE = 8
#: Test results that one step can report.
MAX_RESULTS = 128
#: Values that a monitor's own message can have.
MAX_OUTPUTS = 16

NOT_TESTED, PASSED, FAILED = 0, 1, 2

#: ``u.trigger`` of a step that a timer caused; otherwise the index of the message that did.
TIMER = -1

#: Least time from a step that a timer caused to the next one [ns]: a monitor that wakes itself at once stops no other.
LEAST_SLEEP_NS = 100_000

#: Slips of a step, in words.
COUNTS_ITSELF = "it changes out.n or out.overflow itself; only report(out, ...) does"
WAKES_ITSELF = (
    f"it wakes itself at once: a step that a timer caused is followed by another {LEAST_SLEEP_NS // 1000} us later at"
    " the earliest"
)

#: Where a compiler says that something is wrong.
_PLACES = re.compile(r"""File "([^"]+)", line (\d+)""")

#: Packages of the gateway's kernels, and how generated modules begin: their indices need no check.
OWN_PACKAGES, GENERATED = ("gateway", "gateway_fdi", "gateway_checks", "gateway_plants"), "gateway_generated_"

#: Takes the results beyond :data:`MAX_RESULTS`, so that a kernel need not ask.
_SPARE = MAX_RESULTS

RESULT = record(fault=i4, result=i4, value=f8, threshold=f8, evidence=(f8, EVIDENCE))
#: Results of a step, as the engine sees them; a monitor's kernel sees :class:`Out`.
RESULTS = record(
    n=i8,
    overflow=i8,
    wake_ns=i8,
    send=i8,
    values=(f8, MAX_OUTPUTS),
    results=(RESULT, MAX_RESULTS + 1),
)

E = TypeVar("E")
V = TypeVar("V")
P = TypeVar("P", bound="MonitorParams")
T = TypeVar("T")
#: Within Monitor ``type`` is its name.
Class: TypeAlias = type[T]


class Result(Protocol[E]):
    """One test result: fault (its number in the monitor), PASSED or FAILED, value and limit, evidence."""

    fault: int
    result: int
    value: float
    threshold: float
    evidence: E


class Out(Protocol[E, V]):
    """Results of a step.

    Attributes:
        n: results so far (see :func:`report`).
        overflow: results there was no room for.
        wake_ns: when the monitor wants to be woken if nothing comes in between [ns, 0: never]; after a step that a
            timer caused, :data:`LEAST_SLEEP_NS` later at the earliest.
        send: 1: send the monitor's own message, with ``values``.
        values: record of the monitor's outputs.
        results: the results, by :func:`report`.
    """

    n: int
    overflow: int
    wake_ns: int
    send: int
    values: V
    results: list[Result[E]]


class Inputs(Record):
    """Base of a monitor's inputs: the event's time and cause; its own fields, all float64, follow."""

    t_ns: i8 = means("time of the event", "ns")
    trigger: i8 = means("index of the message that caused it, or TIMER")


class SampledInputs(Inputs):
    """Base of the inputs of a monitor that steps once a sample (:class:`Sampled`).

    Its messages are those whose signals trigger, in the order of the inputs; at most ``MOST_MESSAGES``.
    """

    gap: f8 = means("samples from the one before to this one; 1: none is missing between")
    missing: f8 = means("bits of the messages that are missing in this sample, whose inputs are NaN")
    which: f8 = means("of several samplings, by its place; the inputs of the others are those of their newest samples")
    waited: Annotated[f8s, MOST_MESSAGES] = means("how long ago each message was due; NaN: it is missing", "s")


class Evidence(Record):
    """Evidence of a monitor that has no record of its own for it."""

    value: Annotated[f8s, EVIDENCE] = means("value")


@kernel
def report(out: Out[E, V], fault: int, failed: bool, value: float, threshold: float) -> E:
    """Report a test result; returns its record of evidence, all 0, to be filled.

    Args:
        out: of the step.
        fault: index in the monitor's faults.
        failed: the verdict.
        value: tested value (a residual, a distance, a count); NaN: the fault is not tested, with either verdict.
        threshold: its limit, same unit; NaN likewise.
    """
    place = out.n
    if place < MAX_RESULTS:
        out.n = place + 1
    else:
        out.overflow += 1
        place = _SPARE
    result = out.results[place]
    result.fault = fault
    result.result = FAILED if failed else PASSED
    result.value = value
    result.threshold = threshold
    cells = result.cells  # type: ignore[attr-defined] # the evidence, as numbers
    for k in range(EVIDENCE):
        cells[k] = 0.0
    return result.evidence


def results_of(evidence: np.dtype[Any], outputs: np.dtype[Any] | None) -> np.dtype[np.void]:
    """Return RESULTS with evidence and values as records of a monitor's own, in the same places."""
    of_result = {name: (RESULT[name], int(cast(Any, RESULT.fields)[name][1])) for name in RESULT.names or ()}
    cells, at = of_result["evidence"]
    of_result["cells"] = (cells, at)
    of_result["evidence"] = (evidence, at)
    one = _laid_out(of_result, RESULT.itemsize)
    whole = {name: (RESULTS[name], int(cast(Any, RESULTS.fields)[name][1])) for name in RESULTS.names or ()}
    if outputs is not None:
        whole["values"] = (outputs, whole["values"][1])
    whole["results"] = (np.dtype((one, (MAX_RESULTS + 1,))), whole["results"][1])
    return _laid_out(whole, RESULTS.itemsize)


def _laid_out(parts: Mapping[str, tuple[np.dtype[Any], int]], size: int) -> np.dtype[np.void]:
    forms = {
        "names": list(parts),
        "formats": [form for form, _ in parts.values()],
        "offsets": [at for _, at in parts.values()],
        "itemsize": size,
    }
    return cast("np.dtype[np.void]", np.dtype(cast(Any, forms), align=True))


class MonitorParams(StrictModel):
    """Base of the parameters of a monitor; units stand in the field descriptions."""

    #: Keys that are gone, and where to: told instead of "no such key". ``name = value`` for one value of a key.
    moved: ClassVar[Mapping[str, str]] = {}

    @model_validator(mode="before")
    @classmethod
    def _refuse_moved(cls, data: Any) -> Any:
        for key, where in cls.moved.items():
            name, _, value = key.partition(" = ")
            if isinstance(data, dict) and name in data and value in ("", str(data[name])):
                raise ValueError(f"{name} = {data[name]!r}: {where}")
        return data


@dataclass(frozen=True)
class Debounce:
    """How test results become a qualified verdict (AUTOSAR DEM, counter based or time based).

    Counter based: a failed result adds ``failed_step``, a passed one takes ``passed_step`` away; +failed_after
    qualifies a failure, -passed_after a pass. Before it counts, a result lifts (lowers) the counter to
    ``jump_up_to`` (``jump_down_to``) if that jump is on.

    Time based, if ``failed_ms`` and ``passed_ms`` are set: a verdict is qualified when results have said the
    same for that long, whether they are repeated or not; a result of the other kind starts the other time.
    """

    failed_after: int = 1
    passed_after: int = 1
    jump_up: bool = True
    jump_down: bool = False
    failed_step: int = 1
    passed_step: int = 1
    jump_up_to: int = 0
    jump_down_to: int = 0
    failed_ms: float | None = None
    passed_ms: float | None = None

    @property
    def timed(self) -> bool:
        """Whether it is time based."""
        return self.failed_ms is not None and self.passed_ms is not None

    def changed(self, settings: Mapping[str, Any]) -> Debounce:
        """Return it with other settings; those of a counter end a debounce by time."""
        if not settings:
            return self
        timeless = {} if "failed_ms" in settings else {"failed_ms": None, "passed_ms": None}
        return replace(self, **{**timeless, **settings})


@dataclass(frozen=True)
class Fault:
    """A fault that a monitor can report.

    Attributes:
        name: within the monitor; the fault's id is ``<monitor>.<name>``.
        dtc: default DTC, SAE J2012 base code and failure type byte, e.g. ``"P0336-39"``.
        description: one line for people.
        evidence: names (with units) of the values in ``result.evidence``; of a record: ``labels(Evidence)``.
        debounce: default debounce.
        remedy: what to do about it, for people; "": as for any fault of its failure type.
        tested: name of ``result.value`` and ``result.threshold`` for people, with their unit as in evidence:
            ``"pulse away from its place [pitch]"``; "": not said.
        window_s: time of values that one result is of [s].
    """

    name: str
    dtc: str
    description: str
    evidence: tuple[str, ...] = ()
    debounce: Debounce = field(default_factory=Debounce)
    remedy: str = ""
    tested: str = ""
    window_s: float = 0.0


@dataclass(frozen=True)
class Signal:
    """A signal that an input is connected to.

    Attributes:
        name: ``"Message.Signal"``; the user's configuration may put another in its place.
        unit: that the database must give for it; None: any.
        triggers: whether its message steps the monitor.
        optional: its message need not come: the input is NaN until it does, and the monitor steps without it.
        may_be_nan: the input is NaN, too, while its message carries no valid value of it. A monitor all of whose inputs
            may be so steps with such a message; else it is as one that was not there.
        spare: the database need not have it: the input is NaN then.
    """

    name: str
    unit: str | None = None
    triggers: bool = False
    optional: bool = False
    may_be_nan: bool = False
    spare: bool = False


#: Connection of an input: a signal, one for each element of an array, or nothing (it is NaN).
Connection = Signal | Sequence[Signal | None] | None


@dataclass(frozen=True)
class Emission:
    """A message that a monitor sends.

    Signals ``FrameCnt`` and ``Crc`` of the message, where it has them, are filled by the engine.

    Attributes:
        message: its name.
        signals: field of the monitor's outputs -> signal of the message, or one for each element of an array.
    """

    message: str
    signals: Mapping[str, str | Sequence[str]]

    @property
    def names(self) -> tuple[str, ...]:
        """The signals, one after the other."""
        found: list[str] = []
        for names in self.signals.values():
            found += [names] if isinstance(names, str) else names
        return tuple(found)


@dataclass(frozen=True, kw_only=True)
class Monitor(Generic[P]):
    """A type of monitor; configured instances of it share the kernel.

    Attributes:
        type: its name in the configuration.
        api: version of the contract that it was written for: :data:`API`, as a number.
        params: pydantic model of its parameters.
        state, const, inputs: classes of its records; the inputs derive from :class:`Inputs`.
        step: its kernel.
        connect: parameters -> field of the inputs -> its connection.
        prepare: parameters, state record, record of constants: fills both before the first step.
        faults: parameters -> its faults; ``report`` counts them from 0.
        evidence: record class of the evidence of its results.
        outputs: record class of the values that it sends; None: it sends nothing.
        emits: parameters -> the message that it can send.
        triggers: parameters -> messages that step it beside those of its signals that trigger.
        capabilities: what else it can do.
        trusted: whether its author vouches for its kernel: its indices are not checked where the configuration says
            ``trusted = true``, too.
    """

    type: str
    api: int
    params: Class[P]
    state: Class[Record]
    const: Class[Record]
    inputs: Class[Inputs]
    step: Callable[..., None]
    connect: Callable[[P], Mapping[str, Connection]]
    prepare: Callable[[P, Any, Any], None]
    faults: Callable[[P], tuple[Fault, ...]]
    evidence: Class[Record] = Evidence
    outputs: Class[Record] | None = None
    emits: Callable[[P], Emission] | None = None
    triggers: Callable[[P], tuple[str, ...]] | None = None
    capabilities: tuple[Capability, ...] = ()
    trusted: bool = False

    def capability(self, kind: Class[C]) -> C | None:
        """Return its capability of a class; failures in one from outside are told as its author's."""
        for found in self.capabilities:
            if isinstance(found, kind):
                return self._by_author(found) if self.outside else found
        return None

    def _by_author(self, found: C) -> C:
        name, called = type(found).__name__, {each.name: getattr(found, each.name) for each in fields(found)}
        own: dict[str, Any] = {
            key: by_author(self, f"{name}.{key}", value) for key, value in called.items() if callable(value)
        }
        return replace(found, **own)

    @property
    def header(self) -> int:
        """Numbers of its inputs before those that are connected."""
        own = SampledInputs if issubclass(self.inputs, SampledInputs) else Inputs
        return own.dtype.itemsize // 8

    def failure(self, state: Any, why: int) -> str:
        """Return how a step failed, in words.

        Args:
            state: record of it.
            why: as :func:`gateway_fdi.jit.call_entry` told it; not 0.
        """
        own = self.capability(Failure)
        return (own.of(state) if own is not None else "") or failure_of(why)

    @property
    def readout(self) -> tuple[str, ...]:
        """Fields of the state that people are shown."""
        found = self.capability(Readout)
        return () if found is None else found.names

    def warnings(self, params: P) -> tuple[str, ...]:
        """Return what ``gateway check`` says of parameters, though they are not wrong."""
        found = self.capability(Warnings)
        return () if found is None else self._lines("Warnings", found.of(params))

    def notes(self, params: P) -> tuple[str, ...]:
        """Return what ``gateway check`` tells of what will run."""
        found = self.capability(Notes)
        return () if found is None else self._lines("Notes", found.of(params))

    def _lines(self, kind: str, given: object) -> tuple[str, ...]:
        if isinstance(given, tuple | list) and all(isinstance(line, str) for line in given):
            return tuple(given)
        text = f"lines, a tuple of texts, not {type(given).__name__}"
        raise InputError(text, file=self.file, key=f'monitor type "{self.type}".{kind}.of')

    @cached_property
    def results(self) -> np.dtype[np.void]:
        """Record that its kernel reports into: RESULTS, with its own evidence and outputs."""
        return results_of(
            self.evidence.dtype,
            None if self.outputs is None else self.outputs.dtype,
        )

    @property
    def file(self) -> Path:
        """Where its kernel stands."""
        function = getattr(self.step, "py_func", self.step)
        return Path(function.__code__.co_filename)

    @property
    def gets_numbers(self) -> bool:
        """Whether its inputs are always there: it is tried with no others."""
        return False

    @property
    def outside(self) -> bool:
        """Whether its kernel is none of the gateway's own."""
        module = str(getattr(self.step, "__module__", ""))
        return not (module.partition(".")[0] in OWN_PACKAGES or module.startswith(GENERATED))

    @cached_property
    def entry(self) -> int:
        """Address of the compiled kernel; compiles it, or loads it from the cache.

        Raises:
            InputError: it cannot be compiled.
        """
        return self._entry(checked=False)

    @cached_property
    def checked_entry(self) -> int:
        """Address of the kernel as it is compiled with every index checked.

        Raises:
            InputError: it cannot be compiled.
        """
        return self._entry(checked=True)

    @property
    def records(self) -> tuple[np.dtype[np.void], ...]:
        """Arguments of its kernel: state, constants, inputs, results."""
        return self.state.dtype, self.const.dtype, self.inputs.dtype, self.results

    @property
    def digest(self) -> str:
        """Digest of its kernel, with all that it calls."""
        return Closure(cast(Any, getattr(self.step, "py_func", self.step))).digest

    def _entry(self, *, checked: bool) -> int:
        try:
            return entry_point(self.step, self.records, checked=checked)
        except GatewayError as error:
            text = " ".join(str(error).split())
            own = self.file.resolve()
            lines = [int(line) for file, line in _PLACES.findall(text) if Path(file).resolve() == own]
            raise InputError(
                f"its kernel cannot be compiled: {text}",
                file=self.file,
                line=lines[0] if lines else None,
                key=f'monitor type "{self.type}"',
            ) from error


@dataclass(frozen=True, kw_only=True)
class Family(Generic[P]):
    """A type of monitor whose kernel, records and faults depend on its parameters.

    Attributes:
        type: its name in the configuration.
        api: version of the contract that it was written for.
        params: pydantic model of its parameters.
        made: parameters, folder of the configuration -> the monitor, which has these parameters; equal ones give the
            same object, so that it goes on over a reload. It raises InputError or InputErrors for parameters of which
            no monitor can be made, with keys from the monitor's table on.
    """

    type: str
    api: int
    params: Class[P]
    made: Callable[[P, Path], Monitor[P]]

    @property
    def file(self) -> Path:
        """Where it is made."""
        return Path(self.made.__code__.co_filename)
