"""Any python-can bus: a thread reads it, so that one selector can wait for all buses."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Sequence
from typing import TYPE_CHECKING

from gateway.bus.base import Bus
from gateway.bus.frames import Frames, put_message, to_message
from gateway.host.waker import Waker
from gateway_fdi.errors import BusError, InputError

if TYPE_CHECKING:
    import can

#: Messages kept between two reads; beyond that the oldest are dropped and counted.
QUEUE = 65536


class PythonCanBus(Bus):
    """Adapter of a python-can bus.

    Args:
        uri: as the user named it.
        index: stamped into every frame.
        bus: opened already; closed with this one.
    """

    own_clock = True  # some drivers stamp by the adapter's clock, from when it was plugged in

    def __init__(self, uri: str, index: int, bus: can.BusABC) -> None:
        super().__init__(uri, index)
        self._bus = bus
        self._queue: deque[can.Message] = deque()
        self._dropped = 0
        self._lock = threading.Lock()
        self._waker = Waker()
        self._error: Exception | None = None
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._read, name=f"read {uri}", daemon=True)
        self._thread.start()

    def _read(self) -> None:
        while not self._ended.is_set():
            try:
                message = self._bus.recv(0.1)
            except Exception as error:  # any exception of a driver must reach receive()
                self._error = error
                self._waker.wake()
                return
            if message is None:
                continue
            if not message.timestamp:
                message.timestamp = time.time()
            with self._lock:
                if len(self._queue) >= QUEUE:
                    self._queue.popleft()
                    self.statistics.overflow += 1
                    self._dropped += 1
                self._queue.append(message)
                if len(self._queue) == 1:
                    self._waker.wake()

    def fileno(self) -> int:
        """Return the event that the reader sets."""
        return self._waker.fileno()

    def receive(self, out: Frames) -> int:
        """Take what the reader has queued."""
        with self._lock:
            taken = [self._queue.popleft() for _ in range(min(len(out), len(self._queue)))]
            rest = bool(self._queue)
            self.losses = [(0, self._dropped)] if self._dropped else []
            self._dropped = 0
        if not rest and self._error is None:
            self._waker.rest()
            with self._lock:
                if self._queue:  # one came in between
                    self._waker.wake()
        count = 0
        for message in taken:
            try:
                put_message(out, count, message, bus=self.index)
            except InputError:  # CAN XL and the like
                self.statistics.rejected += 1
            else:
                count += 1
        self.statistics.received += count
        if not taken and self._error is not None:
            raise BusError(f"{self.uri}: reading failed: {self._error}") from self._error
        return count

    def send(self, frames: Frames) -> int:
        """Send through python-can."""
        for frame in frames:
            try:
                self._bus.send(to_message(frame))
            except Exception as error:  # each driver has its own
                raise BusError(f"{self.uri}: sending failed: {error}") from error
            self.statistics.sent += 1
        return len(frames)

    def set_filters(self, can_ids: Sequence[int] | None) -> None:
        """Set python-can's filters."""
        self._bus.set_filters(
            None
            if can_ids is None
            else [
                {
                    "can_id": can_id & 0x1FFFFFFF,
                    "can_mask": 0x1FFFFFFF,
                    "extended": bool(can_id & 0x80000000),
                }
                for can_id in can_ids
            ]
        )

    def close(self) -> None:
        """End the reader and close the bus."""
        if self._ended.is_set():
            return
        self._ended.set()
        self._thread.join(timeout=2.0)
        self._bus.shutdown()
        self._waker.close()
