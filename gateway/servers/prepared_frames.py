"""DTC frames that are told at a verdict, before Python has entered it: what they will be, and which have gone."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from typing import NamedTuple

from cantools.database.can import Message

from gateway.bus.frames import Frames, payload
from gateway.faults.entries import UNKNOWN, DtcChange
from gateway.faults.memory import FaultMemory
from gateway.servers.prepared_frames_kernel import prepared_tables

#: Faults of which it is foreseen in one call what becomes of them: frames wait meanwhile.
AT_ONCE = 100


class _Gone(NamedTuple):
    """A frame that was sent before its change came, or is by the journal: ``number`` there, 0: it has been sent."""

    payload: bytes
    told: tuple[int, int]  # status byte and failures
    number: int


class PreparedFrames:
    """Keeps the tables right of which a pump makes DTC frames, and knows which of these frames have gone.

    Args:
        message: of the DTC frame.
        bus: index of the bus.
        memory: the fault memory.
        status_mask: DTCs with any of these bits are counted in the frame.

    Attributes:
        tables: for the pump.
        withdraw: takes a number in the journal; returns whether its frame has been sent, else it never is.
    """

    def __init__(self, message: Message, bus: int, memory: FaultMemory, status_mask: int) -> None:
        self._memory, self._mask = memory, status_mask
        self._places = {definition.id: k for k, definition in enumerate(memory.catalogue)}
        self.tables = prepared_tables(message, bus, len(self._places))
        self._from_ns = self.tables.following["from_ns"]
        self._stale: set[str] = set()  # it is not foreseen what becomes of these
        self._gone: dict[str, _Gone] = {}
        self.withdraw: Callable[[int], bool] = lambda number: True

    def succeed(self, old: PreparedFrames) -> None:
        """Know which frames have gone by an earlier configuration."""
        self._gone = {name: gone for name, gone in old._gone.items() if self._memory.catalogue.get(name) is not None}

    @property
    def gone(self) -> Collection[str]:
        """Faults whose frames have gone, and whose changes have not come."""
        return self._gone.keys()

    def wait(self, fault: str, from_ns: int) -> None:
        """Have no frame of a fault told before a time [ns]."""
        if fault in self._places:
            self._from_ns[self._places[fault]] = from_ns

    def foresee(self) -> None:
        """Have it foreseen what the next verdicts make of the DTCs; to be called after any change."""
        memory, following = self._memory, self.tables.following
        touched = memory.ledger.take_touched()
        if not (touched or self._stale):
            return
        self._stale |= touched & self._places.keys()
        if len(self._stale) > AT_ONCE:
            later = [self._places[name] for name in self._stale]
            following["failed"][later] = following["passed"][later] = UNKNOWN
        for name in sorted(self._stale)[:AT_ONCE]:
            place, (dtc, status, occurrence) = self._places[name], memory.state(name)
            failed, passed, more = memory.foresee(name)
            now = bool(occurrence and status & self._mask)
            adds = [
                bool(count and after > 0 and after & self._mask) - now
                for after, count in ((failed, more), (passed, occurrence))
            ]
            following[place] = (dtc, failed, passed, more, occurrence, *adds, self._from_ns[place])
            self._stale.discard(name)
        self.tables.head["count"] = memory.count_by_status_mask(self._mask)

    def note(self, frames: Frames) -> None:
        """Note that frames of changes that come next have been sent, or are by the journal."""
        for frame, made in zip(frames, self.tables.made, strict=False):
            name = self._memory.catalogue[int(made["fault"])].id
            self.take(name)
            told = int(made["status"]), int(made["occurrence"])
            self._gone[name] = _Gone(payload(frame), told, int(made["number"]))

    def take(self, fault: str) -> bytes | None:
        """Return the payload of a fault's frame that was sent before, once; one that the journal has still never is."""
        gone = self._gone.pop(fault, None)
        return None if gone is None or (gone.number and not self.withdraw(gone.number)) else gone.payload

    def take_wrong(self, changes: Sequence[DtcChange]) -> list[str]:
        """Return the faults that were told otherwise than they have become, once each.

        Args:
            changes: of the verdicts after :meth:`note`.
        """
        became = {(change.definition.id, int(change.new_status), change.occurrence) for change in changes}
        wrong = [name for name, gone in self._gone.items() if (name, *gone.told) not in became]
        return [name for name in wrong if self.take(name) is not None]
