"""Contents of the fault memory, as its store writes them."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, fields
from operator import attrgetter
from typing import Any, NamedTuple

from gateway.faults.explanation import Cause
from gateway.faults.interventions import Intervention
from gateway.faults.outgoing import Outgoing, Tally
from gateway.faults.status import Cycles, Status
from gateway.faults.vehicle import EcuDtc


@dataclass
class FreezeFrame:
    """Signals at a failure. Record 1 is of the first failure, the others of the latest ones."""

    number: int
    t_ns: int
    content: dict[str, float | None]


@dataclass(slots=True)
class Record:
    """The memory's record of one fault.

    Attributes:
        id: of the fault.
        dtc: its code.
        status: status byte.
        failed_cycles, passed_cycles, aged_cycles: counters of its status byte.
        occurrence: failures since the entry was made; 0: there is no entry.
        first_ns, last_ns: times of the first and the latest of them.
        evidence: of the latest one: value, threshold, and the values that the monitor names.
        inputs: of the monitor then.
        peak_fdc: greatest fault detection counter since the last clear.
        near_misses: rises of that counter to half the way or more that came to nothing.
        first_failed, last_failed, first_confirmed, last_confirmed: places in the order of all failures
            since the last clear.
        freeze_frames: by record number.
        cause: what explains it, None: not known.
        hold: whether its confirmation waits for that, of :data:`gateway.faults.explanation.HOLDS`.
    """

    id: str
    dtc: int
    status: int
    failed_cycles: int = 0
    occurrence: int = 0
    first_ns: int | None = None
    last_ns: int | None = None
    evidence: dict[str, float | None] = field(default_factory=dict)
    passed_cycles: int = 0
    aged_cycles: int = 0
    inputs: dict[str, float | None] = field(default_factory=dict)
    peak_fdc: int = 0
    near_misses: int = 0
    first_failed: int | None = None
    last_failed: int | None = None
    first_confirmed: int | None = None
    last_confirmed: int | None = None
    freeze_frames: dict[int, FreezeFrame] = field(default_factory=dict)
    cause: Cause | None = None
    hold: str = ""

    @property
    def cycles(self) -> Cycles:
        """Counters of the status byte's transitions."""
        return Cycles(self.failed_cycles, self.passed_cycles, self.aged_cycles)

    def copy(self) -> Record:
        """Return a copy; its contents are replaced later, not changed."""
        made = Record(*_contents(self))  # a tenth of the time that the module copy takes
        made.freeze_frames = dict(self.freeze_frames)
        return made

    def take_over(self, other: Record) -> None:
        """Become what another record is."""
        for name in _NAMES:
            setattr(self, name, getattr(other, name))

    def become(self, status: Status, cycles: Cycles) -> None:
        """Take what a transition of the status byte returned."""
        self.status = int(status)
        self.failed_cycles, self.passed_cycles, self.aged_cycles = cycles.failed, cycles.passed, cycles.aged


_NAMES = tuple(each.name for each in fields(Record))
#: Fields of a record that count, from 0; and its times and places in an order, which may be missing.
COUNTERS = tuple(each.name for each in fields(Record) if each.type == "int" and each.default == 0)
PLACES = tuple(each.name for each in fields(Record) if each.type == "int | None")
#: Fields that readers get as they are, by these names in JSON; those that count are extended data for SOVD.
TOLD = (
    "occurrence", "first_ns", "last_ns", "evidence", "inputs", "failed_cycles", "aged_cycles", "peak_fdc",
    "near_misses", "hold",
)  # fmt: skip
_contents = attrgetter(*_NAMES)


@dataclass
class Cycle:
    """An operation cycle: its number, and whether it was ended."""

    number: int
    open: bool
    t_ns: int


@dataclass(frozen=True)
class Permanent:
    """A permanent DTC."""

    fault: str
    dtc: int
    t_ns: int


@dataclass(frozen=True)
class Recording:
    """Frames around a failure: a candump log, compressed."""

    fault: str
    t_ns: int
    frames: int
    dropped: int
    log: bytes


class Description(NamedTuple):
    """A fault's name, its severity (byte of ISO 14229-1, Annex D.3), and what to do about it."""

    text: str
    severity: int
    remedy: str


#: Nothing went before it was written.
NOTHING_DROPPED = Tally(0, 0, 0, 0)


@dataclass
class Changes:
    """Contents of one commit; everything in it is durable together.

    Attributes:
        records: faults that changed.
        statuses: faults of which only the status byte has changed: their status bytes.
        cycles: operation cycles that changed, by name.
        answered: requests of other processes, with their answers.
        permanent: permanent DTCs, all of them; None: not changed.
        recordings: new ones.
        kept_recordings: how many are kept of each fault.
        identifiers: values that testers wrote; None: there is none.
        facts: numbers by name.
        buses: how the buses do, all of them: name, URI, state, time, and counters; None: not said.
        interventions: new or changed ones, by their numbers.
        kept_interventions: numbers of those that are kept, where others had to go; later ones are not meant.
        described: what faults are called, for readers without the configuration.
        cleared: DTCs or groups that were cleared, in order.
        ecu_dtcs: DTCs of other ECUs that changed, by ECU and DTC; None: one that gave way.
        outgoing: events for the fleet; ``arrived``: numbers of those that have arrived there; ``dropped``: what went
            before it was written; ``outgoing_bytes``: of events that may wait.
    """

    records: Sequence[Record] = ()
    statuses: dict[str, int] = field(default_factory=dict)
    cycles: Mapping[str, Cycle] = field(default_factory=dict)
    answered: Mapping[int, int] = field(default_factory=dict)
    permanent: Sequence[Permanent] | None = None
    recordings: Sequence[Recording] = ()
    kept_recordings: int = 1
    identifiers: Mapping[int, bytes | None] = field(default_factory=dict)
    facts: Mapping[str, int] = field(default_factory=dict)
    buses: Sequence[Mapping[str, Any]] | None = None
    described: Mapping[str, Description] = field(default_factory=dict)
    interventions: Mapping[int, Intervention] = field(default_factory=dict)
    kept_interventions: Sequence[int] = ()
    cleared: Sequence[int] = ()
    ecu_dtcs: Mapping[tuple[str, str], EcuDtc | None] = field(default_factory=dict)
    outgoing: Sequence[Outgoing] = ()
    arrived: Collection[int] = ()
    dropped: Tally = NOTHING_DROPPED
    outgoing_bytes: int = 0

    @property
    def of_verdicts(self) -> bool:
        """Whether there is nothing but faults and numbers."""
        if self.permanent is not None or self.buses is not None:
            return False
        rare = (self.cycles, self.answered, self.recordings, self.identifiers, self.described, self.cleared)
        return not any((*rare, self.interventions, self.kept_interventions, self.ecu_dtcs, self.outgoing, self.arrived))

    @property
    def faults(self) -> int:
        """How many faults have changed."""
        return len(self.records) + len(self.statuses)
