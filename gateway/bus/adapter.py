"""Any python-can bus: a thread reads it, so that one selector can wait for all buses.

A driver raises for many reasons: a garbled line of a serial adapter, a warning limit, a full transmit buffer. One
exception is not a lost bus: it is counted (``driver_errors``), told in the log, and tried again. The bus is lost

- when reading has raised again and again, without one success between, for :data:`GIVE_UP_S`;
- when sending has raised so for :data:`GIVE_UP_S`, and nothing was received in this time, either.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Sequence
from typing import TYPE_CHECKING

from gateway.bus.base import Bus
from gateway.bus.frames import EXTENDED, ID_MASK, Frames, put_message, to_message
from gateway.host.waker import Waker
from gateway_fdi.common.log import get_logger
from gateway_fdi.errors import BusError, InputError

if TYPE_CHECKING:
    import can

#: Messages kept between two reads; beyond that the oldest are dropped and counted.
QUEUE = 65536
#: How long a driver may do nothing but raise [s]: longer than a reset of an adapter, shorter than people wait.
GIVE_UP_S = 2.0
#: First and longest wait before a driver that has raised is asked again [s].
FIRST_WAIT_S, LONGEST_WAIT_S = 0.001, 0.1

log = get_logger(__name__)


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
        self._heard_s = time.monotonic()  # when a message came last
        self._unsent_s: float | None = None  # since when nothing could be sent
        self._thread = threading.Thread(target=self._read, name=f"read {uri}", daemon=True)
        self._thread.start()

    def _read(self) -> None:
        failing_s: float | None = None
        wait_s = FIRST_WAIT_S
        while not self._ended.is_set():
            try:
                message = self._bus.recv(0.1)
            except Exception as error:  # each driver has its own
                now = time.monotonic()
                failing_s = now if failing_s is None else failing_s
                self._count(error, "reading")
                if now - failing_s >= GIVE_UP_S:
                    self._error = error  # must reach receive()
                    self._waker.wake()
                    return
                self._ended.wait(wait_s)
                wait_s = min(2 * wait_s, LONGEST_WAIT_S)
                continue
            failing_s, wait_s = None, FIRST_WAIT_S
            if message is None:
                continue
            self._heard_s = time.monotonic()
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

    def _count(self, error: Exception, what: str) -> None:
        """Count an exception of the driver; the 1st, 10th, 100th ... is told."""
        self.statistics.driver_errors += 1
        count = self.statistics.driver_errors
        if count == 10 ** (len(str(count)) - 1):
            reason = " ".join(str(error).split()) or type(error).__name__
            log.warning("a driver failed, and is tried again", uri=self.uri, what=what, times=count, reason=reason)

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
        """Send through python-can, as far as the driver takes frames: one that raises has a full buffer, or is gone."""
        import can  # noqa: PLC0415 - slow to load, and there already

        for k, frame in enumerate(frames):
            try:
                self._bus.send(to_message(frame))
            except (ValueError, TypeError, NotImplementedError) as error:
                # It is this frame, e.g. CAN FD on a classic adapter.
                if isinstance(error, can.CanError) and not isinstance(error, NotImplementedError):
                    return self._not_sent(k, error)
                self._count(error, "sending")
                self.statistics.refused += 1
                continue
            except Exception as error:  # each driver has its own
                return self._not_sent(k, error)
            self._unsent_s = None
            self.statistics.sent += 1
        return len(frames)

    def _not_sent(self, taken: int, error: Exception) -> int:
        """Note that a frame was not taken; returns how many were, before it.

        Raises:
            BusError: this has gone on for long, and nothing comes in, either; or reading has failed for good.
        """
        self._count(error, "sending")
        now = time.monotonic()
        self._unsent_s = now if self._unsent_s is None else self._unsent_s
        silent_s = now - max(self._unsent_s, self._heard_s)
        if self._error is not None or silent_s >= GIVE_UP_S:
            raise BusError(f"{self.uri}: sending failed: {error}") from error
        return taken

    def set_filters(self, can_ids: Sequence[int] | None) -> None:
        """Set python-can's filters."""
        wanted: list[can.typechecking.CanFilter] = [
            {"can_id": i & ID_MASK, "can_mask": ID_MASK, "extended": bool(i & EXTENDED)} for i in can_ids or ()
        ]
        self._bus.set_filters(None if can_ids is None else wanted)

    def close(self) -> None:
        """End the reader and close the bus."""
        if self._ended.is_set():
            return
        self._ended.set()
        self._thread.join(timeout=2.0)
        self._bus.shutdown()
        self._waker.close()
