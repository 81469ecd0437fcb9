"""Frames to be sent on one bus: DTCs first, and nothing is lost because the queue of the bus is full."""

from __future__ import annotations

from collections import deque

import numpy as np

from gateway.bus.base import Bus
from gateway.bus.frames import ANSWER, CYCLIC, URGENT, Frames
from gateway_fdi.errors import BusError

#: Most frames that wait for a bus; an answer of 4095 bytes has 586.
MOST = 8192


class Transmitter:
    """Frames that wait until a bus takes them, by rank; within a rank in order.

    A cyclic message that waits is replaced by its next one. Beyond :data:`MOST` new frames are given up, the urgent
    ones last.

    Attributes:
        given_up: frames that were never sent.
    """

    def __init__(self) -> None:
        self._waiting: dict[int, deque[Frames]] = {rank: deque() for rank in (URGENT, ANSWER, CYCLIC)}
        self._count = 0
        self.given_up = 0

    def __len__(self) -> int:
        return self._count

    def send(self, bus: Bus, frames: Frames) -> None:
        """Send frames after those that wait; frames that the bus does not take wait too.

        Raises:
            BusError: the bus is gone.
        """
        if not self._count and len(frames) == 1:  # as a DTC's is: nothing to put in order
            try:
                if bus.send(frames):
                    return
            except BusError:
                self._add(frames)  # given up with what waits
                raise
        self._add(frames)
        self.flush(bus)

    def flush(self, bus: Bus) -> None:
        """Send what waits, as far as the bus takes it.

        Raises:
            BusError: the bus is gone.
        """
        for queue in self._waiting.values():
            while queue:
                taken = bus.send(queue[0])
                self._count -= taken
                if taken < len(queue[0]):
                    queue[0] = queue[0][taken:]
                    return
                queue.popleft()

    def give_up(self) -> None:
        """Give up what waits: its bus is gone, and it will be outdated when the bus comes back."""
        self.given_up += self._count
        self._count = 0
        for queue in self._waiting.values():
            queue.clear()

    def _add(self, frames: Frames) -> None:
        ranks = frames["rank"]
        present = set(ranks.tolist())
        for rank, queue in self._waiting.items():
            if rank not in present:
                continue
            mine = frames if len(present) == 1 else frames[ranks == rank]
            if rank == CYCLIC and queue:
                self._replace(queue, mine)
            room = MOST - self._count
            if len(mine) > room and rank == URGENT:
                self._make_room(len(mine) - room)
                room = MOST - self._count
            self.given_up += max(len(mine) - room, 0)
            mine = mine[: max(room, 0)]
            if len(mine):
                queue.append(mine)
                self._count += len(mine)

    def _replace(self, queue: deque[Frames], newer: Frames) -> None:
        for k, old in enumerate(queue):
            kept = old[~np.isin(old["can_id"], newer["can_id"])]
            self._give_up_part(len(old) - len(kept))
            queue[k] = kept

    def _make_room(self, wanted: int) -> None:
        for rank in (CYCLIC, ANSWER):
            queue = self._waiting[rank]
            while queue and wanted > 0:
                wanted -= len(queue[-1])
                self._give_up_part(len(queue.pop()))

    def _give_up_part(self, count: int) -> None:
        self._count -= count
        self.given_up += count
