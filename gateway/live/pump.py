"""The pump as the live loop sees it: it is entered while nothing waits, and says why it has left.

Its memory and what it is told are here, its work is the kernel :func:`gateway.live.pumping.pump`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gateway.bus.base import Bus
from gateway.bus.can_structs import Room
from gateway.bus.frames import EXTENDED, FRAME, Frames, empty
from gateway.common.times import NEVER
from gateway.engine.core import Engine
from gateway.live import pumping
from gateway.live.clock import Clock
from gateway.live.merge import Merger
from gateway.runtime.passage import Quiet
from gateway_fdi.jit import Bound, bound

#: Frames taken of a socket at one call.
BATCH = 256
#: Frames that it takes down before Python must read them; those that it holds back.
TAKEN, HELD = 16_384, 2_048
_CELLS = FRAME.itemsize // 8


@dataclass(frozen=True)
class Left:
    """Work of a pump, and why it has left.

    Attributes:
        why: one of the reasons of :mod:`gateway.live.pumping`.
        taken: frames that it has fed, in order, on the engine's time; valid until it is entered again, as the others.
        raw: of each bus: frames as its socket gave them, not fed; and whether there may be more.
        batch: frames on the engine's time, in order; of these the engine has handled those before ``start``.
        start: -1: the batch was not taken down, and not fed.
        read_ns: when the sockets were looked at last.
        knocked: whether the other descriptor was readable.
    """

    why: int
    taken: Frames
    raw: tuple[tuple[Frames, bool], ...]
    batch: Frames
    start: int
    read_ns: int
    knocked: bool


def _of(frames: Frames) -> np.ndarray:
    """Return the same memory in cells."""
    return frames.view(np.uint64).reshape(*frames.shape, _CELLS)


class Pump:
    """Feeds an engine from sockets without Python.

    Args:
        engine: warm.
        cells: of its loop.
        buses: how many.

    Attributes:
        engine: that it feeds.
        memory: of its kernel.
    """

    def __init__(self, engine: Engine, cells: Bound, buses: int) -> None:
        self.engine = engine
        self._buses = buses
        self._room = Room(buses, BATCH)
        self._frames = np.zeros((buses, BATCH), FRAME)
        self._room.receive_into(self._frames)
        self._merged, self._held, self._taken = empty(HELD + buses * BATCH), empty(HELD), empty(TAKEN)
        self._since, self._held_since = np.zeros(len(self._merged), np.int64), np.zeros(HELD, np.int64)
        self._state, self._sides = np.zeros(1, pumping.State.dtype), np.zeros(buses, pumping.Side.dtype)
        self._sides["headers"] = [self._room.headers(k) for k in range(buses)]
        self._polls = np.zeros(buses + 1, np.int64)
        self._heard: frozenset[int] | None = None
        self._flags = np.zeros(2048, np.uint8)
        self._cells = cells
        state = self._state[0]
        (frames, same), (start, _), (until, _) = cells.places
        state["entry"] = cells.address
        state["arguments_at"], state["results_at"] = cells.arguments.ctypes.data, cells.results.ctypes.data
        state["frames_at"], state["cells_at"], state["start_at"], state["until_at"] = frames, same[0], start, until
        state["never"] = NEVER
        for name, place in engine.clock_places.items():
            state[f"{name}_at"] = place
        self._connect(frozenset())

    def _connect(self, heard: frozenset[int]) -> None:
        """Bind the kernel to its memory; the identifiers of 29 bits that servers want are of another length."""
        self._heard = heard
        self._flags[:] = 0
        self._flags[[can_id & 0x7FF for can_id in heard if not can_id & EXTENDED]] = 1
        extended = np.asarray([can_id for can_id in heard if can_id & EXTENDED] or [-1], np.int64)
        room = self._room
        self.memory = pumping.Pumped(
            self._state, self._sides, self._polls, room.messages, room.control, room.gaps, self._frames,
            _of(self._frames), _of(self._merged), self._since, _of(self._held), self._held_since, _of(self._taken),
            self._cells.arguments, self._cells.results, self.engine.clock_cells,
            _of(np.asarray(self.engine.tables.outbox)), np.zeros(9, np.uint64), self._flags, extended,
        )  # fmt: skip
        self._pump = bound(pumping.pump, self.memory, rest=())

    def run(
        self,
        buses: Sequence[Bus],
        door: int,
        clock: Clock,
        quiet: Quiet,
        merger: Merger,
        *,
        leave_ns: int,
        grace_ns: int,
        waits: bool,
        may_send: bool,
    ) -> Left:
        """Feed the engine until there is something that only Python can do.

        Args:
            buses: in the order of their indices; each has a ``raw`` receiver.
            door: another descriptor that ends it when it is readable; -1: there is none.
            clock: the engine's.
            quiet: the gateway.
            merger: what it holds back is taken over, and given back.
            leave_ns: when to leave at the latest.
            grace_ns: time that the engine's timers lag the clock without traffic.
            waits: whether it may wait.
            may_send: whether it may send what monitors send, which nobody takes down then.
        """
        if quiet.heard != self._heard:
            self._connect(quiet.heard)
        state = self._state[0]
        state["offset_ns"], state["difference_ns"] = clock.offset_ns, clock.difference_ns
        state["tolerance_ns"] = clock.tolerance_ns
        state["leave_ns"], state["grace_ns"], state["waits"] = leave_ns, grace_ns, waits
        state["before_ns"], state["server_ns"], state["prompt_ns"] = quiet.before_ns, quiet.due_ns, quiet.prompt_ns
        state["may_send"] = may_send and quiet.may_send
        held, since = merger.release()
        state["held"] = len(held)
        self._held[: len(held)], self._held_since[: len(held)] = held, since
        for k, bus in enumerate(buses):
            raw = bus.raw
            assert raw is not None, "a pump takes the place of a receiver"
            self._sides[k]["fd"], self._sides[k]["lost"] = raw.fileno(), raw.lost
            self._polls[k] = raw.fileno()
        self._polls[self._buses] = door & 0xFFFFFFFF
        why = int(self._pump())
        self._count(buses, why)
        count = int(state["held"])
        merger.hold(self._held[:count].copy(), self._held_since[:count].copy())
        return self._left(why)

    def _count(self, buses: Sequence[Bus], why: int) -> None:
        for k, bus in enumerate(buses):
            side, raw = self._sides[k], bus.raw
            if raw is None:
                continue
            gaps = int(side["gaps"]) if why in (pumping.RAW, pumping.STEPPED) else 0
            raw.lost = int(side["lost"])
            raw.note(int(side["received"]), int(side["rejected"]), self._room.gaps[k, :gaps])
            bus.statistics.sent += int(side["sent"])

    def _left(self, why: int) -> Left:
        state = self._state[0]
        count, start = int(state["count"]), int(state["start"])
        raw: tuple[tuple[Frames, bool], ...] = ()
        batch = empty(0)
        if why in (pumping.RAW, pumping.STEPPED):
            counts = self._sides["count"].tolist()
            raw = tuple((self._frames[k, :n], n == BATCH) for k, n in enumerate(counts))
        elif why >= pumping.WANTED:
            batch = (self._frames[0] if self._buses == 1 else self._merged)[:count]
        begun = why >= pumping.EVENTS
        taken = self._taken[: int(state["took"])]
        at, knocked = int(state["read_ns"]), bool(state["knocked"])
        return Left(why, taken, raw, batch, start if begun else -1, at, knocked)
