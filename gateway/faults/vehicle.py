"""DTCs of other ECUs, as their answers tell them: when each came and went, its status, its snapshots.

Nothing is concluded that an answer does not tell: a DTC has gone when an answer that would have it has it no more.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple

#: Bits of a status that make a DTC worth telling: failed, failed in this cycle, pending, confirmed, failed since the
#: clear, lamp; and, beside the byte of ISO 14229-1, permanent (OBD mode 0A).
TOLD, PERMANENT = 0x1AF, 0x100
#: Kind of data that is a DTC's byte of severity and class: by the report that tells it, 0x19 42.
SEVERITY = "1942"
#: DTCs that are kept at most, of all ECUs. One that has gone gives way, the one that went first.
MOST = 2000


class DtcAnswer(NamedTuple):
    """Contents of an answer: an ECU's DTCs.

    Attributes:
        ecu: its name.
        found: status by DTC.
        covers: bits of which the answer names every DTC that has one; 0: it may have left some out.
        whole: whether each status is the whole byte.
        kind, data: data that belong to the DTCs that are found, in hexadecimal digits; "": none.
        severity: the answer names those only whose SEVERITY has a bit of it; 0: all.
    """

    ecu: str
    found: Mapping[str, int]
    covers: int
    whole: bool = True
    kind: str = ""
    data: Mapping[str, str] = {}
    severity: int = 0

    @property
    def typed(self) -> bool:
        """Whether its DTCs have a failure type; those of the modes of OBD have none."""
        return self.whole or bool(self.kind)

    def may_name(self, dtc: EcuDtc) -> bool:
        """Return whether the answer would name a DTC that has a status for it: it is of its group and severity."""
        return not self.severity or bool(int(dtc.snapshots.get(SEVERITY, "0"), 16) & self.severity)


@dataclass(frozen=True)
class EcuDtc:
    """A DTC of another ECU. Times are of the wall clock.

    Attributes:
        ecu: its name.
        dtc: "P0336-39", or of OBD "P0336".
        status: status byte, and PERMANENT.
        there: whether a bit of TOLD was set when it was told last.
        came: how often it came.
        first_ns, last_ns: when it was told first and last.
        went_ns: when it was told last that it is not there; None: it never went.
        snapshots: its data by the request that reads them (1904, 1906, 1942), in hexadecimal digits.
    """

    ecu: str
    dtc: str
    status: int
    there: bool
    came: int
    first_ns: int
    last_ns: int
    went_ns: int | None = None
    snapshots: Mapping[str, str] = field(default_factory=dict)

    @property
    def key(self) -> tuple[str, str]:
        """ECU and DTC."""
        return self.ecu, self.dtc


class VehicleMemory:
    """The DTCs of all ECUs.

    Attributes:
        dropped: DTCs for which there was no room.
    """

    def __init__(self, known: Iterable[EcuDtc] = ()) -> None:
        self._known = {each.key: each for each in known}
        self.dropped = 0

    def all(self) -> list[EcuDtc]:
        """Return them by ECU and DTC."""
        return [self._known[key] for key in sorted(self._known)]

    def take(self, told: DtcAnswer, t_ns: int) -> tuple[dict[tuple[str, str], EcuDtc | None], list[tuple[EcuDtc, str]]]:
        """Take what an answer says.

        Args:
            told: it.
            t_ns: when it came, of the wall clock.

        Returns:
            what has changed, by ECU and DTC, None: it gave way; what to tell: a DTC that came, changed or went.
        """
        changed: dict[tuple[str, str], EcuDtc | None] = {}
        events = []
        # An answer of UDS says nothing of codes of OBD, nor the other way round.
        known = {dtc for ecu, dtc in self._known if ecu == told.ecu and ("-" in dtc) == told.typed}
        names = known | told.found.keys()
        for dtc in sorted(names):
            old = self._known.get((told.ecu, dtc))
            new = self._next(told, dtc, old, t_ns)
            if new is None or new == old:
                continue
            if old is None:
                changed |= dict.fromkeys(self._make_room())
                if len(self._known) >= MOST:
                    self.dropped += 1
                    continue
            changed[new.key] = self._known[new.key] = new
            before, after = old is not None and old.there, new.there
            if before != after:
                events.append((new, "came" if after else "went"))
            elif after and old is not None and (old.status ^ new.status) & TOLD:
                events.append((new, "changed"))
        return changed, events

    def _next(self, told: DtcAnswer, dtc: str, old: EcuDtc | None, t_ns: int) -> EcuDtc | None:
        """Return a DTC as it is after an answer; None: it is not worth an entry."""
        status = 0 if old is None else old.status
        if old is not None and dtc not in told.found and not told.may_name(old):
            return old
        if dtc in told.found:
            status = told.found[dtc] | (status & PERMANENT if told.whole else status & ~told.covers)
        else:
            status &= ~told.covers
        there = bool(status & TOLD)
        if old is None:
            if not there:
                return None
            old = EcuDtc(told.ecu, dtc, status, False, 0, t_ns, t_ns)
        elif dtc not in told.found and status == old.status:
            return old
        snapshots = old.snapshots
        if dtc in told.data:
            snapshots = {**snapshots, told.kind: told.data[dtc]}
        came = old.came + (there and not old.there)
        went_ns = t_ns if old.there and not there else old.went_ns
        last_ns = t_ns if (status, snapshots, there) != (old.status, old.snapshots, old.there) else old.last_ns
        return replace(
            old, status=status, there=there, came=came, last_ns=last_ns, went_ns=went_ns, snapshots=snapshots
        )

    def _make_room(self) -> list[tuple[str, str]]:
        """Give up the DTC that went first, if there is no room; returns its key."""
        if len(self._known) < MOST:
            return []
        gone = min((each for each in self._known.values() if not each.there), key=lambda e: e.last_ns, default=None)
        if gone is None:
            return []
        del self._known[gone.key]
        return [gone.key]
