"""The live loop: buses are readable, time passes, frames leave."""

from __future__ import annotations

import gc
import selectors
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from typing import Any, Protocol

import numpy as np

from gateway.bus.conditions import LOST, RUNNING, step_frame
from gateway.bus.frames import ERROR, OWN, Frames, empty
from gateway.bus.timeline import to_wall
from gateway.engine.core import Engine
from gateway.live import pumping
from gateway.live.clock import Clock
from gateway.live.link import Link
from gateway.live.merge import Merger
from gateway.live.pump import HELD, Left, Pump
from gateway.runtime.passage import Quiet
from gateway_fdi.common.log import get_logger

#: Without traffic, the engine's time lags the clock by this, so that a frame that is still on its
#: way through the kernel is not overtaken by the timers it would have stopped.
GRACE_NS = 20_000_000
#: Longest wait for a bus while something else than time is waited for: a write, a search, a reader's next look.
TICK_S = 0.01
#: How often requests of other processes are looked for; the longest wait of all.
POLL_S = 0.1
#: Least time between two reports of lost frames of one bus.
REPORT_S = 1.0
#: How often the state of the buses is kept for other processes.
KEEP_S = 10.0
#: How long a thread of Python that computes may have the interpreter, while a verdict waits for it [s].
SWITCH_S = 0.00005
#: Batches taken from a bus before the others, and the rest of the work, have their turn.
TURN = 16
#: The same, when there is no next turn: more than any queue holds.
LAST_TURN = 4096

log = get_logger(__name__)


class Tap(Protocol):
    """Takes a copy of each frame on the buses, stamped by the wall clock."""

    def write(self, frames: Frames) -> None:
        """Take a batch."""


class Fed(Protocol):
    """Receiver of frames and time: a gateway."""

    @property
    def engine(self) -> Engine | None:
        """Its engine, which a pump may feed; None: there is none."""

    @property
    def next_ns(self) -> int:
        """Time at which :meth:`poll` has something to do."""

    @property
    def due_ns(self) -> int:
        """Time at which :meth:`advance` has something to do; of what waits for something else than time: the past."""

    def feed(self, frames: Frames) -> Frames:
        """Take a batch; returns the frames to send."""

    def advance(self, t_ns: int) -> Frames:
        """Let time pass; returns the frames to send."""

    def poll(self, t_ns: int) -> Frames:
        """Let time pass for answers; returns the frames to send."""

    def identifiers_on(self, bus: int) -> list[int] | None:
        """Return what it listens to; None: to all."""

    def quiet(self) -> Quiet | None:
        """Return what a pump must know to feed its engine; None: something waits, or there is no engine."""

    def took(self, frames: Frames) -> None:
        """Take down frames that a pump has fed."""

    def tell(self) -> Frames:
        """Take what the engine has to tell where a pump has left; returns the frames to send."""

    def resume(self, frames: Frames, start: int) -> Frames:
        """Go on with a batch that a pump has begun; returns the frames to send."""

    def serve_requests(self) -> None:
        """Do what other processes ask."""

    def note_buses(self, states: Sequence[Mapping[str, Any]]) -> None:
        """Store each bus's state."""

    def promise(self, frames: Frames, t_ns: int) -> Frames:
        """Return what has testers wait, whose requests are among frames that are fed later."""

    def finish(self, t_ns: int) -> Frames:
        """Put down what a successor is to find; returns the frames to send."""


class Door(Protocol):
    """Access to the gateway for other processes, beside the buses."""

    def fileno(self) -> int:
        """Return a descriptor that is readable when a client wants something."""

    def listening(self) -> bool:
        """Return whether a watcher is there who is shown the time."""

    def on_frames(self, frames: Frames) -> None:
        """Take what came from the buses, or goes there."""

    def turn(self, now_s: float, *, wanted: bool) -> None:
        """Do what is due, without waiting; ``wanted``: whether the descriptor was readable."""


def collect_and_freeze(again: bool) -> None:
    """Take what was built for the start out of the collector's sight.

    Most of it lives until the end: modules, and their data. To look through all that takes longer than a tester
    waits for an answer, so it is done once. After a reload only what was built since is looked through, which is the
    new configuration and the one before it; of the first one stays what refers to itself.

    Args:
        again: after a reload.
    """
    gc.collect()
    if not again:
        gc.freeze()


