"""The live loop: buses are readable, time passes, frames leave."""

from __future__ import annotations

import gc
import math
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

import numpy as np

from gateway.bus.conditions import LOST, RUNNING, step_frame
from gateway.bus.frames import ERROR, OWN, Frames, empty
from gateway.bus.timeline import to_wall
from gateway.common.fence import Fence
from gateway.engine.core import Engine
from gateway.faults.journal_steps import Journalled
from gateway.host.slice import short_slices
from gateway.live import fast_path_kernel
from gateway.live.clock import Clock
from gateway.live.fast_path import FastPath, Left
from gateway.live.link import Link, bus_event
from gateway.runtime.fast_path_conditions import FastPathConditions
from gateway.servers.prepared_frames_kernel import PreparedTables
from gateway_fdi.common.log import get_logger
from gateway_fdi.errors import GatewayError

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
#: Batches taken from a bus when there is no next turn: more than any queue holds.
LAST_TURN = 4096
#: Turns in a row that may fail before the loop gives up: a new process may do better. Wait after one of them [s].
MOST_FAILURES, REST_S = 50, 0.02

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

    def feed(self, frames: Frames) -> Frames:
        """Take a batch; returns the frames to send."""

    def advance(self, t_ns: int) -> Frames:
        """Let time pass; returns the frames to send."""

    def poll(self, t_ns: int) -> Frames:
        """Let time pass for answers; returns the frames to send."""

    def identifiers_on(self, bus: int) -> list[int] | None:
        """Return what it listens to; None: to all."""

    def quiet(self) -> FastPathConditions:
        """Return what a pump must know to feed its engine."""

    def took(self, frames: Frames) -> None:
        """Take down frames that a pump has fed."""

    def take_overtimes(self) -> Frames:
        """Return frames for recordings, of monitors whose step took too long."""

    @property
    def foreseen(self) -> PreparedTables | None:
        """Tables of which a pump makes DTC frames; None: there are none."""

    @property
    def journal(self) -> Journalled:
        """Memory of the journal that takes verdicts."""

    def deliver(self, gone: Frames) -> Frames:
        """Take what the engine has to tell where a pump has left; returns the frames to send, without those gone."""

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
    """
    gc.collect()
    if not again:
        gc.freeze()


class Live:
    """Feeds a gateway from its buses.

    Args:
        gateway: started already.
        links: its buses, in the order of their indices; started already.
        report: takes the events of the buses.
        taps: take each frame exactly as the engine gets it, but for the stamp, and what is sent.
        clock: the engine's, the same as that of the links.
        tick_s: longest wait without traffic while something else than time is waited for [s]; 0: never wait.
        monotonic: for periodic work [s].
        settle: called when everything is built (False), and in the turn after it was replaced (True).
        door: for watchers; None: there are none.
        fence: counts exceptions that reach the loop.
    """

    def __init__(
        self,
        gateway: Fed,
        links: Sequence[Link],
        report: Callable[[dict[str, Any]], None],
        *,
        taps: Sequence[Tap] = (),
        clock: Clock,
        tick_s: float = TICK_S,
        monotonic: Callable[[], float] = time.monotonic,
        settle: Callable[[bool], None] = collect_and_freeze,
        door: Door | None = None,
        fence: Fence | None = None,
    ) -> None:
        self._settle, self._door = settle, door
        self._fence, self._failures = fence or Fence(), 0
        self._knocked = False
        self._gateway = gateway
        self._links = list(links)
        self._report_event = report
        self._taps = list(taps)
        self._clock, self._tick_s, self._monotonic = clock, tick_s, monotonic
        self._offset_ns = clock.reported_offset_ns  # of what the taps have got
        self._more = True  # whether there may be frames that no descriptor tells
        self._told = {id(link): (0, 0, 0.0) for link in links}  # overflow, exceptions of the driver, when
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
        self._offset_ns = self._clock.reported_offset_ns
        self._told = {id(link): self._told.get(id(link), (0, 0, 0.0)) for link in links}
        self._held = {id(link): self._held[id(link)] for link in links if id(link) in self._held}
        self._choose()
        self._unsettled = True

    def _choose(self) -> None:
        """Say which frames are wanted: a tap wants all there are. Have a pump for this gateway."""
        self._pump = FastPath(self._gateway.engine, len(self._links), self._gateway.foreseen, self._gateway.journal)
        for link in self._links:
            ids = None if self._taps else self._gateway.identifiers_on(link.index)
            link.listen_to(ids, echo=bool(self._taps))

    def run(self, stop: Callable[[], bool], *, on_turn: Callable[[], None] | None = None) -> None:
        """Feed the gateway until told to stop.

        Args:
            stop: asked after every turn.
            on_turn: called once a turn.
        """
        before_s = sys.getswitchinterval()
        sys.setswitchinterval(SWITCH_S)
        try:
            with short_slices():
                while not stop():
                    try:
                        self.turn()
                    except GatewayError:
                        raise
                    except Exception as error:
                        self._go_on_after(error)
                    else:
                        self._failures = 0
                    if on_turn is not None:
                        on_turn()
        finally:
            sys.setswitchinterval(before_s)

    def _go_on_after(self, error: Exception) -> None:
        """Go on after a turn that failed: the second wall. Raises it again where nothing is served any more."""
        self._fence.note("loop", error, second=True)
        self._failures += 1
        if self._failures >= MOST_FAILURES:
            raise error
        self._more = True  # frames may wait that no descriptor tells
        time.sleep(REST_S if self._tick_s else 0.0)

    def turn(self) -> None:
        """Wait for frames or for time to pass, and do what is due."""
        due_s = min((link.due_s for link in self._links), default=math.inf)
        if due_s <= 0.001:
            for link in self._links:
                link.attend()
        fed = busy = False
        self._knocked = read = True
        if not (self._more or self._held or self._clock.untold or due_s <= 0):
            left = self._pumped(due_s)
            idle, self._knocked = left.why in (fast_path_kernel.TIME, fast_path_kernel.DOOR), left.knocked
            # Before time passes for the monitors: a frame that nobody has told of must not be overtaken.
            read = left.why == fast_path_kernel.BUS or (idle and any(link.pumped is None for link in self._links))
            busy, fed = not idle, self._finish_pass(left)
        if read:
            fed |= self._read()
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

    def _pumped(self, due_s: float) -> Left:
        """Have the pump wait, receive and feed until it has something for Python; ``due_s``: when a link is due."""
        quiet = self._gateway.quiet()
        watched = self._door is not None and self._door.listening()
        patience_s = self._tick_s if watched or not quiet.idle else POLL_S
        patience_s = max(min(patience_s, due_s, self._poll - self._monotonic()), 0.0)
        return self._pump.run(
            [(link.fileno(), link.pumped) for link in self._links],
            -1 if self._door is None else self._door.fileno(),
            self._clock,
            quiet,
            leave_ns=self._clock.now() + round(patience_s * 1e9),
            grace_ns=GRACE_NS,
            waits=bool(self._tick_s),
            may_send=not (watched or self._taps),
        )

    def _finish_pass(self, left: Left) -> bool:
        """Do what a pump has left to Python; returns whether there were frames."""
        if len(left.taken):
            self._take_down(left.taken)
            self._gateway.took(left.taken)
            for link, mine in self._by_link(left.told):
                self._show(link, mine)
            self._send(self._gateway.deliver(left.told))
            self._take_overtimes_down()
        links = list(zip(self._links, left.received, strict=True)) if left.received else []
        if left.raw:
            took = zip(links, left.raw, strict=True)
            parts = [link.take(*raw) if received else self._receive(link) for (link, received), raw in took]
            self._hand_in(parts, left.read_ns)
            return True
        for link, received in links:
            if received:
                link.stamps.looked(left.read_ns)
        if left.start >= 0:
            self._send(self._gateway.resume(left.batch, left.start))
        elif len(left.batch):
            self._feed(left.batch)
        return bool(len(left.taken) or len(left.batch))

    def _read(self, *, final: bool = False) -> bool:
        """Receive from all buses, and feed what is due; returns whether there was anything."""
        read_ns = self._clock.now()
        far = self._pump.is_far_ahead
        parts = [(empty(0), True) if far(k) else self._receive(link) for k, link in enumerate(self._links)]
        return self._hand_in(parts, read_ns, final=final)

    def _hand_in(self, parts: Sequence[tuple[Frames, bool]], read_ns: int, *, final: bool = False) -> bool:
        """Feed what links gave, with steps of the wall clock among it; returns whether there was anything due."""
        self._more = any(more for _, more in parts)
        if not (self._pump.holding or self._clock.untold or any(len(frames) for frames, _ in parts)):
            return False
        steps = self._take_steps(final=final) if self._clock.untold else empty(0)
        return self._finish_pass(self._pump.hand_in(parts, steps, read_ns, self._gateway.quiet(), final=final))

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

    def _receive(self, link: Link) -> tuple[Frames, bool]:
        """Return the next frames of a link, first those that are held."""
        held = self._held.get(id(link))
        if not held:
            return link.receive()
        frames = held.pop(0)
        if not held:
            del self._held[id(link)]
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
        for _ in range(LAST_TURN):
            self._read(final=True)
            if not (self._more or self._pump.holding):
                break

    def finish(self) -> None:
        """Let the gateway put down what its successor is to find; nothing must be fed to it any more."""
        self._send(self._gateway.finish(self._clock.now()))

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
        self._take_overtimes_down()

    def _take_overtimes_down(self) -> None:
        """Have recordings say which monitors' steps took too long: a replay has them off from there on."""
        if self._taps and len(late := self._gateway.take_overtimes()):
            for tap in self._taps:
                tap.write(late)

    def _note(self, frames: Frames) -> None:
        """Tell when a bus went or came back."""
        conditions = frames[frames["can_id"] == ERROR]  # an error frame of no class
        for frame in conditions:
            state = {RUNNING: "open", LOST: "lost"}.get(int(frame["data"][0]))
            if state is not None:
                link = self._links[int(frame["bus"])]
                t_ns = int(frame["t_ns"]) + self._clock.offset_ns
                self._report_event(bus_event(link, state, t_ns))
                self._keep = 0.0  # at the next look

    def _send(self, frames: Frames) -> None:
        for link, mine in self._by_link(frames):
            link.send(mine)
            if link.running:
                self._show(link, mine)

    def _by_link(self, frames: Frames) -> list[tuple[Link, Frames]]:
        if not len(frames):
            return []
        if len(self._links) == 1:
            return [(self._links[0], frames)]
        parts = [(link, frames[frames["bus"] == link.index]) for link in self._links]
        return [(link, mine) for link, mine in parts if len(mine)]

    def _show(self, link: Link, frames: Frames) -> None:
        """Show what goes to a bus to those who watch, or take down."""
        if self._door is not None:
            stamped = frames.copy()
            stamped["t_ns"] = self._clock.now()
            self._door.on_frames(stamped)
        if self._taps and not link.echoes:
            # It is unknown when they were on the bus: taken down as they leave.
            sent = frames.copy()
            sent["flags"] |= OWN
            sent["rank"] = 0
            sent["t_ns"] = self._clock.now() + self._offset_ns
            for tap in self._taps:
                tap.write(sent)

    def _report(self, now: float) -> None:
        """Tell of frames that were lost in queues, and of exceptions of a driver, once a second at most."""
        changed = False
        for link in self._links:
            found = link.statistics
            told, failed, when = self._told[id(link)]
            if now - when < REPORT_S or (found.overflow <= told and found.driver_errors <= failed):
                continue
            self._told[id(link)] = (found.overflow, found.driver_errors, now)
            if found.overflow > told:
                log.warning("frames lost in a queue", bus=link.name, lost=found.overflow - told)
                self._report_event(bus_event(link, "overflow", self._clock.wall()))
            else:
                self._report_event(bus_event(link, "failing", self._clock.wall()))
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
