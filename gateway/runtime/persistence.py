"""Care of the fault memory's file: it is written in time, and failures to write are told.

Everything that changes is written before it is told. Three things can happen on the way:

- **A storm of changes**: they are written in groups (:class:`WriteThrottle`), and told when they are written. In a live
  gateway a thread writes (:meth:`Persistence.write_beside`): the disk may take its time, testers do not wait for it.
- **The file cannot be written**: changes are told all the same, as not stored; the fault ``gateway.memory_not_written``
  is there until a later attempt has written everything.
- **The file was damaged, deleted, replaced or overwritten**: a new one is begun; ``gateway.memory_damaged`` is there
  until the next operation cycle.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from gateway.engine.checks.own_health import DAMAGED, NOT_WRITTEN, OWNER
from gateway.engine.core import Engine, Sink
from gateway.faults.memory import FaultMemory
from gateway.faults.resilient_store import ResilientStore
from gateway.faults.store_incidents import Incident
from gateway.faults.write_throttle import WriteThrottle
from gateway.faults.writer_thread import Writer, WriterThread
from gateway.monitors.contract import Fault
from gateway_fdi.common.log import get_logger

log = get_logger(__name__)


@dataclass(slots=True)  # frozen ones take three times as long to make
class Noted:
    """How many changes, and how many events, have been noted to be told."""

    changes: int
    events: int

    def __add__(self, more: Noted) -> Noted:
        return Noted(self.changes + more.changes, self.events + more.events)

    def __sub__(self, told: Noted) -> Noted:
        return Noted(max(self.changes - told.changes, 0), max(self.events - told.events, 0))


NOTHING = Noted(0, 0)
#: How long a single change is waited for where a thread writes it [s].
PATIENCE_S = 0.003


def begin_writer() -> Writer:
    """Begin the thread that writes the fault memory."""
    return WriterThread("fault-memory")


class Persistence:
    """Writes a fault memory and watches its file.

    Args:
        memory: the fault memory.
        store: its file.
        engine: debounces the gateway's own faults.
        report: takes events of the JSON contract.

    Attributes:
        not_stored: changes of DTCs that were told while they were not stored.
    """

    def __init__(
        self,
        memory: FaultMemory,
        store: ResilientStore,
        engine: Engine,
        report: Callable[[dict[str, Any]], None],
    ) -> None:
        self._memory, self._store, self._engine, self._report_event = memory, store, engine, report
        places = {slot.id: k for k, slot in enumerate(engine.faults)}
        self._places = {f: places.get(f"{OWNER}.{f.name}") for f in (NOT_WRITTEN, DAMAGED)}
        self._pace = WriteThrottle()
        self._tested = store.path is None  # whether its faults have had their first result
        self._writer: Writer | None = None
        self._patience_s = 0.0
        self._under_way = NOTHING  # events noted when the write under way began
        self._down = False
        self._paused = False
        self.not_stored = 0
        memory.outage.awaited = True

    def succeed(self, old: Persistence) -> None:
        """Go on where that of an earlier configuration stops."""
        self._pace, self.not_stored = old._pace, old.not_stored
        self._down = old._down
        watched, before = self._places.values(), old._places.values()
        same = [place is None for place in watched] == [place is None for place in before]
        self._tested = old._tested and same
        self._writer, self._patience_s = old._writer, old._patience_s
        old._writer = None

    @property
    def beside(self) -> bool:
        """Whether a thread writes."""
        return self._writer is not None

    def pause(self) -> None:
        """Begin no further write in the thread: the next gateway reads the file."""
        self._paused = True

    def resume(self) -> None:
        """Go on with writing."""
        self._paused = False

    @property
    def stored(self) -> bool:
        """Whether all that is told is stored: in its file, or in this process if there is none."""
        return not self._memory.outage.reason

    @property
    def idle(self) -> bool:
        """Whether nothing waits to be written, and nothing has happened to the file."""
        return self._memory.clean and self._tested and not (self._down or self._store.happened)

    @property
    def in_process(self) -> bool:
        """Whether changes are kept in this process only: there is no file, nor a thread that writes."""
        return self._writer is None and self._store.path is None

    @property
    def failures(self) -> int:
        """Attempts to write that failed."""
        return self._memory.outage.failures

    def write_beside(self, writer: Writer | None = None, patience_s: float = PATIENCE_S) -> None:
        """Have a thread write from now on, for a gateway whose frames do not wait; not where there is no file.

        Args:
            writer: it is shut down with this; None: a new one.
            patience_s: how long a single change is waited for, before other things are done [s].
        """
        if self._store.path is None and writer is None:
            return
        self._writer, self._patience_s = writer or begin_writer(), patience_s

    def close(self) -> None:
        """End the thread; its write is finished first."""
        self._memory.join()
        if self._writer is not None:
            self._writer.shutdown()
            self._writer = None

    def settle(self, t_ns: int, noted: Noted, sink: Sink, *, asked: bool = False, final: bool = False) -> Noted:
        """Write what waits, if it is time; returns how much of what was noted may be told.

        Args:
            t_ns: now, of the engine's clock.
            noted: events to be told.
            sink: takes the events of the gateway's own faults.
            asked: whether a tester asks for the present state; he does not wait for a thread that writes.
            final: write in any case.
        """
        memory = self._memory
        if self.idle:
            self._under_way = NOTHING  # its write has ended, and was joined elsewhere: it counts for no others
            return noted
        if self._writer is not None and not final:
            return self._settle_beside(t_ns, noted, sink, self._writer)
        if memory.unsaved:
            urgent = final or asked or memory.outage.reason
            if not (urgent or self._pace.allows(t_ns, memory.unsaved)):
                return NOTHING
            memory.commit(t_ns, final=final)
        if self._judge(t_ns, sink):
            memory.commit(t_ns, final=final)
            self._judge(t_ns, sink)
        self._under_way = NOTHING
        return noted

    def _settle_beside(self, t_ns: int, noted: Noted, sink: Sink, writer: Writer) -> Noted:
        """Have the thread write, if it is time; returns what may be told: written events, in an outage all."""
        memory = self._memory
        down = bool(memory.outage.reason)
        patience_s = self._patience_s if self._pace.calm and not down else 0.0
        if memory.ledger.under_way(patience_s):
            return noted if down else NOTHING
        done = self._written(t_ns, sink)
        if memory.unsaved and not self._paused and self._is_time(t_ns):
            down = bool(memory.outage.reason)
            memory.begin(t_ns, writer, anew=not self._store.look() or self._store.doubtful)
            self._under_way = NOTHING if down else noted - done  # in an outage it is told at once
            if not down and not memory.ledger.under_way(patience_s):
                done += self._written(t_ns, sink)
        return noted if memory.outage.reason else done

    def _is_time(self, t_ns: int) -> bool:
        if self._memory.outage.reason:
            return self._memory.outage.is_due(t_ns)
        return self._pace.allows(t_ns, self._memory.unsaved)

    def _written(self, t_ns: int, sink: Sink) -> Noted:
        """End a write of the thread; returns the noted events that are stored now."""
        memory = self._memory
        joined = memory.join()
        done, self._under_way = self._under_way, NOTHING
        if joined and not memory.outage.reason and not self._store.look():
            memory.ledger.rewrite()  # written, but into a file that no reader will find
            done = NOTHING
        self._judge(t_ns, sink)
        return done

    def look(self, t_ns: int) -> None:
        """Look whether the file is still there; if not, all is written again."""
        self._store.look_at_journal()
        if self._memory.ledger.under_way():
            return
        self._memory.join()
        if not self.beside:
            self._store.examine()
        if not self._store.look() and not self._memory.outage.reason:
            self._memory.ledger.rewrite()
            if not self.beside:
                self._memory.commit(t_ns)

    def tend(self) -> None:
        """Have the thread look after the file's log, if nothing waits to be written."""
        if self._writer is not None and not self._paused and self._memory.clean and self._store.log_is_due:
            self._memory.ledger.tend(self._writer, self._store.tend_log)

    def _judge(self, t_ns: int, sink: Sink) -> bool:
        """Report what became of the file, where that is news; returns whether there was any."""
        news = False
        incidents = self._store.incidents()
        for incident in incidents:
            self._report_incident(incident, t_ns)
        if not self._tested:
            self._report_recovered(t_ns)
        if incidents or not self._tested:
            recovered, lost = sum(m.recovered for m in incidents), sum(m.lost for m in incidents)
            self._report(DAMAGED, bool(incidents), lost, (recovered, lost), sink)
            news = True
        down = bool(self._memory.outage.reason) or bool(self._store.detached)
        if down != self._down or not self._tested:
            self._report_outage(t_ns, down=down, news=down != self._down)
            self._down = down
            waiting = self._memory.unsaved
            self._report(NOT_WRITTEN, down, float(down), (waiting,), sink)
            news = True
        self._tested = True
        self._memory.outage.told = down
        self._store.note_unsaved(down)
        return news

    def _report(self, fault: Fault, failed: bool, value: float, evidence: Sequence[float], sink: Sink) -> None:
        place = self._places[fault]
        if place is not None:
            self._engine.report(place, failed, value, 0.0, evidence, sink)

    def _report_incident(self, incident: Incident, t_ns: int) -> None:
        aside = "" if incident.aside is None else str(incident.aside)
        log.error(
            "new fault memory begun",
            file=str(self._store.path),
            reason=incident.reason,
            put_aside=aside,
            rows_recovered=incident.recovered,
            rows_lost=incident.lost,
        )
        self._event(
            t_ns, incident.kind, incident.reason,
            aside=aside, recovered=incident.recovered, lost=incident.lost,
        )  # fmt: skip

    def _report_recovered(self, t_ns: int) -> None:
        """Tell which verdicts an earlier process told, and did not come to write."""
        faults, lost = self._memory.recovered
        if faults or lost:
            reason = "told right before the last end"
            self._event(t_ns, "recovered", reason, recovered=len(faults), lost=lost, faults=list(faults))

    def _report_outage(self, t_ns: int, *, down: bool, news: bool) -> None:
        if not news:
            return
        outage = self._memory.outage
        reason = outage.reason or self._store.detached
        if down:
            log.error(
                "fault memory cannot be written; monitoring goes on, and writing is tried again",
                file=str(self._store.path),
                reason=reason,
            )
            self._event(t_ns, "not written", reason)
        else:
            since_ns = outage.since_ns or t_ns  # 0: before the first frame
            seconds = max(t_ns - since_ns, 0) / 1e9
            log.warning("fault memory written again", file=str(self._store.path), after_s=round(seconds, 3))
            self._event(t_ns, "written", "")

    def _event(self, t_ns: int, state: str, reason: str, **more: object) -> None:
        self._report_event(
            {
                "event": "memory",
                "t_ns": self._engine.wall_ns(t_ns),
                "file": str(self._store.path),
                "state": state,
                "reason": reason,
                "unsaved": self._memory.unsaved,
                **more,
            }
        )
