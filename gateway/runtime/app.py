"""A running gateway: frames and time go in, events and frames come out.

:class:`Gateway` does no waiting and reads no clock. ``gateway run``, ``gateway replay``, ``gateway demo`` and the
tests all drive this same class.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from gateway.bus.frames import Frames
from gateway.common.gc_pause import gc_paused
from gateway.engine.adopt import adopt
from gateway.engine.checks.bus_sleep import sender_of
from gateway.faults.hung_monitors import hung_beside
from gateway.faults.interventions import Intervention
from gateway.faults.journal import NO_JOURNAL
from gateway.faults.journal_steps import Journalled
from gateway.faults.restarts import Restart
from gateway.faults.service import as_dict
from gateway.faults.summary import Summary, summary_of
from gateway.faults.writer_thread import Writer
from gateway.runtime.account import bus_errors, counters, description, not_judged, signal_slots, unread
from gateway.runtime.event_json import summary_event
from gateway.runtime.ingest import Ingest
from gateway.runtime.outbox import Listener
from gateway.runtime.persistence import PATIENCE_S
from gateway.signals.database import Database
from gateway_fdi.common.log import get_logger

log = get_logger(__name__)


class Gateway(Ingest):
    """Engine, fault memory and servers of one configuration, from its beginning to its end or its successor.

    Its parts, in the order of a batch: :class:`~gateway.runtime.input_stage.InputStage` gives frames to the engine,
    :class:`~gateway.runtime.verdicts.Verdicts` takes its events into the fault memory,
    :class:`~gateway.runtime.outbox.Outbox` has them committed, tells them and sends them.
    :class:`~gateway.runtime.interventions.Interventions` takes the testers' changes of the memory,
    :class:`~gateway.runtime.controls.Controls` how they do it. :class:`~gateway.runtime.composition.Composition` makes
    and connects them, :class:`~gateway.runtime.ingest.Ingest` gives them their turns. This class has the rest:
    beginning, end, succession and account.

    All that people read (events, the fault memory, recordings) is stamped by the wall clock.
    """

    def listen(self, listener: Listener) -> None:
        """Add a listener; it is called with each event of the JSON contract, in order."""
        self._outbox.listen(listener)

    @gc_paused()
    def start(self, t_ns: int) -> None:
        """Start an operation cycle."""
        self.engine.warm()
        self.memory.note_descriptions()
        self._proofs.recall()
        self.note_restart(self.engine.wall_ns(t_ns))
        self.controls.start_cycle(t_ns)
        self.engine.leave_open(k for k, name in enumerate(self.parts.cycles) if self.memory.cycles.is_left_open(name))
        self._outbox.note(*self._restarted.events())
        self._keep_off()
        self._diagnosis.begin(t_ns)

    def note_restart(self, t_ns: int, boot: str = "") -> Restart | None:
        """Count this start if the last process was not stopped but died, durably; once.

        Args:
            t_ns: now, of the wall clock.
            boot: the machine's boot; "": not known.

        Returns:
            how many such restarts there were; None: it was stopped.
        """
        found = self._restarted.note(t_ns, boot)
        self.memory.commit()
        return found

    def _keep_off(self) -> None:
        """Leave monitors off whose step did not return in an earlier process."""
        path = self.store.path
        self._outbox.note(*self._off.keep_off(None if path is None else hung_beside(path)))

    def pause(self) -> None:
        """Begin no further write in the thread until :meth:`go_on`, or a successor does; what changes waits."""
        self._upkeep.pause()

    def finish(self, t_ns: int) -> Frames:
        """Put down all that a successor is to find in the fault memory; returns frames to send.

        A gateway that is then fed still goes on, as where the successor cannot be made.

        Args:
            t_ns: now.
        """
        self.pause()
        self._proofs.look(final=True)
        sent = self.poll(t_ns)  # answers that were promised
        if self._recorder is not None:
            self.memory.ledger.add_recordings(self._recorder.on_time(self.engine.now_ns, final=True))
        if not self._upkeep.beside:  # else the successor has it from this one, and writes it
            self.memory.commit(self.engine.now_ns)
        self.memory.join()
        return sent

    def go_on(self) -> None:
        """Write again, after :meth:`pause` or :meth:`finish`, where no successor could be made."""
        self._upkeep.resume()

    def succeed(self, old: Gateway) -> None:
        """Go on where a gateway of another configuration stops: same fault memory, same operation cycle.

        Common parts of both (signals, counters, monitors with the same parameters, requests and answers under way) keep
        their state; testers find the default session. The other gateway must not be used any more.

        Args:
            old: first it had all frames until now, then :meth:`finish`, then this one was made with its store: its
                later changes are lost.
        """
        self.memory.succeed(old.memory)
        self._outbox.succeed(old._outbox)
        self._doubts.succeed(old._doubts)
        self.security.succeed(old.security)
        self._caught.succeed(old._caught)
        self._diagnosis.succeed(old._diagnosis)
        self._meter.succeed(old._meter)
        indices = {bus.name: k for k, bus in enumerate(self.config.buses)}
        buses = {k: indices[bus.name] for k, bus in enumerate(old.config.buses) if bus.name in indices}
        adopt(self.engine, old.engine, buses, self._cycles_from(old))
        self._proofs.recall()
        self._suspicions.succeed()
        self.controls.go_on()
        self.asking.succeed(old.asking, buses)  # it sends requests back, whose answers the servers take
        self.servers.succeed(old.servers, buses)
        self._verdicts.count = old._verdicts.count
        self._standing.succeed(old._standing)
        self._restarted.succeed(old._restarted)
        self.reports.succeed(old.reports)
        for holder, action in old.authority.lasting():  # a new configuration begins with everything switched on
            self.controls.note(Intervention(0, "gateway", "", 0, f"{action}_ended", role=holder))
        self.memory.note_descriptions()
        self._keep_off()
        self._diagnosis.begin(self.engine.now_ns)
        if self._upkeep.beside:
            self._begin_journal()

    def _cycles_from(self, old: Gateway) -> dict[int, int]:
        names = {name: k for k, name in enumerate(self.parts.cycles)}
        return {k: names[name] for k, name in enumerate(old.parts.cycles) if name in names}

    def write_beside(self, writer: Writer | None = None, patience_s: float = PATIENCE_S) -> None:
        """Have a thread write the fault memory: frames come whether a disk is slow or not.

        Args:
            writer: the thread, which is shut down when the gateway closes; None: a new one.
            patience_s: how long a single change is waited for, before other things are done [s].
        """
        self._upkeep.write_beside(writer, patience_s)
        self._doubts.seek_beside()
        self._begin_journal()

    def _begin_journal(self) -> None:
        if self.config.memory.tell == "stored":
            self.store.begin_journal()
            if self._dtc_frames is not None:
                self._dtc_frames.prepared.withdraw = self.store.withdraw

    @property
    def journal(self) -> Journalled:
        """Memory of the journal that takes verdicts, for kernels: faults by their places in the catalogue."""
        journal = self.store.journal
        return NO_JOURNAL if journal is None else journal.memory(definition.id for definition in self.catalogue)

    def stop(self, t_ns: int, *, complete: bool = True) -> None:
        """Keep everything, and end the operation cycle if that is complete; else the next start goes on with it."""
        if self._recorder is not None:
            self.memory.ledger.add_recordings(self._recorder.on_time(t_ns, final=True))
        self._meter.stop()
        self._suspicions.look()
        self._proofs.look(final=True)
        self._diagnosis.finish(t_ns)
        self._strangers.finish(self.engine.wall_ns(t_ns))
        self._caught.look()
        self.security.pass_time(self.engine.wall_ns(t_ns), final=True)
        if complete:
            self.memory.end_cycle(self.engine.wall_ns(t_ns))
        self._outbox.settle(t_ns, self._verdicts.take, final=True)
        if self.memory.unsaved:
            log.error(
                "the fault memory was not written at the end; changes that it had not stored are lost",
                file=str(self.store.path),
                reason=self.memory.outage.reason,
                changes=self.memory.unsaved,
            )

    def close(self) -> None:
        """Close the fault memory; a gateway that is closed takes no frames, and no time passes for it."""
        self._closed = True
        self._upkeep.close()
        self._doubts.close()
        self.store.close()

    @property
    def writing(self) -> bool:
        """Whether a thread writes the fault memory at present."""
        return self.memory.ledger.under_way()

    @property
    def stored(self) -> bool:
        """Whether all that is known is in the fault memory's file."""
        return not self.memory.unsaved

    def note_buses(self, states: Sequence[Mapping[str, Any]]) -> None:
        """Store each bus's state in the fault memory so that other processes can read it."""
        activity = {bus.name: self.engine.activity(k) for k, bus in enumerate(self.config.bus)}
        self.memory.ledger.note_buses([{**state, "activity": activity[state["bus"]]} for state in states])

    @property
    def databases(self) -> Sequence[Database]:
        """The databases of its buses."""
        return self.parts.databases

    @property
    def notes(self) -> tuple[str, ...]:
        """Choices where the configuration leaves them to the databases, one line each."""
        return self.parts.notes

    @property
    def unread(self) -> list[str]:
        """Signals of answers that are not decoded, and reads whose answers have no layout, one line each."""
        return unread(self.config, self.parts.answers)

    @property
    def signal_slots(self) -> dict[str, int]:
        """Mailbox slots of the signals whose latest value is known, by full name; with the bus if there are several."""
        return signal_slots(self.config, self.engine)

    @property
    def codes(self) -> Mapping[str, tuple[str, ...]]:
        """Base codes of DTCs that were given out, by the full name of a message, a signal or a relation."""
        return self.parts.codes

    @property
    def senders(self) -> dict[str, str]:
        """Name of the ECU that sends a checked message, by the first part of its faults' ids; those that are known."""
        databases = self.databases
        found = {each.name: sender_of(each.params.message, databases[each.bus]) for each in self.parts.checks}
        return {name: sender for name, sender in found.items() if sender}

    def describe(self) -> dict[str, Any]:
        """Return what testers and other programs need to know: faults, identifiers, extended data."""
        return description(self.config, self.catalogue, self.identifiers)

    def summary(self, seconds: float) -> dict[str, Any]:
        """Return the last event of the JSON contract.

        Args:
            seconds: how long the work took by the caller's clock.
        """
        return summary_event(
            seconds,
            self._verdicts.count,
            counters(
                self.engine,
                (self.servers, self.asking, self.security, self.fence, self._diagnosis, self.reports),
                self._upkeep,
                self._recorder,
            ),
            buses=bus_errors(self.config, self.engine),
            monitors=self.engine.readout(),
            dtcs=[str(entry.dtc) for entry in self.memory.entries()],
            found=self.found(),
        )

    def found(self) -> Summary:
        """Return verdict, causes and what was not judged."""
        entries = self.memory.entries()
        described = {entry.fault: self.catalogue.get(entry.fault) for entry in entries}
        return summary_of(
            [
                as_dict(entry) | {"description": definition.description if definition else None}
                for entry, definition in zip(entries, described.values(), strict=True)
            ],
            ecus=self.senders,
            tests=len(self.catalogue),
            not_judged=not_judged(
                self.engine, self.memory, self.parts.depends, [bus.name for bus in self.config.buses]
            ),
        )  # fmt: skip
