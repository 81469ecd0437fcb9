"""Clearing of DTCs (ISO 14229-1, 0x14), by testers and by other processes; durable, or not done."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass

from gateway.faults.catalogue import Catalogue, FaultDefinition
from gateway.faults.dtc import ALL_DTCS, in_group
from gateway.faults.event_memory import EventMemory
from gateway.faults.ledger import OVERFLOW, Ledger
from gateway.faults.records import Record
from gateway.faults.status import CLEARED
from gateway.faults.store import StoreError
from gateway.faults.usage import Usage
from gateway_fdi.errors import InputError


@dataclass(frozen=True)
class AskedClear:
    """A clear that another process asks for.

    Attributes:
        group: a DTC's 24 bits, or a group.
        by: name of the asker, for people.
        force: whether rules of access are to be overridden.
        why: the reason that he gives.
    """

    group: int
    by: str = ""
    force: bool = False
    why: str = ""

    def __str__(self) -> str:
        return json.dumps(asdict(self))

    @classmethod
    def parse(cls, argument: str) -> AskedClear | None:
        """Read what :meth:`__str__` wrote, or the bare number of earlier versions; None: it is neither."""
        try:
            told = json.loads(argument)
            asked = cls(**told) if isinstance(told, dict) else cls(told)
        except (ValueError, TypeError, RecursionError):
            return None
        fits = [
            type(asked.group) is int and 0 <= asked.group <= ALL_DTCS,
            type(asked.force) is bool,
            *(type(t) is str for t in (asked.by, asked.why)),
        ]
        return asked if all(fits) else None


#: Says why a clear is refused, as a negative response code; 0: it is allowed.
Judge = Callable[[AskedClear], int]


class Clearing:
    """Clears DTCs and groups of them.

    Args:
        held: records of all faults, with the changes to be written.
        definitions: of all of them, by id.
        catalogue: the faults that are monitored.
        entries: of those that have failed.
        before: called before anything is cleared.
        usage: counts since a clear.
    """

    def __init__(
        self,
        held: Ledger,
        definitions: Mapping[str, FaultDefinition],
        catalogue: Catalogue,
        entries: EventMemory,
        before: Callable[[], None],
        usage: Usage,
    ) -> None:
        self._held, self._definitions, self._catalogue, self._entries = held, definitions, catalogue, entries
        self._before, self._usage = before, usage
        self._asked = held.store.watch()

    def clear(self, group: int, t_ns: int) -> list[str]:
        """Clear one DTC, a group, or all; durable on return, or nothing is cleared.

        Permanent DTCs stay until their test has passed; those of faults without a test go.

        Args:
            group: a DTC's 24 bits, or a group (see :func:`gateway.faults.dtc.in_group`).
            t_ns: now, of the engine's clock.

        Returns:
            ids of the faults cleared.

        Raises:
            StoreError: it could not be written; nothing was cleared.
        """
        self._usage.flush()
        with self._held.undoing():
            cleared = self._clear(group)
            self._held.write(t_ns)
        self._entries.forget(cleared)
        return cleared

    def knows(self, group: int) -> bool:
        """Return whether a clear of this DTC or group would mean any fault."""
        return group == ALL_DTCS or any(self._is_in(record, group) for record in self._held.records.values())

    def _is_in(self, record: Record, group: int) -> bool:
        related = self._definitions[record.id].emission_related
        return in_group(record.dtc, group, emission_related=related)

    def _clear(self, group: int) -> list[str]:
        self._before()
        self._held.note_clear(group)
        cleared = []
        for record in list(self._held.records.values()):
            if self._is_in(record, group):
                self._held.records[record.id] = Record(record.id, record.dtc, int(CLEARED))
                self._held.touch(record.id)
                cleared.append(record.id)
                if len(self._catalogue) and self._catalogue.get(record.id) is None:
                    # No test is left that could pass.
                    self._held.note_permanent(self._held.permanent.give_up(record.id))
        self._held.drop_recordings(cleared)
        self._usage.on_clear(group)
        if group == ALL_DTCS and self._held.fact(OVERFLOW):
            self._held.set_fact(OVERFLOW, 0)
        return cleared

    def serve_requests(self, t_ns: int, before: Callable[[], None], judge: Judge) -> list[str]:
        """Do what other processes asked for; returns ids of the faults cleared.

        Args:
            t_ns: now, of the engine's clock.
            before: called first, if there is a request.
            judge: says whether they may; a refused request is answered with the code, negative.
        """
        if self._held.under_way():  # they are served the next time
            return []
        self._held.join()
        if not self._asked():
            return []
        cleared: list[str] = []
        try:
            if not self._held.store.requests():  # something else was written
                return []
            before()
            self._usage.flush()
            with self._held.undoing(), self._held.store.transaction():
                # Within it no request that is being done can be withdrawn.
                for request, kind, argument in self._held.store.requests():
                    asked = AskedClear.parse(argument) if kind == "clear" else None
                    done = 0 if asked is None else -judge(asked)
                    if asked is not None and not done:
                        done = sum(1 for record in self._entries.stored() if self._is_in(record, asked.group))
                        cleared += self._clear(asked.group)
                    self._held.answer(request, done)
                self._held.write(t_ns, alone=False)
        except (StoreError, InputError):  # the askers are told that nothing was done
            return []
        self._held.written()
        self._entries.forget(cleared)
        return cleared
