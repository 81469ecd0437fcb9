"""Capabilities of a monitor: what it can do beside monitoring, at most one of each class.

Authors import them from :mod:`gateway.monitors.contract`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple, TypeVar

import numpy as np

from gateway.monitors.sampling import Sampling


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
        digests: parameters -> digest of each quantity, kept in a table ``digests`` beside its values; None:
            its quantities never change.
    """

    quantities: tuple[tuple[str, str], ...]
    floors: Mapping[str, float]
    sums: Callable[[np.void], Any]
    peaks: Callable[[np.void], Any]
    digests: Callable[[Any], Mapping[str, str]] | None = None


@dataclass(frozen=True)
class Refined:
    """Findings of healthy logs for a plant's model.

    Attributes:
        keys: of the monitor's table in the configuration, with their new values.
        rows: for people: name, configured value, value found, how sure.
        fit: mean normalised innovation squared over the number of sensors; 1: the model explains all that came.
    """

    keys: Mapping[str, Any]
    rows: tuple[tuple[str, float, float, float], ...]
    fit: float


@dataclass(frozen=True)
class Refinement:
    """A monitor of a plant whose model healthy logs can refine.

    Attributes:
        wanted: parameters -> those with which the logs are replayed, by keys of its table.
        found: parameters, state record at the end of a log -> what it says; the next log is replayed with its keys.
    """

    wanted: Callable[[Any], Mapping[str, Any]]
    found: Callable[[Any, Any], Refined]


@dataclass(frozen=True)
class Measured:
    """Findings of healthy logs for sensors.

    Attributes:
        keys: of the monitor's table in the configuration, with their new values.
        rows: for people: name, configured value, value found, standard deviation; NaN: none.
    """

    keys: Mapping[str, Any]
    rows: tuple[tuple[str, float, float, float], ...]


@dataclass(frozen=True)
class SensorCalibration:
    """Redundant sensors of a monitor (:class:`Sampled`) that healthy logs can measure.

    Attributes:
        sensors: parameters -> how many of its inputs they are, the first ones.
        found: parameters, readings in a row of shape (samples, sensors), NaN where a sample was lost -> what they say;
            an :class:`~gateway_fdi.errors.InputError` with the key of its table where they do not tell.
    """

    sensors: Callable[[Any], int]
    found: Callable[[Any, Sequence[Any]], Measured]


@dataclass(frozen=True)
class Readout:
    """Numbers of the state that people are shown (summary, live values, plots).

    Attributes:
        names: fields of the state.
    """

    names: tuple[str, ...]


class Quantity(NamedTuple):
    """A number that a monitor computes on the way to its results.

    Attributes:
        name: for people.
        unit: of its values.
        limit: compared with it, NaN: none.
    """

    name: str
    unit: str = ""
    limit: float = math.nan


@dataclass(frozen=True)
class Quantities:
    """Values that a monitor computes on the way to its results: residuals, statistics (``gateway replay --signals``).

    Attributes:
        of: parameters -> names, units and limits.
        values: state record -> a number for each of them, in this order.
    """

    of: Callable[[Any], Sequence[Quantity]]
    values: Callable[[np.void], Iterable[float]]


@dataclass(frozen=True)
class Warnings:
    """Remarks of ``gateway check`` on parameters that are not wrong.

    Attributes:
        of: parameters -> lines.
    """

    of: Callable[[Any], tuple[str, ...]]


@dataclass(frozen=True)
class Parts:
    """One configured monitor that steps in several parts: each has its own inputs, and steps when they come.

    Attributes:
        of: parameters, ``"Message.Signal"`` -> the signal in the database, names -> a network code given out for each
            -> parameters of each part by its name. By that a part keeps its state over a reload. The parts' faults are
            ``<monitor>.<fault>``, too.
    """

    of: Callable[[Any, Callable[[str], Any], Callable[[Iterable[str]], Mapping[str, str]]], Mapping[str, Any]]


@dataclass(frozen=True)
class Numbered:
    """A monitor that has to know which of its messages a step is for.

    Attributes:
        field: of its constants: the engine writes there, in the order of ``triggers``, what ``u.trigger`` is for each.
    """

    field: str


@dataclass(frozen=True)
class Notes:
    """Description of a monitor for ``gateway check``.

    Attributes:
        of: parameters -> lines.
    """

    of: Callable[[Any], tuple[str, ...]]


@dataclass(frozen=True)
class Sampled:
    """A monitor that steps once a sample, however late, overtaken or lost its frames are.

    Its inputs derive from :class:`SampledInputs`. Those whose signals do not trigger have their newest value. Time is
    that of the sample. Where samples are at the ticks of a clock (``between="held"``) these alone wake the monitor.

    Attributes:
        of: parameters -> how frames become samples, or several ways, each for other inputs; its counters are named as
            signals are.
    """

    of: Callable[[Any], Sampling | Sequence[Sampling]]