class Live:
    """Feeds a gateway from its buses.

    Args:
        gateway: started already.
        links: its buses, in the order of their indices; started already.
        tell: takes the events of the buses.
        taps: take each frame exactly as the engine gets it, but for the stamp, and what is sent.
        clock: the engine's, the same as that of the links.
        tick_s: longest wait without traffic while something else than time is waited for [s]; 0: never wait.
        monotonic: for periodic work [s].
        settle: called when everything is built (False), and in the turn after it was replaced (True).
        door: for watchers; None: there are none.
    """

    def __init__(
        self,
        gateway: Fed,
        links: Sequence[Link],
        tell: Callable[[dict[str, Any]], None],
        *,
        taps: Sequence[Tap] = (),
        clock: Clock,
        tick_s: float = TICK_S,
        monotonic: Callable[[], float] = time.monotonic,
        settle: Callable[[bool], None] = collect_and_freeze,
        door: Door | None = None,
    ) -> None:
        self._settle, self._door = settle, door
        self._knocked = False
        self._gateway = gateway
        self._links = list(links)
        self._tell = tell
        self._taps = list(taps)
        self._clock, self._tick_s, self._monotonic = clock, tick_s, monotonic
        self._offset_ns = clock.told_offset_ns  # of what the taps have got
        self._selector = selectors.DefaultSelector()
        self._watched: dict[int, Link | None] = {}
        self._merger = Merger()
        self._pump: Pump | None = None
        self._told = {id(link): (0, 0.0) for link in links}  # overflow, when
        self._poll = self._keep = 0.0
        self._held: dict[int, list[Frames]] = {}  # taken from links, and not fed
        self._choose()
        self._unsettled = False
        self._settle(False)

    @property
    def links(self) -> Sequence[Link]:
        """Its buses, in the order of their indices."""
        return self._links

    def replace(self, gateway: Fed, links: Sequence[Link], taps: Sequence[Tap]) -> None:
        """Feed another gateway from now on; no frame is lost between the two."""
        self._gateway = gateway
        self._links, self._taps = list(links), list(taps)
        self._offset_ns = self._clock.told_offset_ns
        self._told = {id(link): self._told.get(id(link), (0, 0.0)) for link in links}
        self._held = {id(link): self._held[id(link)] for link in links if id(link) in self._held}
        self._choose()
        self._unsettled = True

    def _choose(self) -> None:
        """Say which frames are wanted: a tap wants all there are. Have a pump for this gateway, if it can have one."""
        engine = self._gateway.engine
        self._pump = None
        if engine is not None and engine.cells is not None and self._clock.of_system and self._links:
            self._pump = Pump(engine, engine.cells, len(self._links))
        for link in self._links:
            ids = None if self._taps else self._gateway.identifiers_on(link.index)
            link.listen_to(ids, echo=bool(self._taps))

    def close(self) -> None:
        """Stop waiting for buses; they stay open."""
        self._selector.close()

    def run(self, stop: Callable[[], bool], *, on_turn: Callable[[], None] | None = None) -> None:
        """Feed the gateway until told to stop.

        Args:
            stop: asked after every turn.
            on_turn: called once a turn.
        """
        before_s = sys.getswitchinterval()
        sys.setswitchinterval(SWITCH_S)
        try:
            while not stop():
                self.turn()
                if on_turn is not None:
                    on_turn()
        finally:
            sys.setswitchinterval(before_s)

    def turn(self) -> None:
        """Wait for frames or for time to pass, and do what is due."""
        for link in self._links:
            if link.due_s <= 0.001:
                link.attend()
        self._watch()
        left = self._pumped()
        busy = self._wait() if left is None else left.why not in (pumping.TIME, pumping.DOOR)
        fed = left is not None and self._finish_pass(left)
        if left is None or left.why == pumping.BUS:
            fed |= self._read_one(self._links[0]) if len(self._links) == 1 else self._read_all()
        if not fed and not busy:
            # Only now: frames that still wait in a queue must not be overtaken. With traffic,
            # its own time stamps move the clock.
            self._send(self._gateway.advance(self._clock.now() - GRACE_NS))
        self._send(self._gateway.poll(self._clock.now()))
        if self._unsettled:  # requests that waited during a reload have been answered
            self._unsettled = False
            self._settle(True)
        now = self._monotonic()
        if self._door is not None:
            self._door.turn(now, wanted=self._knocked)
        if now >= self._poll:
            self._gateway.serve_requests()
            self._report(now)
            self._poll = now + POLL_S

    def _pumped(self) -> Left | None:
        """Feed the gateway without Python while nothing waits; None: something does, or a bus is no socket."""
        if self._pump is None or self._held or self._unsettled or self._clock.untold:
            return None
        quiet = self._gateway.quiet()
        buses = [bus for link in self._links if (bus := link.pumped) is not None]
        if quiet is None or len(buses) < len(self._links) or len(self._merger) > HELD:
            return None
        watched = self._door is not None and self._door.listening()
        patience_s = min(self._tick_s if watched else POLL_S, max(self._poll - self._monotonic(), 0.0))
        return self._pump.run(
            buses,
            -1 if self._door is None else self._door.fileno(),
            self._clock,
            quiet,
            self._merger,
            leave_ns=self._clock.now() + round(patience_s * 1e9),
            grace_ns=GRACE_NS,
            waits=bool(self._tick_s),
            may_send=not (watched or self._taps),
        )

    def _finish_pass(self, left: Left) -> bool:
        """Do what a pump has left to Python; returns whether there were frames."""
        self._knocked = left.knocked
        if len(left.taken):
            self._take_down(left.taken)
            self._gateway.took(left.taken)
            self._send(self._gateway.tell())
        if left.raw:
            parts = [link.take(*each) for link, each in zip(self._links, left.raw, strict=True)]
            frames = self._with_steps(parts[0][0]) if len(parts) == 1 else self._joined(parts, left.read_ns)
            if len(frames):
                self._feed(frames)
            return True
        for link in self._links:
            link.stamps.looked(left.read_ns)
        if left.start >= 0:
            self._send(self._gateway.resume(left.batch, left.start))
        elif len(left.batch):
            self._feed(left.batch)
        return bool(len(left.taken) or len(left.batch))

    def _watch(self) -> None:
        """Wait for the descriptors that the links have now: a bus that came back has a new one."""
        wanted: dict[int, Link | None] = {fd: link for link in self._links if (fd := link.fileno()) is not None}
        if self._door is not None:
            wanted[self._door.fileno()] = None
        if wanted == self._watched:
            return
        # A descriptor may have been closed, and its number given out again: all are registered again.
        self._selector.close()
        self._selector = selectors.DefaultSelector()
        for fd in wanted:
            self._selector.register(fd, selectors.EVENT_READ)
        self._watched = wanted

    def _wait(self) -> bool:
        """Wait until there is something to do; returns whether a bus is readable."""
        now = self._clock.now()
        soon = (self._gateway.next_ns - now) / 1e9
        waits = [self._patience_s(now), soon, *(link.due_s for link in self._links)]
        if self._merger.holding:
            waits.append(0.0005)
        if self._held:
            waits.append(0.0)
        ready = self._selector.select(max(min(waits), 0.0))
        if self._door is None:
            return bool(ready)
        door = self._door.fileno()
        buses = sum(key.fd != door for key, _ in ready)
        self._knocked = buses < len(ready)
        return bool(buses)

    def _patience_s(self, now_ns: int) -> float:
        """Return how long only the buses and their answers need the loop [s].

        A turn for nothing costs half a millisecond on a slow processor: not the next tick is waited for, but the next
        timer.
        """
        if not self._tick_s or (self._door is not None and self._door.listening()):
            return self._tick_s
        due_s = (self._gateway.due_ns + GRACE_NS - now_ns) / 1e9
        return min(max(due_s, self._tick_s), POLL_S)

    def _read_one(self, link: Link) -> bool:
        """Feed what one bus has, without holding anything back; returns whether there was any."""
        any_fed = False
        for _ in range(TURN):
            frames, more = self._receive(link)
            frames = self._with_steps(frames)
            if len(frames):
                self._feed(frames)
                any_fed = True
            if not more:
                break
        return any_fed

    def _take_steps(self, *, final: bool = False) -> Frames:
        """Return a frame for each step of the wall clock whose place among the frames is known.

        That is before the first frame that was stamped after it; if there is none yet, after all that had come when it
        was noticed.
        """
        untold = self._clock.untold
        told = [empty(0)]
        drained = final or all(link.stamps.drained for link in self._links)
        while untold and (untold[0].seen or drained):
            step = untold.pop(0)
            told.append(step_frame(step.t_ns, step.step_ns // 1000))
        return np.concatenate(told)

    def _with_steps(self, frames: Frames) -> Frames:
        for step in self._take_steps() if self._clock.untold else ():
            later = np.flatnonzero(frames["t_ns"] >= step["t_ns"])
            at = int(later[0]) if len(later) else len(frames)
            told = np.asarray([step], frames.dtype)
            frames = np.concatenate([frames[:at], told, frames[at:]])
        return frames

    def _receive(self, link: Link) -> tuple[Frames, bool]:
        """Return the next frames of a link, first those that are held."""
        held = self._held.pop(id(link), None)
        if held is None:
            return link.receive()
        frames = np.concatenate(held)
        frames["bus"] = link.index  # it may have changed since
        return frames, True

    def hold(self) -> None:
        """Take received frames, to be fed after a reload; testers' requests are answered by 0x78 (wait)."""
        for link in self._links:
            for _ in range(LAST_TURN):
                frames, more = link.receive()
                if len(frames):
                    self._held.setdefault(id(link), []).append(frames.copy())
                    self._send(self._gateway.promise(frames, self._clock.now()))
                if not more:
                    break

    def drain(self) -> None:
        """Feed all that has come until now; nothing is held back."""
        self._read_all(final=True)

    def finish(self) -> None:
        """Let the gateway put down what its successor is to find; nothing must be fed to it any more."""
        self._send(self._gateway.finish(self._clock.now()))

    def _read_all(self, *, final: bool = False) -> bool:
        """Feed what several buses have, in order of time; returns whether there was any."""
        read_ns = self._clock.now()
        parts: list[tuple[Frames, bool]] = []
        for link in self._links:
            pieces: list[Frames] = []
            more = True
            while more and len(pieces) < (LAST_TURN if final else TURN):
                frames, more = self._receive(link)
                pieces.append(frames.copy())
            parts.append((np.concatenate(pieces), more))
        frames = self._joined(parts, read_ns, final=final)
        if len(frames):
            self._feed(frames)
        return bool(len(frames))

    def _joined(self, parts: list[tuple[Frames, bool]], read_ns: int, *, final: bool = False) -> Frames:
        """Return what is due of what several buses gave, in order of time, with steps of the wall clock among it."""
        if self._clock.untold:
            parts.insert(0, (self._take_steps(final=final), False))
        return self._merger.take(parts, read_ns, final=final)

    def _take_down(self, frames: Frames) -> Frames:
        """Give frames to those who read them, and return those that did not come from here."""
        if self._taps:
            stamped, self._offset_ns = to_wall(frames, self._offset_ns)
            for tap in self._taps:
                tap.write(stamped)
            # Only taps take the frames that we have sent and that came back.
            frames = frames[frames["flags"] & OWN == 0]
        if self._door is not None:
            self._door.on_frames(frames)
        return frames

    def _feed(self, frames: Frames) -> None:
        frames = self._take_down(frames)
        self._note(frames)
        self._send(self._gateway.feed(frames))

    def _note(self, frames: Frames) -> None:
        """Tell when a bus went or came back."""
        conditions = frames[frames["can_id"] == ERROR]  # an error frame of no class
        for frame in conditions:
            state = {RUNNING: "open", LOST: "lost"}.get(int(frame["data"][0]))
            if state is not None:
                link = self._links[int(frame["bus"])]
                t_ns = int(frame["t_ns"]) + self._clock.offset_ns
                self._tell(bus_event(link, state, t_ns))
                self._keep = 0.0  # at the next look

    def _send(self, frames: Frames) -> None:
        if not len(frames):
            return
        for link in self._links:
            mine = frames if len(self._links) == 1 else frames[frames["bus"] == link.index]
            if not len(mine):
                continue
            link.send(mine)
            if self._door is not None and link.running:
                stamped = mine.copy()
                stamped["t_ns"] = self._clock.now()
                self._door.on_frames(stamped)
            if self._taps and link.running and not link.echoes:
                # It is unknown when they were on the bus: taken down as they leave.
                sent = mine.copy()
                sent["flags"] |= OWN
                sent["rank"] = 0
                sent["t_ns"] = self._clock.now() + self._offset_ns
                for tap in self._taps:
                    tap.write(sent)

    def _report(self, now: float) -> None:
        """Tell of frames that were lost in queues, once a second at most."""
        changed = False
        for link in self._links:
            overflow = link.statistics.overflow
            told, when = self._told[id(link)]
            if overflow > told and now - when >= REPORT_S:
                log.warning("frames lost in a queue", bus=link.name, lost=overflow - told)
                self._told[id(link)] = (overflow, now)
                self._tell(bus_event(link, "overflow", self._clock.wall()))
                changed = True
        if changed or now >= self._keep:
            self.keep()

    def keep(self) -> None:
        """Keep the state of the buses where other processes see it."""
        self._keep = self._monotonic() + KEEP_S
        self._gateway.note_buses(self.bus_states())

    def bus_states(self) -> list[dict[str, Any]]:
        """Return how the buses do, as events of the JSON contract."""
        return [bus_event(link, "open" if link.running else "lost", self._clock.wall()) for link in self._links]


def bus_event(link: Link, state: str, t_ns: int) -> dict[str, Any]:
    """Return the event of the JSON contract that tells the state of a bus at a time of the wall clock."""
    return {
        "event": "bus",
        "t_ns": t_ns,
        "bus": link.name,
        "uri": link.uri,
        "state": state,
        **asdict(link.statistics),
        "unsent": link.unsent,
        "losses": link.losses,
        "reason": link.reason,
    }
