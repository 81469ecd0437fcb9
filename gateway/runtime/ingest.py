"""Frames and time go into a gateway, frames to send come out: batches, a pump's, servers' and clients' time."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gateway.bus.conditions import overtimes
from gateway.bus.frames import FRAME, Frames, empty, joined
from gateway.runtime.composition import Composition
from gateway.runtime.fast_path_conditions import AT_ONCE, EVERYTHING, JOURNAL, NOBODY, FastPathConditions
from gateway.runtime.input_stage import refuse_unless_frames
from gateway.servers.prepared_frames_kernel import PreparedTables
from gateway_fdi.errors import GatewayError

_NO_FRAMES = empty(0)


class Ingest(Composition):
    """The parts of a gateway in the order in which they have their turn after a batch.

    Times that go in are of the engine's time, which no step of the wall clock disturbs; a frame of the condition
    STEPPED tells where the wall clock was set.
    """

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
        if self._off.marked and len(late := overtimes(frames)):
            return self._feed_around(frames, late)
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

    def _feed_around(self, frames: Frames, late: NDArray[np.intp]) -> Frames:
        """Take a batch of a recording in which steps took too long; returns the frames to send."""
        sent: list[Frames] = []
        start = 0
        for at in late.tolist():
            if at > start:
                sent.append(self.feed(frames[start:at]))
            self._outbox.note(*self._off.stop(frames[at]))
            start = at + 1
        if start < len(frames):
            sent.append(self.feed(frames[start:]))
        return joined([_NO_FRAMES, *sent])

    def take_overtimes(self) -> Frames:
        """Return frames for recordings, of monitors whose step took too long since the last call."""
        return self._off.take_overtimes()

    def quiet(self) -> FastPathConditions:
        """Return what a pump must know to feed the engine in place of :meth:`feed`."""
        settled = self._outbox.empty and self._settled and not self._closed
        before_ns = self._reception.before_ns if settled else None
        due_ns = self.servers.next_ns
        if self._recorder is not None:
            due_ns = min(due_ns, self._recorder.due_ns + 1)
        before_ns = EVERYTHING if before_ns is None else before_ns
        foretells = self._early_sender(settled)
        return FastPathConditions(before_ns, due_ns, self.next_ns, self._heard, self.controls.send, foretells, settled)

    def _early_sender(self, settled: bool) -> int:
        """Return who may send DTC frames of verdicts; ``settled``: nothing waits that is to be told before."""
        may, first = settled and self._dtc_frames is not None and self.controls.send, self._outbox.first
        journal = self.store.arm_journal(may and not first)
        if self._dtc_frames is None or not may or not (first or journal or self._upkeep.in_process):
            return NOBODY
        self._dtc_frames.prepared.foresee()
        return JOURNAL if journal else AT_ONCE

    @property
    def foreseen(self) -> PreparedTables | None:
        """Tables of which a pump makes DTC frames; None: there are none."""
        return None if self._dtc_frames is None else self._dtc_frames.prepared.tables

    def took(self, frames: Frames) -> None:
        """Take down frames that a pump has fed, in order of time; its events come after, by :meth:`tell`."""
        if self._recorder is not None:
            self._recorder.on_frames(frames, self.engine.offset_ns)
        self._reception.hear(frames)

    def deliver(self, gone: Frames = _NO_FRAMES) -> Frames:
        """Take the events of the engine where a pump has left; returns the frames to send, before it goes on.

        Args:
            gone: DTC frames of these events that it has sent.
        """
        if self._dtc_frames is None or not len(gone):
            return self._emit(self._reception.deliver())
        self._dtc_frames.prepared.note(gone)
        sent = self._reception.deliver()
        corrected = self._dtc_frames.correct(self._outbox.noted, self.engine.now_ns)
        return joined([self._emit(sent), corrected])

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
        self._off.marked |= self._off.in_python and bool(len(overtimes(frames)))  # live frames have no such marks
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

    def identifiers_on(self, bus: int) -> list[int] | None:
        """Return the identifiers (with EXTENDED) that it listens to on a bus; None: to all."""
        if self.config.buses[bus].health.unknown != "none":
            return None
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
        self._suspicions.look()
        self._caught.look()
        self.security.pass_time(self.engine.wall_ns(self.engine.now_ns))
        self._interventions.serve_requests()
        self._upkeep.tend()

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
            self.memory.ledger.add_recordings(self._recorder.on_time(now))
        if self.memory.room:
            self._verdicts.note_changes(self.memory.admit_refused(self.engine.wall_ns(now)))
            self._diagnosis.look_at_entries()
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
