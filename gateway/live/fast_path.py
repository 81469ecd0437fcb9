"""The pump as the live loop sees it: all frames go through it, and it says why it has left.

Its memory and what it is told are here, its work is the kernel :func:`gateway.live.fast_path_kernel.pump`.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from gateway.bus.base import Bus, Raw
from gateway.bus.can_structs import Room
from gateway.bus.frames import EXTENDED, FRAME, Frames, empty
from gateway.bus.id_filter import NOTHING, IdFilter
from gateway.common.times import NEVER
from gateway.engine.core import Engine
from gateway.engine.events import EVENT
from gateway.engine.tables import table
from gateway.faults.journal import NO_JOURNAL
from gateway.faults.journal_steps import Journalled
from gateway.host.sockets import CAN
from gateway.host.waiting import NONE, readable
from gateway.live import fast_path_kernel
from gateway.live.clock import Clock
from gateway.runtime.fast_path_conditions import EVERYTHING, FastPathConditions
from gateway.servers.prepared_frames_kernel import PreparedTables, prepared_tables
from gateway_fdi.jit import bound

#: Frames taken of a socket at one call; those that are handed in of a bus, with its conditions among them.
BATCH, ROW = 256, 1024
#: Frames that it takes down before Python must read them; those that it holds back.
TAKEN, HELD = 16_384, 2_048
_CELLS = FRAME.itemsize // 8


def _places(kind: Any) -> dict[str, int]:
    return {name: field[1] // 8 for name, field in kind.dtype.fields.items()}


#: Places of fields in records of cells: a record and its field take ten times as long to reach, for each turn.
_ORDER, _SIDE = _places(fast_path_kernel.State), _places(fast_path_kernel.Side)
_NONE = empty(0)


@dataclass(frozen=True)
class Left:
    """Work of a pump, and why it has left.

    Attributes:
        why: one of the reasons of :mod:`gateway.live.fast_path_kernel`.
        taken: frames that it has fed, in order, on the engine's time; valid until it is entered again, as the others.
        received: of each bus whether it received; empty: it looked at none.
        told: DTC frames of the events that it has sent.
        raw: of each bus: frames as its socket gave them, not fed; and whether there may be more.
        batch: frames on the engine's time, in order; of these the engine has handled those before ``start``.
        start: -1: the batch was not taken down, and not fed.
        read_ns: when the sockets were looked at last.
        knocked: whether the other descriptor was readable.
    """

    why: int
    taken: Frames
    received: tuple[bool, ...]
    told: Frames
    raw: tuple[tuple[Frames, bool], ...]
    batch: Frames
    start: int
    read_ns: int
    knocked: bool


def _of(frames: Frames) -> np.ndarray:
    """Return the same memory in cells."""
    return frames.view(np.uint64).reshape(*frames.shape, _CELLS)


class FastPath:
    """Feeds an engine from the buses.

    Args:
        engine: warm; None: there is none, and all frames are given back.
        buses: how many.
        foreseen: of the DTC frames; None: there are none.
        journal: takes verdicts where they are told when they are on the disk.

    Attributes:
        memory: of its kernel.
    """

    def __init__(
        self,
        engine: Engine | None,
        buses: int,
        foreseen: PreparedTables | None = None,
        journal: Journalled = NO_JOURNAL,
    ) -> None:
        self._buses = buses
        self._room = Room(buses, BATCH)
        self._frames = np.zeros((buses + 1, ROW), FRAME)
        self._room.receive_into(self._frames)
        most = HELD + (buses + 1) * ROW
        self._merged, self._held, self._taken = empty(most), empty(HELD), empty(max(TAKEN, most))
        self._since, self._held_since = np.zeros(most, np.int64), np.zeros(HELD, np.int64)
        state: Any = np.zeros(1, fast_path_kernel.State.dtype)
        sides: Any = np.zeros(buses + 1, fast_path_kernel.Side.dtype)
        sides["headers"][:buses] = [self._room.headers(k) for k in range(buses)]
        sides["fd"] = -1
        self._orders = memoryview(state.view(np.int64))
        self._sides = [memoryview(side.view(np.int64)) for side in sides.reshape(-1, 1)]
        self._records = state.view(np.recarray), sides.view(np.recarray)
        self._polls = np.zeros(buses + 1, np.int64)
        self._heard: IdFilter | None = None
        self._flags = np.zeros(2048, np.uint8)
        self._engine, self._cells = engine, None if engine is None else engine.cells
        state["never"] = NEVER
        if self._cells is not None:
            cells = self._cells
            (frames, same), (start, _), (until, _) = cells.places
            state["entry"] = cells.address
            state["arguments_at"], state["results_at"] = cells.arguments.ctypes.data, cells.results.ctypes.data
            state["frames_at"], state["cells_at"], state["start_at"], state["until_at"] = frames, same[0], start, until
        for name, place in {} if engine is None else engine.clock_places.items():
            state[f"{name}_at"] = place
        self._merged_at = self._merged.ctypes.data
        self._foreseen = prepared_tables(None, 0, 0) if foreseen is None else foreseen
        self._journal, self._journal_sent = journal, int(journal.state[0]["sent"])
        self._told = self._foreseen.frames.view(FRAME).reshape(-1)
        self._connect(NOTHING)

    def _connect(self, heard: IdFilter) -> None:
        """Bind the kernel to its memory; the identifiers of 29 bits that servers want are of another length."""
        self._heard = heard
        self._flags[:] = 0
        self._flags[[can_id & 0x7FF for can_id in heard.identifiers if not can_id & EXTENDED]] = 1
        extended = [(can_id, 0xFFFFFFFF) for can_id in heard.identifiers if can_id & EXTENDED]
        room, cells, nothing = self._room, self._cells, np.zeros(1, np.int64)
        clock, outbox, events = np.full(1, NEVER, np.int64), empty(1), table(1, EVENT)
        if self._engine is not None:
            clock, outbox = self._engine.clock_cells, np.asarray(self._engine.tables.outbox)
            events = self._engine.tables.ring
        self.memory = fast_path_kernel.Pumped(
            *self._records, self._polls, room.messages, room.control, room.gaps, self._frames,
            _of(self._frames), _of(self._merged), self._since, _of(self._held), self._held_since, _of(self._taken),
            nothing if cells is None else cells.arguments, nothing if cells is None else cells.results, clock,
            _of(outbox), np.zeros(9, np.uint64), self._flags,
            np.asarray([*extended, *heard.masks] or [(-1, 0)], np.int64), events, self._foreseen, self._journal,
        )  # fmt: skip
        self._pass_handed = bound(fast_path_kernel.pass_handed, self.memory, rest=())
        if CAN:
            self._pump = bound(fast_path_kernel.pump, self.memory, rest=())
        else:
            self._patience_ms = bound(fast_path_kernel.patience_ms, self.memory, rest=(0,))

    @property
    def holding(self) -> int:
        """Frames that are held back: an earlier one of another bus may still come."""
        return self._orders[_ORDER["held"]]

    def is_far_ahead(self, bus: int) -> bool:
        """Return whether a bus is not to be read now: enough of its frames wait for those of others."""
        return self._sides[bus][_SIDE["waiting"]] >= fast_path_kernel.MOST_WAITING

    def _order(self, **values: int) -> None:
        """Write fields of the state."""
        for name, value in values.items():
            self._orders[_ORDER[name]] = value

    def run(
        self,
        buses: Sequence[tuple[int | None, Bus | None]],
        door: int,
        clock: Clock,
        quiet: FastPathConditions,
        *,
        leave_ns: int,
        grace_ns: int,
        waits: bool,
        may_send: bool,
    ) -> Left:
        """Feed the engine until there is something that only Python can do.

        Args:
            buses: in the order of their indices: a descriptor to wait for, and the bus of whose ``raw`` receiver it is;
                None: Python receives from it.
            door: another descriptor that ends it when it is readable; -1: there is none.
            clock: the engine's.
            quiet: the gateway.
            leave_ns: when to leave at the latest.
            grace_ns: time that the engine's timers lag the clock without traffic.
            waits: whether it may wait.
            may_send: whether it may send what monitors send, which nobody takes down then.
        """
        offset_ns = clock.offset_ns
        if not clock.of_system:  # one that tests move: the system's tells only how long it waits
            offset_ns = time.time_ns() - clock.now()
        received: list[tuple[int, Bus, Raw]] = []
        for k, (fd, bus) in enumerate(buses):
            raw = None if bus is None or not clock.of_system else bus.raw
            self._polls[k] = (-1 if fd is None else fd) & 0xFFFFFFFF
            self._sides[k][_SIDE["fd"]] = -1
            if bus is not None and raw is not None:
                self._sides[k][_SIDE["fd"]], self._sides[k][_SIDE["lost"]] = raw.fileno(), raw.lost
                received.append((k, bus, raw))
        self._polls[self._buses] = door & 0xFFFFFFFF
        self._order(
            offset_ns=offset_ns, difference_ns=clock.difference_ns, tolerance_ns=clock.tolerance_ns,
            leave_ns=leave_ns, grace_ns=grace_ns, waits=waits, sockets=len(received), handed=0, final=0,
        )  # fmt: skip
        self._ask(quiet, may_send=may_send)
        if not CAN:
            return self._waited([NONE if fd is None else fd for fd, _ in buses], door, clock)
        why = int(self._pump())
        for k, bus, raw in received:
            side = self._sides[k]
            gaps = side[_SIDE["gaps"]] if why in (fast_path_kernel.RAW, fast_path_kernel.STEPPED) else 0
            raw.lost = side[_SIDE["lost"]]
            raw.note(side[_SIDE["received"]], side[_SIDE["rejected"]], self._room.gaps[k, :gaps])
            bus.statistics.sent += side[_SIDE["sent"]]
            if k == self._foreseen.head[0]["bus"]:
                before, self._journal_sent = self._journal_sent, int(self._journal.state[0]["sent"])
                bus.statistics.sent += self._journal_sent - before
        return self._left(why)

    def hand_in(
        self,
        parts: Sequence[tuple[Frames, bool]],
        steps: Frames,
        read_ns: int,
        quiet: FastPathConditions,
        *,
        final: bool = False,
    ) -> Left:
        """Feed the engine with frames that Python has received, and with those held back that are due then.

        Args:
            parts: of each bus: frames in order of time, on the engine's; and whether it may have more.
            steps: of the wall clock.
            read_ns: time right before the first bus was read [ns].
            quiet: the gateway.
            final: whether nothing is held back, but for frames of a bus that has more.
        """
        for k, (frames, more) in enumerate([*parts, (steps, False)]):
            side, count = self._sides[k], len(frames)
            assert count <= ROW, "a link gives a batch at a time"
            if count:
                mine, times = self._frames[k, :count], frames["t_ns"]
                rough = self._buses > 1 and (times[1:] < times[:-1]).any()
                _of(mine)[:] = _of(frames[np.argsort(times, kind="stable")] if rough else np.ascontiguousarray(frames))
                side[_SIDE["last_ns"]] = int(mine[-1]["t_ns"])
            side[_SIDE["count"]], side[_SIDE["more"]], side[_SIDE["fd"]] = count, more, -1
        self._order(read_ns=read_ns, handed=1, final=final)
        self._ask(quiet, may_send=False)
        why = int(self._pass_handed())
        for side in self._sides:
            side[_SIDE["count"]] = 0
        return self._left(why)

    def _waited(self, buses: Sequence[int], door: int, clock: Clock) -> Left:
        """Wait as the kernel does, which is not there: all that comes is Python's to read."""
        open_ = [fd for fd in (*buses, door) if fd != NONE]
        ready = readable(open_, self._patience_ms(clock.now()) / 1000)
        knocked = door in ready
        why = (
            fast_path_kernel.BUS
            if len(ready) > knocked
            else fast_path_kernel.DOOR
            if knocked
            else fast_path_kernel.TIME
        )
        return Left(why, _NONE, (), _NONE, (), _NONE, -1, clock.now(), knocked)

    def _ask(self, quiet: FastPathConditions, *, may_send: bool) -> None:
        """Say what the gateway wants."""
        if quiet.heard != self._heard:
            self._connect(quiet.heard)
        before_ns = EVERYTHING if self._cells is None else quiet.before_ns
        self._order(
            before_ns=before_ns,
            server_ns=quiet.due_ns,
            prompt_ns=quiet.prompt_ns,
            may_send=may_send and quiet.may_send,
            foretells=quiet.foretells,
            told=0,
        )

    def _left(self, why: int) -> Left:
        orders, sides = self._orders, self._sides[: self._buses]
        count, start = orders[_ORDER["count"]], orders[_ORDER["start"]]
        raw: tuple[tuple[Frames, bool], ...] = ()
        batch = _NONE
        if why in (fast_path_kernel.RAW, fast_path_kernel.STEPPED):
            raw = tuple(
                (self._frames[k, : side[_SIDE["count"]]], bool(side[_SIDE["more"]])) for k, side in enumerate(sides)
            )
        elif why >= fast_path_kernel.WANTED:
            joined = orders[_ORDER["batch"]] == self._merged_at
            batch = (self._merged if joined else self._frames[0])[:count]
        received = tuple(side[_SIDE["fd"]] >= 0 for side in sides) if orders[_ORDER["passes"]] else ()
        return Left(
            why,
            self._taken[: orders[_ORDER["took"]]],
            received,
            self._told[: orders[_ORDER["told"]]],
            raw,
            batch,
            start if why >= fast_path_kernel.EVENTS else -1,
            orders[_ORDER["read_ns"]],
            bool(orders[_ORDER["knocked"]]),
        )
