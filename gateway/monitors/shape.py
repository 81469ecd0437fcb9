"""The shape of a monitor: parameters, state, constants, inputs, kernel, faults.

A monitor steps when its event arrives (a frame that carries its inputs, or a timer it asked for) and
reports **test results**, never DTCs. Debounce and the fault memory decide what becomes of them.

The kernel is ``step(s, c, u, out)`` over four records: state, constants, inputs of this event, and
the :data:`RESULTS` sink. It never reads a clock; ``u.t_ns`` is the event's own time.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from gateway.jit import entry_point, f8, i4, i8, kernel, record
from gateway.tomlfile import StrictModel

#: Values of evidence that one test result can carry.
EVIDENCE = 8
#: Test results that one step can report.
MAX_RESULTS = 128

NOT_TESTED, PASSED, FAILED = 0, 1, 2

#: ``u.trigger`` of a step that a timer caused; otherwise the index of the message that did.
TIMER = -1

RESULT = record(fault=i4, result=i4, value=f8, threshold=f8, evidence=(f8, EVIDENCE))

#: Signals that a monitor's own message can have.
MOST_SIGNALS = 16

#: What a step reports: ``n`` results, the overflow beyond :data:`MAX_RESULTS`, when the monitor wants
#: to be woken if nothing comes in between [ns, 0: never], and, if ``send`` is 1, the values of the
#: signals of its own message.
RESULTS = record(
    n=i8,
    overflow=i8,
    wake_ns=i8,
    send=i8,
    values=(f8, MOST_SIGNALS),
    results=(RESULT, MAX_RESULTS),
)


def inputs(**fields: Any) -> np.dtype[np.void]:
    """Return the dtype of a monitor's inputs: the event's time and cause, then float64 values."""
    return record(t_ns=i8, trigger=i8, **fields)


@kernel
def report(out: Any, fault: int, failed: bool, value: float, threshold: float) -> int:
    """Report a test result; returns its place in ``out.results``, -1 when there is no room.

    Args:
        out: record of :data:`RESULTS`.
        fault: index in the monitor's tuple of faults.
        failed: the verdict.
        value: what was tested (a residual, a distance, a count).
        threshold: what it was tested against, same unit.
    """
    place = out.n
    if place >= MAX_RESULTS:
        out.overflow += 1
        return -1
    result = out.results[place]
    result.fault = fault
    result.result = FAILED if failed else PASSED
    result.value = value
    result.threshold = threshold
    out.n = place + 1
    return int(place)


class MonitorParams(StrictModel):
    """Base of the parameters of a monitor; units stand in the field descriptions."""


ParamsClass = type[MonitorParams]


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


@dataclass(frozen=True)
class Fault:
    """A fault that a monitor can report.

    Attributes:
        name: within the monitor; the fault's id is ``<monitor>.<name>``.
        dtc: default DTC, SAE J2012 base code and failure type byte, e.g. ``"P0336-29"``.
        description: one line for people.
        evidence: names (with units) of the values in ``result.evidence``.
        debounce: default debounce.
        remedy: what to do about it, for people; "": as for any fault of its failure type.
    """

    name: str
    dtc: str
    description: str
    evidence: tuple[str, ...] = ()
    debounce: Debounce = field(default_factory=Debounce)
    remedy: str = ""


@dataclass(frozen=True)
class Wiring:
    """What a monitor wants from the bus.

    Attributes:
        triggers: names of the messages that step it.
        signals: ``"Message.Signal"`` for each float64 of the inputs record, in its order.
        optional: messages that need not come: their signals are NaN until they do, and the monitor steps
            without them.
        units: signal -> unit that the database must give for it; those that are not named may have any.
    """

    triggers: tuple[str, ...]
    signals: tuple[str, ...]
    optional: tuple[str, ...] = ()
    units: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Emission:
    """A message that a monitor sends: ``values[k]`` of its results goes into ``signals[k]``.

    Signals ``FrameCnt`` and ``Crc`` of the message, where it has them, are filled by the engine.
    """

    message: str
    signals: tuple[str, ...]


@dataclass(frozen=True)
class Calibration:
    """Stopping rules of a monitor whose thresholds healthy logs can set.

    Attributes:
        names: keys of the table ``thresholds`` of its parameters.
        rules: state record -> states of these rules, in their order: records with a field ``peak``.
        levels: parameters -> their thresholds now, in that order.
    """

    names: tuple[str, ...]
    rules: Callable[[np.void], Any]
    levels: Callable[[Any], tuple[float, ...]]


@dataclass(frozen=True)
class CusumCalibration:
    """CUSUM tests of a monitor whose nu and thresholds healthy logs can set.

    Its parameters have tables ``nu``, by residual, and ``thresholds``, by quantity in units of its nu.

    Attributes:
        quantities: name, and residual; a quantity without a residual has a unit of its own.
        floors: of these, the largest T that a healthy drive is thought to reach at least.
        sums: state record -> ``samples``, ``total`` and ``squares`` of the moduli that updated each quantity.
        peaks: state record -> largest T of each quantity over its threshold.
    """

    quantities: tuple[tuple[str, str], ...]
    floors: Mapping[str, float]
    sums: Callable[[np.void], Any]
    peaks: Callable[[np.void], Any]


@dataclass(frozen=True)
class Monitor:
    """A type of monitor; configured instances of it share the kernel.

    Attributes:
        type: its name in the configuration.
        params: pydantic model of its parameters.
        state: dtype of its state.
        const: dtype of its constants.
        inputs: dtype of its inputs (see :func:`inputs`).
        step: its kernel.
        faults: what it can report; none where ``named`` tells.
        wire: parameters -> :class:`Wiring`.
        prepare: parameters, state record, constants record: fills both before the first step.
        readout: fields of the state shown to people (summary, live values).
        emission: the message it sends, if any.
        dtcs: parameters -> DTCs by name of the fault, where they are not those of ``faults``.
        message: parameters -> name of the message it sends, where it is not that of ``emission``.
        calibration: what ``gateway calibrate`` sets.
        warnings: parameters -> what ``gateway check`` says of them, though they are not wrong.
        named: parameters -> what it can report, where names and number depend on them.
    """

    type: str
    params: ParamsClass
    state: np.dtype[np.void]
    const: np.dtype[np.void]
    inputs: np.dtype[np.void]
    step: Callable[..., None]
    faults: tuple[Fault, ...]
    wire: Callable[[Any], Wiring]
    prepare: Callable[[Any, np.void, np.void], None]
    readout: tuple[str, ...] = ()
    emission: Emission | None = None
    dtcs: Callable[[Any], Mapping[str, str]] | None = None
    message: Callable[[Any], str] | None = None
    calibration: Calibration | CusumCalibration | None = None
    warnings: Callable[[Any], tuple[str, ...]] | None = None
    named: Callable[[Any], tuple[Fault, ...]] | None = None

    def faults_of(self, params: MonitorParams) -> tuple[Fault, ...]:
        """Return what an instance with these parameters can report."""
        if self.named is not None:
            return self.named(params)
        codes = {} if self.dtcs is None else self.dtcs(params)
        return tuple(replace(fault, dtc=codes.get(fault.name, fault.dtc)) for fault in self.faults)

    def emission_of(self, params: MonitorParams) -> Emission | None:
        """Return what an instance with these parameters sends."""
        if self.emission is None or self.message is None:
            return self.emission
        return replace(self.emission, message=self.message(params))

    @cached_property
    def entry(self) -> int:
        """Address of the compiled kernel; compiles it, or loads it from the cache."""
        return entry_point(self.step, (self.state, self.const, self.inputs, RESULTS))
