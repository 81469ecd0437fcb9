"""The queue of a car's fault memory, read beside the daemon that writes it, or without one."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

from gateway.common.jsonlines import line
from gateway.faults.fleet import FleetParams
from gateway.faults.lock import InUseError
from gateway.faults.memory_reader import MemoryReader
from gateway.faults.outgoing import Outgoing, Tally
from gateway.faults.records import Changes
from gateway.faults.store import Store
from gateway.runtime.contract import DETAIL, reported_to_fleet
from gateway_fdi.errors import GatewayError

#: Bytes that may wait: nothing goes while others are taken away.
_ALL = 2**62
#: Rows that are there still after this time were not taken away [s]: their daemon was killed before.
_STALE_S = 5.0


class Queue:
    """Events that wait in a fault memory's file."""

    def __init__(self, path: Path) -> None:
        self._memory = MemoryReader(path)
        self._inode = self._after = 0  # of the file that numbers are of; the last row that has arrived
        self._asked_s = 0.0

    def read(self, most: int) -> tuple[list[Outgoing], Tally]:
        """Return the first events that have not arrived, and the counts of the queue; none, where it cannot be read."""
        try:
            store = self._memory.store()
            if self._memory.inode != self._inode:
                self._inode, self._after = self._memory.inode, 0
            with store.reading():
                return store.outgoing(self._after, most), store.tally()
        except (GatewayError, OSError):
            self._memory.close()
            return [], Tally(0, 0, 0, 0)

    def note(self, numbers: Sequence[int]) -> None:
        """Note that the first rows have arrived: they are not read again."""
        self._after, self._asked_s = max(self._after, *numbers), time.monotonic()

    def stale(self, most: int) -> list[int]:
        """Return rows that have arrived, and that nobody has taken away for a while."""
        if not self._after or time.monotonic() < self._asked_s + _STALE_S:
            return []
        self._asked_s = time.monotonic()
        try:
            return [row.number for row in self._memory.store().outgoing(0, most) if row.number <= self._after]
        except (GatewayError, OSError):
            self._memory.close()
            return []

    def take_away(self, numbers: Sequence[int]) -> bool:
        """Take events away that have arrived, where no daemon keeps the file; returns whether it was so.

        Raises:
            GatewayError: it could not be written.
        """
        return self._written(Changes(arrived=numbers, outgoing_bytes=_ALL))

    def _written(self, changes: Changes) -> bool:
        self.close()
        try:
            store = Store(self._memory.path)
        except InUseError:
            return False
        with closing(store):
            store.save(changes)
        return True

    def add(self, events: Sequence[Mapping[str, Any]], car: FleetParams) -> bool:
        """Write events, where no daemon keeps the file; returns whether it was so.

        Raises:
            GatewayError: they could not be written.
        """
        made = [
            Outgoing(int(event["t_ns"]), reported_to_fleet(event) == DETAIL, car.serial, line(event))
            for event in events
        ]
        return self._written(Changes(outgoing=made, outgoing_bytes=car.bytes))

    def close(self) -> None:
        """Leave the file to its writer; a look opens it again."""
        self._memory.close()