@dataclass(frozen=True)
class Suspects:
    """A monitor that suspects, which is no fault: its suspicions are told, and that is all.

    Attributes:
        count: field of the state: how many there were.
        which: field: what the last one is of, from 1.
        when_ns: field: when that was [ns].
        names: parameters -> names of what ``which`` counts.
    """

    count: str
    which: str
    when_ns: str
    names: Callable[[Any], Sequence[str]]


@dataclass(frozen=True)
class Failure:
    """A monitor whose kernel calls Python: how that failed.

    Attributes:
        of: state -> why its last step failed, with file and line; "": it did not.
        late: state -> whether it took too long.
    """

    of: Callable[[Any], str]
    late: Callable[[Any], bool]


#: Share of a part in a fault that says no more than that one of several parts is wrong: others mostly say which.
VAGUE = 0.1
#: Share of each other part in a fault that is told by tests behind it: several parts together may look like it.
TOGETHER = 0.5


class Blame(NamedTuple):
    """A part that may be at fault when a test fails.

    Attributes:
        part: the name of a connected signal, as ``connect`` has it; or with a kind a name of the monitor's own.
        kind: of a part that is no signal: "actuator", "plant", "supply", "model", ...; "": it is a signal. With the
            name of a signal it is what that signal commands or measures, the same for all monitors; "message": what
            carries it; "frozen": that, repeating one payload.
        share: how likely the test fails if this part alone is at fault, against a part that it is there for (0.9),
            0 to 1.1.
    """

    part: str
    kind: str = ""
    share: float = 1.0


@dataclass(frozen=True)
class Blames:
    """Parts that each fault of a monitor blames (``gateway check --why``).

    Attributes:
        of: parameters -> name of a fault -> the parts that its failure blames. A fault that is not named blames all
            that is connected, as those of a monitor that says nothing do.
    """

    of: Callable[[Any], Mapping[str, Sequence[Blame]]]


@dataclass(frozen=True)
class Behind:
    """Tests that a monitor's faults are made of: where no part explains what they say, several together may.

    Attributes:
        of: parameters -> name of each test -> the parts that its failure blames, as :class:`Blame` has them.
        levels: parameters, state record -> of each test, in this order: 1 and above: it has failed, and how far its
            residual is beyond its limit; below 1: it has passed; NaN: not tested; minus infinity: nor does its failure
            count that came before.
        false_alarms: name of a test -> probability that it fails though all parts are well; of one that is not named
            it is that of any fault.
    """

    of: Callable[[Any], Mapping[str, Sequence[Blame]]]
    levels: Callable[[Any, np.void], Iterable[float]]
    false_alarms: Mapping[str, float] = field(default_factory=dict)


class Gain(NamedTuple):
    """How a residual depends on a part.

    Attributes:
        part: as :class:`Blame` has it.
        gain: residual for an error of the part of size 1, each in its unit; not 0.
        kind: as :class:`Blame` has it.
    """

    part: str
    gain: float
    kind: str = ""


class Reading(NamedTuple):
    """Sizes of errors by one test result.

    Attributes:
        residual: signed, 0 but for noise while nothing is wrong.
        noise: its standard deviation then, above 0.
        gains: at this operating point; of a part that is not named nothing is known.
        gain_error: by what share they are wrong, 0 to 1.
        beyond: how far the residual is beyond what the test allows, as a factor; NaN: not known. The further, the less
            probable is an error of the test's model.
    """

    residual: float
    noise: float
    gains: tuple[Gain, ...]
    gain_error: float = 0.05
    beyond: float = math.nan


class LastResult(NamedTuple):
    """The last result of a test: its evidence, value and limit, and the monitor's state record."""

    evidence: Sequence[float]
    value: float
    limit: float
    state: Any


@dataclass(frozen=True)
class Residuals:
    """Signed residuals of a monitor's faults: one size of a part's error has to explain all that fail.

    Attributes:
        of: parameters -> name of a fault -> a result -> what it says of sizes; None: nothing.
    """

    of: Callable[[Any], Mapping[str, Callable[[LastResult], Reading | None]]]


#: Something that a monitor can do beside monitoring; at most one of each class.
Capability = (
    Behind
    | Blames
    | Calibration
    | CusumCalibration
    | Failure
    | Notes
    | Numbered
    | Parts
    | Quantities
    | Readout
    | Refinement
    | Residuals
    | Sampled
    | SensorCalibration
    | Suspects
    | Warnings
)
C = TypeVar(
    "C",
    Behind,
    Blames,
    Calibration,
    CusumCalibration,
    Failure,
    Notes,
    Numbered,
    Parts,
    Quantities,
    Readout,
    Refinement,
    Residuals,
    Sampled,
    SensorCalibration,
    Suspects,
    Warnings,
)
