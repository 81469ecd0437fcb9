"""A running gateway: frames and time go in, events and frames come out.

:class:`Gateway` does no waiting and reads no clock. ``gateway run``, ``gateway replay``, ``gateway demo`` and the
tests all drive this same class.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gateway.bus.frames import FRAME, Frames, empty, joined
from gateway.common.uncollected import uncollected
from gateway.config.model import Config
from gateway.engine.adopt import adopt
from gateway.engine.depends.derive import Dependences
from gateway.faults.beside import Writer
from gateway.faults.cases import cases_of
from gateway.faults.hung import hung_beside
from gateway.faults.interventions import Intervention
from gateway.faults.kept import KeptStore
from gateway.faults.memory import FaultMemory
from gateway.faults.recorder import Recorder
from gateway.faults.service import as_dict
from gateway.runtime.account import bus_errors, counters, description, signal_slots
from gateway.runtime.assemble import Parts, asking_of, connect_routes, identifiers_of, prepare, servers_of
from gateway.runtime.causes import Causes
from gateway.runtime.controls import Controls
from gateway.runtime.doubts import Doubts
from gateway.runtime.explainer import Explainer
from gateway.runtime.interventions import Interventions
from gateway.runtime.outbox import Listener, Outbox
from gateway.runtime.proofs import Proofs
from gateway.runtime.quiet import EVERYTHING, Quiet
from gateway.runtime.reception import Reception, refuse_unless_frames
from gateway.runtime.reports import Reports
from gateway.runtime.standing import Standing
from gateway.runtime.switched_off import SwitchedOff
from gateway.runtime.told import (
    summary_event,
)
from gateway.runtime.upkeep import PATIENCE_S
from gateway.runtime.usage_meter import UsageMeter
from gateway.runtime.vehicle import Vehicle
from gateway.runtime.verdicts import Verdicts
from gateway.servers.access import signals_of
from gateway.servers.authority import Authority
from gateway.servers.bus_servers import BusServers
from gateway.servers.dtc_frame import message_of
from gateway.signals.database import Database
from gateway_fdi.common.log import get_logger
from gateway_fdi.common.resources import shipped
from gateway_fdi.errors import GatewayError

log = get_logger(__name__)

_NO_FRAMES = empty(0)


class Gateway:
    """Engine, fault memory and servers of one configuration.

    Its parts, in the order of a batch: :class:`~gateway.runtime.reception.Reception` gives frames to the engine,
    :class:`~gateway.runtime.verdicts.Verdicts` takes its events into the fault memory,
    :class:`~gateway.runtime.outbox.Outbox` has them committed, tells them and sends them.
    :class:`~gateway.runtime.interventions.Interventions` takes the testers' changes of the memory,
    :class:`~gateway.runtime.controls.Controls` how they do it. This class has the rest: beginning, end and succession,
    and the order in which the parts have their turn after a batch.

    Frames and times that go in are of the engine's time, which no step of the wall clock disturbs; a frame of the
    condition STEPPED tells where the wall clock was set. All that people read (events, the fault memory, recordings) is
    stamped by the wall clock.

    Args:
        config: the configuration.
        memory_path: SQLite file of the fault memory; None keeps it in this process only.
        file: where the configuration came from, for errors.
        parts: of this configuration, when they are there already (see :func:`prepare`).
        store: an open fault memory to go on with, instead of ``memory_path``.
        lasting: whether batches are not written to after they were fed, as those of a log: they can be kept as they
            are.

    Raises:
        InputError, InputErrors: a database, message, signal or fault that is wrong.
    """

    @uncollected()
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
        self._recorder = None if recording is None else Recorder(recording, names, lasting=lasting)
        self.memory = FaultMemory(
            self.catalogue,
            self.store,
            size=config.memory.entries,
            recordings=1 if recording is None else recording.most_per_fault,
            statistics=self.engine.fold_statistics,
            usage=config.usage,
            ahead=config.memory.tell == "first",
        )
        self.controls = Controls(
            self.engine,
            self.memory,
            self.store,
            self._recorder,
            self._parts.slots,
            round(config.access.stale_ms * 1e6),
            live=self._parts.live,
        )
        local = config.access.local_unlocked
        self.authority = Authority(config.needs, self.controls, local_unlocked=local)
        self._standing = Standing(self.engine, self.controls, told=self.store.path is None)
        self._meter = UsageMeter(config.usage, self.memory, self.controls, round(config.access.stale_ms * 1e6))
        self.identifiers = identifiers_of(config, self._parts, self.memory, self.controls)
        self.asking = asking_of(config, self._parts, self.controls, self._may_ask)
        self._vehicle = Vehicle(config, self.asking, self.memory, self.engine)
        servers = servers_of(config, self._parts, self.memory, self.authority, self.identifiers)
        servers += [self._vehicle] if config.answered else []
        self.servers = BusServers(servers, len(config.buses), lambda: self.controls.send)
        connect_routes(self.servers, self.asking)
        self._heard = self.servers.heard.also(self.asking.heard)
        self._connect()

    def _may_ask(self, bus: int) -> bool:
        """Return whether other ECUs of a bus may be asked now: it is neither dead nor asleep, and we may send."""
        awake = self.config.power.awake
        return (
            self.controls.send
            and self.engine.bus_lives(bus)
            and (not awake or any(self.controls.met_so_far(condition) for condition in awake))
        )

    def _connect(self) -> None:
        """Make the links between the parts: frames in, verdicts, events and frames out."""
        self._off = SwitchedOff(self.engine)
        first, send = self.config.memory.tell == "first", self.servers.on_changes
        self._outbox = Outbox(self.memory, self.store, self.engine, self._off.report, send, first=first)
        self._upkeep = self._outbox.upkeep
        names = [bus.name for bus in self.config.buses]
        self._doubts = Doubts(self.engine, self._parts.checks, self._parts.databases, names, self._outbox.tell)
        self._proofs = Proofs(self.engine, self.memory)
        parts = self._parts
        known = Dependences(dict(parts.depends), dict(parts.residuals), parts.behind)
        self._causes = Causes(self.engine, known, parts.checks)
        self._explainer = Explainer(
            self.engine,
            self.memory,
            parts.depends,
            self._causes,
            hold=self.config.memory.symptoms == "hold",
            note=self._outbox.note,
        )
        self._verdicts = Verdicts(
            self.config,
            self._parts,
            self.memory,
            self.controls,
            self._recorder,
            self._outbox,
            self._off,
            self._doubts,
            self._causes,
            self._explainer.failed,
        )
        self._explainer.note_changes = self._verdicts.note_changes
        self._vehicle.connect(self._outbox.note, self._verdicts.take)
        judged = [self._parts.slots[name] for name in signals_of(self.config.needs)]
        self._reception = Reception(self.engine, self.controls, self._meter, judged, self._verdicts.take)
        self._interventions = Interventions(
            self.engine,
            self.memory,
            self._outbox,
            self._verdicts,
            self.controls,
            self.authority,
            self._standing,
            self._off,
        )
        self.controls.connect(self._interventions)
        self.reports = Reports(self.config.report, self.engine, self.controls, self._verdicts.take, self._outbox.tell)

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

        Common parts of both (signals, counters, monitors with the same parameters, requests and answers under way) keep
        their state; testers find the default session. The other gateway must not be used any more.

        Args:
            old: first it had all frames until now, then :meth:`finish`, then this one was made with its store: its
                later changes are lost.
        """
        self.memory.succeed(old.memory)
        self._outbox.succeed(old._outbox)
        self._doubts.succeed(old._doubts)
        self._causes.succeed(old._causes)
        self._explainer.succeed(old._explainer)
        self._meter.succeed(old._meter)
        indices = {bus.name: k for k, bus in enumerate(self.config.buses)}
        buses = {k: indices[bus.name] for k, bus in enumerate(old.config.buses) if bus.name in indices}
        adopt(self.engine, old.engine, buses, self._cycles_from(old))
        self._proofs.recall()
        self.controls.go_on()
        self.asking.succeed(old.asking, buses)  # it sends requests back, whose answers the servers take
        self.servers.succeed(old.servers, buses)
        self._verdicts.count = old._verdicts.count
        self._standing.succeed(old._standing)
        self.reports.succeed(old.reports)
        for holder, action in old.authority.lasting():  # a new configuration begins with everything switched on
            self.controls.note(Intervention(0, "gateway", "", 0, f"{action}_ended", role=holder))
        self.memory.note_descriptions()
        self._keep_off()
        self._explainer.begin(self.engine.now_ns)

    def _cycles_from(self, old: Gateway) -> dict[int, int]:
        names = {name: k for k, name in enumerate(self._parts.cycles)}
        return {k: names[name] for k, name in enumerate(old._parts.cycles) if name in names}

    def listen(self, listener: Listener) -> None:
        """Add a listener; it is called with each event of the JSON contract, in order."""
        self._outbox.listen(listener)

    @uncollected()
    def start(self, t_ns: int) -> None:
        """Start an operation cycle."""
        self.engine.warm()
        self.memory.note_descriptions()
        self._proofs.recall()
        self.controls.start_cycle(t_ns)
        self._keep_off()
        self._explainer.begin(t_ns)

    def _keep_off(self) -> None:
        """Leave monitors off whose step did not return in an earlier process."""
        path = self.store.path
        self._outbox.note(*self._off.keep_off(None if path is None else hung_beside(path)))

    def stop(self, t_ns: int) -> None:
        """End the operation cycle and keep everything."""
        if self._recorder is not None:
            self.memory.add_recordings(self._recorder.on_time(t_ns, final=True))
        self._meter.stop()
        self._proofs.look()
        if self._causes.pending:
            self._causes.look(t_ns)
        self._explainer.finish(t_ns)
        self.memory.end_cycle(self.engine.wall_ns(t_ns))
        self._outbox.settle(t_ns, self._verdicts.take, final=True)
        if self.memory.unsaved:
            log.error(
                "the fault memory was not written at the end; changes that it had not stored are lost",
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

        The contents of the returned frames are stored before, unless they cannot be (see ``upkeep``).

        Args:
            frames: of FRAME, shape (n,), in order of time.

        Raises:
            TypeError: these are no frames.
            GatewayError: the gateway is closed.
        """
        if self._closed or type(frames) is not np.ndarray or frames.dtype is not FRAME or frames.ndim != 1:
            self._refuse_unless_open()
            refuse_unless_frames(frames)
        if self._recorder is not None:
            self._recorder.on_frames(frames, self.engine.offset_ns)
        frames = self.asking.hear(frames)
        if self.servers.indifferent(frames):  # as to nearly every batch
            return self._emit(self._reception.process(frames))
        sent: list[Frames] = []
        for piece, last, wanting in self.servers.pieces(frames):
            sent.append(self._emit(self._reception.process(piece), asked=bool(wanting)))
            for k in wanting:
                made = self.servers.on_frame(k, last, self.engine.now_ns)
                sent += [*self._outbox.take_early(), made]
        return joined(sent)

    def quiet(self) -> Quiet:
        """Return what a pump must know to feed the engine in place of :meth:`feed`."""
        settled = self._outbox.empty and self._settled and not self._closed
        before_ns = self._reception.before_ns if settled else None
        due_ns = self.servers.next_ns
        if self._recorder is not None:
            due_ns = min(due_ns, self._recorder.due_ns + 1)
        before_ns = EVERYTHING if before_ns is None else before_ns
        return Quiet(before_ns, due_ns, self.next_ns, self._heard, self.controls.send, settled)

    def took(self, frames: Frames) -> None:
        """Take down frames that a pump has fed, in order of time; its events come after, by :meth:`tell`."""
        if self._recorder is not None:
            self._recorder.on_frames(frames, self.engine.offset_ns)
        self._reception.hear(int(frames["t_ns"].max()))

    def tell(self) -> Frames:
        """Take the events of the engine where a pump has left; returns the frames to send, before it goes on."""
        return self._emit(self._reception.tell())

    def resume(self, frames: Frames, start: int) -> Frames:
        """Go on with a batch that a pump has begun, and that was taken down; returns the frames to send.

        Args:
            frames: of FRAME, shape (n,).
            start: the first that the engine has not handled.
        """
        return self._emit(self._reception.resume(frames, start))

    def _refuse_unless_open(self) -> None:
        if self._closed:
            raise GatewayError("this gateway is closed: make a new one")

    def without_own(self, frames: Frames) -> Frames:
        """Return a recording's frames without those that our monitors had sent: they send them again."""
        return self._reception.without_own(frames)

    def advance(self, t_ns: int) -> Frames:
        """Let time pass without frames; returns the frames to send.

        Raises:
            GatewayError: the gateway is closed.
        """
        self._refuse_unless_open()
        return self._emit(self._reception.advance(t_ns))

    def poll(self, t_ns: int) -> Frames:
        """Let time pass for the servers that answer others, and for the clients: the monitors' time lags theirs.

        Args:
            t_ns: now, of the clock that stamps frames.
        """
        made = self.servers.on_time(t_ns, prompt=True)
        return joined([*made, self.asking.poll(t_ns)] if t_ns >= self.asking.next_ns else made)

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
        return min(self.servers.next_prompt_ns, self.asking.next_ns)

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
        found: list[int] = []
        for of in (self.engine.plan.identifiers, self.servers.identifiers_on, self.asking.identifiers_on):
            more = of(bus)
            if more is None:
                return None
            found += more
        return found

    def serve_requests(self) -> None:
        """Do what other processes asked the fault memory for (``gateway faults clear``)."""
        self._upkeep.look(self.engine.now_ns)
        self._proofs.look()
        self._interventions.serve_requests()
        self._upkeep.tend()

    def note_buses(self, states: Sequence[Mapping[str, Any]]) -> None:
        """Store each bus's state in the fault memory so that other processes can read it."""
        self.memory.note_buses(states)

    def _emit(self, sent: Frames, *, asked: bool = False) -> Frames:
        """Return the frames to send: the monitors' own, then what the servers have to say.

        Args:
            sent: by the monitors.
            asked: whether there is a request for the present state.
        """
        now = self.engine.now_ns
        if self._outbox.empty and self._idle and now < self.servers.next_ns:
            return sent if self.controls.send else _NO_FRAMES  # as for nearly every batch
        self._doubts.poll()
        self._standing.settle(self._verdicts.take)
        if self._recorder is not None and self._recorder.busy:
            self.memory.add_recordings(self._recorder.on_time(now))
        if self.memory.room:
            self._verdicts.note_changes(self.memory.admit_refused(self.engine.wall_ns(now)))
            self._explainer.look_soon()
        frames = [*self._outbox.take_early(), sent if self.controls.send else _NO_FRAMES]
        frames += self._outbox.release(now, self._verdicts.take, asked=asked)
        frames += self.servers.on_time(now)
        return joined(frames)

    @property
    def _idle(self) -> bool:
        """Whether nothing waits: no recording, no entry for which there is room now, no write, no search for rules.

        Nor that monitoring was switched, and is not told.
        """
        return self._settled and not (self._recorder is not None and self._recorder.busy)

    @property
    def _settled(self) -> bool:
        """Whether nothing waits but time."""
        return self._standing.settled and not (self.memory.room or self._doubts.busy) and self._upkeep.idle

    @property
    def notes(self) -> tuple[str, ...]:
        """Choices where the configuration leaves them to the databases, one line each."""
        return self._parts.notes

    @property
    def unread(self) -> list[str]:
        """Signals of answers that are not decoded, and reads whose answers have no layout, one line each."""
        found = [text for bus in self._parts.answers for text in bus.left_out]
        for ecus, answers in zip(self.config.answered.values(), self._parts.answers, strict=True):
            for k, lengths in zip(ecus, answers.lengths, strict=True):
                ecu = self.config.ecu[k]
                unread = [read.name for read in ecu.read if read.key not in lengths and read.pgn is None]
                found += [f"ecu[{k}]: no layout of {', '.join(unread)}: answers are only counted"] if unread else []
        return found

    @property
    def signal_slots(self) -> dict[str, int]:
        """Mailbox slots of the signals whose latest value is known, by full name; with the bus if there are several."""
        return signal_slots(self.config, self.engine)

    @property
    def codes(self) -> Mapping[str, tuple[str, ...]]:
        """Base codes of DTCs that were given out, by the full name of a message, a signal or a relation."""
        return self._parts.codes

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
                self.engine, (self.servers, self.asking), self._upkeep, self._recorder, self.reports, self._explainer
            ),
            buses=bus_errors(self.config, self.engine),
            monitors=self.engine.readout(),
            dtcs=[str(entry.dtc) for entry in self.memory.entries()],
            causes=[case.as_dict() for case in cases_of([as_dict(entry) for entry in self.memory.entries()])],
        )
