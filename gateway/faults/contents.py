"""Contents of a fault memory's file, table by table, each as of one commit of its writer."""

from __future__ import annotations

import json
import sqlite3
from abc import ABC, abstractmethod
from collections.abc import Iterable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

from gateway.faults import chain, journal_file, rollback, rows
from gateway.faults import outgoing as queue
from gateway.faults.interventions import Intervention
from gateway.faults.journal_file import LastVerdict
from gateway.faults.lock import is_kept
from gateway.faults.records import Cycle, Description, Permanent, Record, Recording
from gateway.faults.vehicle import EcuDtc


class Contents(ABC):
    """The reading side of a :class:`gateway.faults.store.Store`."""

    path: Path | None
    _write: bool

    @abstractmethod
    def _reading(self) -> AbstractContextManager[sqlite3.Connection]:
        """Return a connection whose reads are of one commit."""

    def load(self) -> list[Record]:
        """Return all records, in order of their DTCs, as of one commit of the writer.

        A reader gets them with the verdicts that wait for the next writer, if there is none now.

        Raises:
            DamagedError: the file is damaged.
        """
        with self._reading() as db:  # else a commit could fall between records and freeze frames
            records = rows.read_records(db)
            if self.path is not None and not self._write and not is_kept(self.path):
                journal_file.show(self.waiting(), records)
        return records

    def cycles(self) -> dict[str, Cycle]:
        """Return the last operation cycle of each name."""
        with self._reading() as db:
            found = list(db.execute("SELECT name, number, open, t_ns FROM operation_cycle"))
        return {name: Cycle(number, bool(opened), t_ns) for name, number, opened, t_ns in found}

    def permanent(self) -> list[Permanent]:
        """Return the permanent DTCs, the oldest first."""
        with self._reading() as db:
            found = list(db.execute("SELECT fault, dtc, t_ns FROM permanent ORDER BY rowid"))
        return [Permanent(*row) for row in found]

    def recordings(self, fault: str | None = None) -> list[Recording]:
        """Return the recordings of a fault, or of all, the oldest first."""
        with self._reading() as db:
            found = list(
                db.execute(
                    f"{rows.SELECT_RECORDINGS} WHERE ?1 IS NULL OR fault = ?1 ORDER BY id",
                    (fault,),
                )
            )
        return [Recording(*row) for row in found]

    def recorded(self) -> dict[str, int]:
        """Return how many recordings there are of each fault that has some; their logs are not read."""
        with self._reading() as db:
            return dict(db.execute("SELECT fault, count(*) FROM recording GROUP BY fault"))

    def identifiers(self) -> dict[int, bytes]:
        """Return the values that testers wrote, by data identifier."""
        with self._reading() as db:
            return dict(db.execute("SELECT did, data FROM identifier"))

    def interventions(self) -> list[Intervention]:
        """Return what testers did, the oldest first."""
        with self._reading() as db:
            return [Intervention(*row) for row in db.execute(f"{rows.SELECT_INTERVENTIONS} ORDER BY number")]

    def ecu_dtcs(self) -> list[EcuDtc]:
        """Return the DTCs of other ECUs."""
        with self._reading() as db:
            return rows.read_ecu_dtcs(db)

    def outgoing(self, after: int = 0, most: int = -1) -> list[queue.Outgoing]:
        """Return events for the fleet that wait, in order.

        Args:
            after: number of a row; only later ones.
            most: how many; -1: all.
        """
        with self._reading() as db:
            found = db.execute(f"{queue.SELECT} WHERE number > ? ORDER BY number LIMIT ?", (after, most))
            return [queue.read(*row) for row in found]

    def tally(self) -> queue.Tally:
        """Return how many events for the fleet there were, wait and were given up."""
        with self._reading() as db:
            return queue.tally(db)

    def facts(self) -> dict[str, int]:
        """Return numbers by name."""
        with self._reading() as db:
            return dict(db.execute("SELECT name, value FROM fact"))

    def verify(self, known: Iterable[rollback.LastLink] = ()) -> chain.Verdict:
        """Return what of the file is as its chain says, as of one commit of the writer.

        Args:
            known: last links that it must have, if it did not go back (:func:`last_links`).

        Raises:
            DamagedError: it cannot be read.
        """
        with self._reading() as db:
            verdict = chain.verify(db)
            if missing := rollback.what_is_missing(db, known):
                verdict.broken.append(chain.Broken("file", "", 0, missing))
            return verdict

    def waiting(self) -> list[LastVerdict]:
        """Return the verdicts that were told and that the file does not have, in order (see :mod:`.journal_file`)."""
        if self.path is None:
            return []
        with self._reading() as db:
            return journal_file.waiting(self.path, chain.head(db).digest, rollback.generation_of(db))

    def buses(self) -> list[dict[str, Any]]:
        """Return what the daemon said last of its buses."""
        with self._reading() as db:
            found = list(db.execute("SELECT name, uri, state, t_ns, counters FROM bus"))
        return [
            {"bus": name, "uri": uri, "state": state, "t_ns": t_ns, **json.loads(counters)}
            for name, uri, state, t_ns, counters in found
        ]

    def descriptions(self) -> dict[str, Description]:
        """Return what faults are called, by their id."""
        with self._reading() as db:
            found = db.execute("SELECT fault, description, severity, remedy FROM catalogue")
            return {fault: Description(*description) for fault, *description in found}

    def requests(self) -> list[tuple[int, str, str]]:
        """Return the requests of other processes not answered yet: (id, kind, argument)."""
        with self._reading() as db:
            return list(db.execute("SELECT id, kind, argument FROM request WHERE done IS NULL ORDER BY id"))
