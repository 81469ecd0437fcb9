"""A running gateway: frames and time go in, events and frames come out.

:class:`Gateway` does no waiting and reads no clock. ``gateway run``, ``gateway replay``, ``gateway demo`` and the
tests all drive this same class.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gateway.bus.conditions import are_steps
from gateway.bus.frames import FRAME, OWN, Frames, chosen, empty, joined
from gateway.common.log import get_logger
from gateway.common.resources import shipped
from gateway.config.model import Config
from gateway.engine.adopt import adopt
from gateway.engine.events import (
    CLOCK_STEPPED,
    CYCLE_BEGAN,
    CYCLE_ENDED,
    MONITOR_OFF,
    NO_BUS,
    QUALIFIED_FAILED,
    QUALIFIED_PASSED,
    Events,
)
from gateway.errors import GatewayError
from gateway.faults.beside import Writer
from gateway.faults.catalogue import FaultDefinition, as_dict
from gateway.faults.clearing import AskedClear
from gateway.faults.entries import DtcChange
from gateway.faults.failures import Observed
from gateway.faults.hung import hung_beside
from gateway.faults.interventions import Intervention
from gateway.faults.kept import KeptStore
from gateway.faults.memory import FaultMemory
from gateway.faults.recorder import Recorder
from gateway.faults.status import Status
from gateway.runtime.assemble import Parts, identifiers_of, prepare, servers_of
from gateway.runtime.controls import Controls
from gateway.runtime.doubts import Doubts
from gateway.runtime.proofs import Proofs
from gateway.runtime.reports import Reports
from gateway.runtime.standing import Standing
from gateway.runtime.switched_off import SwitchedOff
from gateway.runtime.told import (
    clear_event,
    clock_event,
    cycle_event,
    dtc_event,
    intervention_event,
    monitor_event,
    summary_event,
)
from gateway.runtime.upkeep import PATIENCE_S, Noted, Upkeep
from gateway.runtime.usage_meter import UsageMeter
from gateway.servers.access import signals_of
from gateway.servers.authority import Authority, Refusal, local_intervention
from gateway.servers.bus_servers import BusServers
from gateway.servers.dtc_frame import message_of
from gateway.servers.uds.extended_data import EXTENDED_DATA
from gateway.signals.database import Database

#: Takes one event of the JSON contract.
Listener = Callable[[dict[str, Any]], None]

log = get_logger(__name__)

_NO_FRAMES = empty(0)
_TEST_FAILED = int(Status.TEST_FAILED)


class Gateway:
    """Engine, fault memory and servers of one configuration.

    Frames and times that go in are of the engine's time, which no step of the wall clock disturbs; a frame of the
    condition STEPPED tells where the wall clock was set. What people read (events, the fault memory, recordings) is
    stamped by the wall clock.

    Args:
        config: the configuration.
        memory_path: SQLite file of the fault memory; None keeps it in this process only.
        file: where the configuration came from, for errors.
        parts: of this configuration, when they are there already (see :func:`prepare`).
        store: an open fault memory to go on with, instead of ``memory_path``.
        lasting: whether nobody writes to a batch after it was fed, as to those of a log: it can be kept as it is.

    Raises:
        InputError, InputErrors: a database, message, signal or fault that is wrong.
    """

    def __init__(
        self,
        config: Config,
        memory_path: str | Path | None = None,
        *,
        file: Path | None = None,
        parts: Parts | None = None,
        store: KeptStore | None = None,
        lasting: bool = False,
    ) -> None:
        self.config = config
        self._parts: Parts = prepare(config, file) if parts is None else parts
        self.engine, self.catalogue = self._parts.engine, self._parts.catalogue
        self.store = KeptStore(None if memory_path is None else Path(memory_path)) if store is None else store
        self._closed = False
        recording = config.memory.recording
        names = tuple(bus.name for bus in config.bus)
        self._judged = [self._parts.slots[name] for name in signals_of(config.needs)]
        self._recorder = None if recording is None else Recorder(recording, names, lasting=lasting)
        self.memory = FaultMemory(
            self.catalogue,
            self.store,
            size=config.memory.entries,
            recordings=1 if recording is None else recording.most_per_fault,
            statistics=self.engine.fold_statistics,
            usage=config.usage,
        )
        self.controls = Controls(
            self.engine,
            self.memory,
            self.store,
            self._recorder,
            self._parts.slots,
            round(config.access.stale_ms * 1e6),
            self._before_clear,
            self._after_clear,
            self._note_intervention,
            live=self._parts.live,
        )
        local = config.access.local_unlocked
        self.authority = Authority(config.needs, self.controls, local_unlocked=local)
        self._standing = Standing(self.engine, self.controls, told=self.store.path is None)
        self._meter = UsageMeter(config.usage, self.memory, self.controls, round(config.access.stale_ms * 1e6))
        self.identifiers = identifiers_of(config, self._parts, self.memory, self.controls)
        self.servers = BusServers(
            servers_of(config, self._parts, self.memory, self.authority, self.identifiers),
            len(config.bus),
            lambda: self.controls.send,
        )
        self._index = {definition.id: k for k, definition in enumerate(self.catalogue)}
        self._emitted = self.engine.emitted
        self._listeners: list[Listener] = []
        self._changes: list[DtcChange] = []  # not told yet, nor are these events
        self._untold: list[dict[str, Any]] = []
        self._entries: set[str] = set()  # before the clear that is done now
        self._early: list[Frames] = []  # to be sent before anything else
        self._upkeep = Upkeep(self.memory, self.store, self.engine, self._tell)
        self._off = SwitchedOff(self.engine)
        self._doubts = Doubts(self.engine, self._parts.checks, self._parts.databases, names, self._tell)
        self._proofs = Proofs(self.engine, self.memory)
        self.reports = Reports(config.report, self.engine, self.controls, self._on_events, self._tell)
        self.event_count = 0

    def finish(self, t_ns: int) -> Frames:
        """Put down all that a successor is to find in the fault memory; returns frames to send.

        A gateway that is then fed still goes on, as where the successor cannot be made.

        Args:
            t_ns: now.
        """
        self._upkeep.pause()
        self._proofs.look()
        sent = self.poll(t_ns)  # answers that were promised
        if self._recorder is not None:
            self.memory.add_recordings(self._recorder.on_time(self.engine.now_ns, final=True))
        if not self._upkeep.beside:  # else the successor has it from this one, and writes it
            self.memory.commit(self.engine.now_ns)
        return sent

    def go_on(self) -> None:
        """Write again, after :meth:`finish`, where no successor could be made."""
        self._upkeep.resume()

    @property
    def writing(self) -> bool:
        """Whether a thread writes the fault memory at present."""
        return self.memory.under_way()

    def succeed(self, old: Gateway) -> None:
        """Go on where a gateway of another configuration stops: same fault memory, same operation cycle.

        What both have in common (signals, counters, monitors with the same parameters, requests and answers under way)
        keeps its state; testers find the default session. The other gateway must not be used any more.

        Args:
            old: first it had all frames until now, then :meth:`finish`, then this one was made with its store: what
                it does after that is lost.
        """
        self.memory.succeed(old.memory)
        self._upkeep.succeed(old._upkeep)
        self._doubts.succeed(old._doubts)
        self._meter.succeed(old._meter)
        self._changes, self._untold = old._changes, old._untold
        indices = {bus.name: k for k, bus in enumerate(self.config.bus)}
        buses = {k: indices[bus.name] for k, bus in enumerate(old.config.bus) if bus.name in indices}
        adopt(self.engine, old.engine, buses, self._cycles_from(old))
        self._proofs.recall()
        self.controls.go_on()
        self.servers.succeed(old.servers, buses)
        self._listeners = old._listeners
        self.event_count = old.event_count
        self._standing.succeed(old._standing)
        self.reports.succeed(old.reports)
        for holder, action in old.authority.lasting():  # a new configuration begins with everything switched on
            self.controls.note(Intervention(0, "gateway", "", 0, f"{action}_ended", role=holder))
        self.memory.note_descriptions()
        self._keep_off()

    def _cycles_from(self, old: Gateway) -> dict[int, int]:
        names = {name: k for k, name in enumerate(self._parts.cycles)}
        return {k: names[name] for k, name in enumerate(old._parts.cycles) if name in names}

    def listen(self, listener: Listener) -> None:
        """Add a listener; it is called with each event of the JSON contract, in order."""
        self._listeners.append(listener)

    def start(self, t_ns: int) -> None:
        """Start an operation cycle."""
        self.engine.warm()
        self.memory.note_descriptions()
        self._proofs.recall()
        self.controls.start_cycle(t_ns)
        self._keep_off()

    def _keep_off(self) -> None:
        """Leave monitors off whose step did not return in an earlier process."""
        path = self.store.path
        self._untold += self._off.keep_off(None if path is None else hung_beside(path))

    def stop(self, t_ns: int) -> None:
        """End the operation cycle and keep everything."""
        if self._recorder is not None:
            self.memory.add_recordings(self._recorder.on_time(t_ns, final=True))
        self._meter.stop()
        self._proofs.look()
        self.memory.end_cycle(self.engine.wall_ns(t_ns))
        self._settle(t_ns, final=True)
        if self.memory.unsaved:
            log.error(
                "the fault memory was not written at the end; what it had not stored is lost",
                file=str(self.store.path),
                reason=self.memory.outage.reason,
                changes=self.memory.unsaved,
            )

    @property
    def stored(self) -> bool:
        """Whether all that is known is in the fault memory's file."""
        return not self.memory.unsaved

    def write_beside(self, writer: Writer | None = None, patience_s: float = PATIENCE_S) -> None:
        """Have a thread write the fault memory: frames come whether a disk is slow or not.

        Args:
            writer: the thread, which is shut down when the gateway closes; None: a new one.
            patience_s: how long a single change is waited for, before other things are done [s].
        """
        self._upkeep.write_beside(writer, patience_s)
        self._doubts.seek_beside()

    def close(self) -> None:
        """Close the fault memory; a gateway that is closed takes no frames, and no time passes for it."""
        self._closed = True
        self._upkeep.close()
        self._doubts.close()
        self.store.close()

    def feed(self, frames: Frames) -> Frames:
        """Take a batch of frames; returns the frames to send.

        What the returned frames say is stored before they are returned, unless it cannot be (see ``upkeep``).

        Args:
            frames: of FRAME, shape (n,), in order of time.

        Raises:
            TypeError: these are no frames.
            GatewayError: the gateway is closed.
        """
        if self._closed or type(frames) is not np.ndarray or frames.dtype is not FRAME or frames.ndim != 1:
            self._refuse_unless_frames(frames)
        if self._recorder is not None:
            self._recorder.on_frames(frames, self.engine.offset_ns)
        if self.servers.indifferent(frames):  # as to nearly every batch
            return self._emit(self._process(frames))
        sent: list[Frames] = []
        for piece, last, wanting in self.servers.pieces(frames):
            sent.append(self._emit(self._process(piece), asked=bool(wanting)))
            for k in wanting:
                made = self.servers.on_frame(k, last, self.engine.now_ns)
                sent += [*self._take_early(), made]
        return joined(sent)

    def _refuse_unless_open(self) -> None:
        if self._closed:
            raise GatewayError("this gateway is closed: make a new one")

    def _refuse_unless_frames(self, frames: object) -> None:
        self._refuse_unless_open()
        if not isinstance(frames, np.ndarray) or frames.dtype != FRAME or frames.ndim != 1:
            kind = type(frames).__name__
            if isinstance(frames, np.ndarray):
                kind = f"array of {frames.dtype} and shape {frames.shape}"
            text = (
                "frames are an array of gateway.bus.frames.FRAME, shape (n,), which put() and put_message() there fill"
            )
            raise TypeError(f"{text}; this is: {kind}")

    def without_own(self, frames: Frames) -> Frames:
        """Return a recording's frames without those that our monitors had sent: they send them again."""
        if not self._emitted:
            return frames
        own = frames["flags"] & OWN != 0
        if not own.any():
            return frames
        return chosen(frames, ~(own & np.isin(frames["can_id"], self._emitted)))

    def _process(self, frames: Frames) -> Frames:
        if not self._meter.measures:
            return self._process_piece(frames)
        sent: list[Frames] = []
        for piece, look_ns in self._meter.pieces(frames):
            if look_ns is None:
                sent.append(self._process_piece(piece))
            elif self.controls.receive:  # frames and time until the look in one pass of the loop
                sent.append(self.engine.process(piece, self._on_events, look_ns))
                self._meter.look()
            else:
                sent += [self._process_piece(piece), self._look(look_ns)]
        return joined(sent)

    def _look(self, t_ns: int) -> Frames:
        """Let time pass until a look of the meter."""
        sent = self.engine.advance(t_ns, self._on_events)
        self._meter.look()
        return sent

    def _process_piece(self, frames: Frames) -> Frames:
        if self.controls.receive or not len(frames):
            return self.engine.process(frames, self._on_events)
        # A tester has switched reception off: of the frames only their time counts, and where the clock was set.
        # And what conditions of access need: what is blinded because the vehicle stands must see that it moves.
        needed = are_steps(frames) | self.engine.plan.among(frames, self._judged)
        sent = self.engine.process(chosen(frames, needed), self._on_events)
        more = self.engine.advance(int(frames["t_ns"].max()), self._on_events)
        return joined([sent, more])

    def advance(self, t_ns: int) -> Frames:
        """Let time pass without frames; returns the frames to send.

        Raises:
            GatewayError: the gateway is closed.
        """
        self._refuse_unless_open()
        looks = self._meter.times(t_ns) if self._meter.measures else ()
        sent = [self._look(look_ns) for look_ns in looks]
        return self._emit(joined([*sent, self.engine.advance(t_ns, self._on_events)]))

    def poll(self, t_ns: int) -> Frames:
        """Let time pass for the servers that answer others, which the monitors' time lags behind.

        Args:
            t_ns: now, of the clock that stamps frames.
        """
        return joined(self.servers.on_time(t_ns, prompt=True))

    def promise(self, frames: Frames, t_ns: int) -> Frames:
        """Return what has testers wait (0x78), whose requests are among frames that a successor is fed.

        Args:
            frames: not to be fed to this one.
            t_ns: now, of the clock that stamps frames.
        """
        return joined([empty(0), *self.servers.promise(frames, t_ns)])

    @property
    def next_ns(self) -> int:
        """Time at which :meth:`poll` has something to do."""
        return self.servers.next_prompt_ns

    @property
    def due_ns(self) -> int:
        """Time at which :meth:`advance` has something to do; while it waits for a write or the like: the past."""
        if self._changes or self._untold or self._early or not self._idle:
            return -1
        return min(self.engine.due_ns, self.servers.next_ns)

    @property
    def databases(self) -> Sequence[Database]:
        """The databases of its buses."""
        return self._parts.databases

    @property
    def dtc_frame_id(self) -> int:
        """Identifier of the DTC frame."""
        return int(message_of(shipped("dbc/gateway.dbc")).frame_id)

    def identifiers_on(self, bus: int) -> list[int] | None:
        """Return the identifiers (with EXTENDED) that it listens to on a bus; None: to all."""
        decoded, served = self.engine.plan.identifiers(bus), self.servers.identifiers_on(bus)
        return None if decoded is None or served is None else decoded + served

    def serve_requests(self) -> None:
        """Do what other processes asked the fault memory for (``gateway faults clear``)."""
        self._upkeep.look(self.engine.now_ns)
        self._proofs.look()
        judged: list[tuple[AskedClear, Refusal]] = []

        def judge(asked: AskedClear) -> int:
            refusal = self.authority.local_refusal("clear")
            judged.append((asked, refusal))
            return Refusal.NONE if asked.force else refusal

        cleared = self.memory.serve_requests(self._before_clear, judge)
        for asked, refusal in judged:
            if not (cleared or (refusal and not asked.force)):
                continue  # it could not be written, or there was nothing
            request = b"\x14" + asked.group.to_bytes(3, "big")
            self.controls.note(
                local_intervention("clear", request, asked.by, refusal, force=asked.force, why=asked.why)
            )
        if cleared:
            self.controls.forget(cleared)
        self._upkeep.tend()

    def note_buses(self, states: Sequence[Mapping[str, Any]]) -> None:
        """Store each bus's state in the fault memory so that other processes can read it."""
        self.memory.note_buses(states)

    def _on_events(self, events: Events) -> None:
        self.event_count += len(events)
        for event in events:
            kind = int(event["kind"])
            if kind in (CYCLE_BEGAN, CYCLE_ENDED):
                self._on_cycle(event, began=kind == CYCLE_BEGAN)
                continue
            if kind == CLOCK_STEPPED:
                self._on_step(event)
                continue
            if kind == MONITOR_OFF:
                self._untold.append(self._off.on_event(event, self._bus_name(int(event["bus"]))))
                continue
            if kind == QUALIFIED_FAILED:
                self._doubts.seek(int(event["fault"]), int(event["t_ns"]))
            changes = self.memory.apply(event, self._observe)
            told = self._note_changes(changes)
            if kind not in (QUALIFIED_FAILED, QUALIFIED_PASSED) or not told:
                self._untold.append(monitor_event(event, self.catalogue, self._bus_name(int(event["bus"]))))

    def _note_changes(self, changes: Sequence[DtcChange]) -> bool:
        """Keep changes to be told when they are stored; returns whether there are any worth it."""
        told = [change for change in changes if change.concerns_fault]
        self._changes += told
        for change in told:
            self._record(change)
            bus = self.engine.faults[self._index[change.definition.id]].bus
            self._untold.append(dtc_event(change, self._bus_name(bus)))
        return bool(told)

    def _record(self, change: DtcChange) -> None:
        if self._recorder is not None and int(change.new_status) & ~int(change.old_status) & _TEST_FAILED:
            t_ns = change.t_ns - self.engine.offset_ns
            self._recorder.on_failure(change.definition.id, t_ns, wall_ns=change.t_ns)

    def _on_cycle(self, event: np.void, *, began: bool) -> None:
        name, t_ns = self._parts.cycles[int(event["fault"])], int(event["t_ns"])
        if began:
            self.controls.begin(name, t_ns)
        else:
            self.controls.end(name, t_ns)
        bus, number = self._bus_name(int(event["bus"])), self.memory.cycle_number(name)
        self._untold.append(cycle_event(t_ns, bus, name, began=began, number=number))

    def _on_step(self, event: np.void) -> None:
        self._untold.append(clock_event(int(event["t_ns"]), float(event["value"])))

    def _bus_name(self, bus: int) -> str:
        """Return the name of a bus; the gateway's own faults are of none."""
        return "" if bus == NO_BUS else self.config.bus[bus].name

    def _emit(self, sent: Frames, *, asked: bool = False) -> Frames:
        """Return the frames to send: the monitors' own, then what the servers have to say.

        Args:
            sent: by the monitors.
            asked: whether somebody asks for what there is now.
        """
        now = self.engine.now_ns
        if not (self._changes or self._untold or self._early) and self._idle and now < self.servers.next_ns:
            return sent if self.controls.send else _NO_FRAMES  # as for nearly every batch
        self._doubts.poll()
        self._standing.settle(self._on_events)
        if self._recorder is not None and self._recorder.busy:
            self.memory.add_recordings(self._recorder.on_time(now))
        if self.memory.room:
            self._note_changes(self.memory.admit_refused(self.engine.wall_ns(now)))
        frames = [*self._take_early(), sent if self.controls.send else _NO_FRAMES]
        frames += self.servers.on_changes(self._settle(now, asked=asked), now)
        frames += self.servers.on_time(now)
        return joined(frames)

    @property
    def _idle(self) -> bool:
        """Whether nothing waits: no recording, no entry for which there is room now, no write, no search for rules.

        Nor that monitoring was switched, and is not told.
        """
        if not self._standing.settled:
            return False
        recording = self._recorder is not None and self._recorder.busy
        return not (recording or self.memory.room or self._doubts.busy) and self._upkeep.idle

    def _before_clear(self) -> None:
        """Write and tell all that waits: what is cleared next must not be told as set after it."""
        now = self.engine.now_ns
        self._early += self.servers.on_changes(self._settle(now, final=True), now)
        self._entries = {entry.fault for entry in self.memory.entries()}

    def _after_clear(self, cleared: Iterable[str]) -> None:
        """Tell which entries went."""
        self._off.again()
        cleared = list(cleared)
        self._standing.after_clear(cleared)
        gone = sorted(self._entries.intersection(cleared))
        t_ns = self.engine.wall_ns(self.engine.now_ns)
        self._tell(clear_event(t_ns, gone))

    def _note_intervention(self, intervention: Intervention) -> None:
        """Keep what a tester did; it is told when it is stored."""
        told = self.memory.note_intervention(intervention)
        if told is not None:
            self._untold.append(intervention_event(told))

    def _take_early(self) -> list[Frames]:
        early, self._early = self._early, []
        return early

    def _settle(self, now: int, *, asked: bool = False, final: bool = False) -> list[DtcChange]:
        """Write what has changed, if it is time, and tell the events of it; returns the changes to tell.

        What is wrong with the memory itself is told before what it could not store.
        """
        if not (final or self._changes or self._untold) and self._upkeep.idle:
            return []  # as for nearly every batch
        self._off.report(self._on_events)
        waiting, self._changes = self._changes, []
        noted = Noted(len(waiting), len(self._untold))
        may = self._upkeep.settle(now, noted, self._on_events, asked=asked, final=final)
        own, self._changes = self._changes, waiting[may.changes :]
        events = may.events
        if self._upkeep.beside and not final and self._upkeep.stored:
            self._changes += own  # of the memory's own faults: they are written next
            own = []
        elif may == noted:
            events = len(self._untold)
        told, self._untold = self._untold[:events], self._untold[events:]
        stored = self._upkeep.stored
        for event in told:
            if event["event"] == "dtc":
                event["stored"] = stored
                self._upkeep.not_stored += not stored
            self._tell(event)
        return own + waiting[: may.changes]

    def _observe(self, definition: FaultDefinition) -> Observed:
        inputs = self.engine.inputs_of(self._index[definition.id])
        return Observed(
            {name: self.controls.value(name) for name in self._parts.frozen[definition.id]},
            {f"{ref.message}.{ref.signal}": value for ref, value in inputs.items()},
        )

    def _tell(self, event: dict[str, Any]) -> None:
        for listener in self._listeners:
            listener(event)

    @property
    def notes(self) -> tuple[str, ...]:
        """What was taken where the configuration leaves it to the databases, one line each."""
        return self._parts.notes

    @property
    def signal_slots(self) -> dict[str, int]:
        """Mailbox slots of the signals whose latest value is known, by full name; with the bus if there are several."""
        buses = self.config.bus
        return {
            ("" if len(buses) == 1 else f"{buses[ref.bus].name}.") + f"{ref.message}.{ref.signal}": slot
            for slot, ref in enumerate(self.engine.plan.slot_names)
        }

    @property
    def codes(self) -> Mapping[str, tuple[str, ...]]:
        """Base codes of DTCs that were given out, by the full name of a message, a signal or a relation."""
        return self._parts.codes

    def describe(self) -> dict[str, Any]:
        """Return what testers and other programs need to know: faults, identifiers, extended data."""
        return {
            "name": self.config.name,
            "faults": [as_dict(definition) for definition in self.catalogue],
            "identifiers": self.identifiers.describe(),
            "extended_data": [
                {"record": number, "name": kind.name, "length": kind.length} for number, kind in EXTENDED_DATA.items()
            ],
        }

    def summary(self, seconds: float) -> dict[str, Any]:
        """Return the last event of the JSON contract.

        Args:
            seconds: how long the work took by the caller's clock.
        """
        counters = self.engine.counters()
        for name, count in self.servers.counters().items():
            counters[name] = counters.get(name, 0) + count
        counters["memory_not_stored"] = self._upkeep.not_stored
        counters["memory_write_failures"] = self._upkeep.failures
        counters |= self.reports.counters()
        if self._recorder is not None:
            counters["recordings_refused"] = self._recorder.refused
        errors = {
            bus.name: {name: n for name, n in self.engine.error_counters(k).items() if n}
            for k, bus in enumerate(self.config.bus)
        }
        return summary_event(
            seconds,
            self.event_count,
            counters,
            buses=errors,
            monitors=self.engine.readout(),
            dtcs=[str(entry.dtc) for entry in self.memory.entries()],
        )
