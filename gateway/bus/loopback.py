"""Client of the hub: a CAN bus between processes where the kernel has none."""

from __future__ import annotations

import select
import socket
import time
from collections import deque

from gateway.bus.base import Bus
from gateway.bus.frames import Frames, put
from gateway.bus.socketcand import Parts, extended_frame, parse_extended, split
from gateway_fdi.errors import BusError

DEFAULT_ADDRESS = ("127.0.0.1", 29536)
DEFAULT_BUS = "can0"

#: Longest wait until the hub takes frames [s].
SEND_PATIENCE_S = 5.0


class LoopbackBus(Bus):
    """A connection to ``gateway bus``, which may take a while to appear [s]; ``name`` is of the bus there.

    Raises:
        BusError: there is no hub, or it is none.
    """

    def __init__(
        self,
        uri: str,
        index: int,
        address: tuple[str, int] = DEFAULT_ADDRESS,
        name: str = DEFAULT_BUS,
        *,
        patience_s: float = 10.0,
    ) -> None:
        super().__init__(uri, index)
        self._received = bytearray()
        self._waiting: deque[Parts] = deque()
        self._socket = self._connect(address, patience_s)
        try:
            for said, answer in (
                (None, b"< hi >"),
                (f"< open {name} >", b"< ok >"),
                ("< xmode >", b"< ok >"),
                ("< rawmode >", b"< ok >"),  # the last: from here on frames come
            ):
                if said is not None:
                    self._socket.sendall(said.encode())
                got = self._socket.recv(64)
                if not got.startswith(answer):
                    raise BusError(f"{uri}: not a gateway bus: {got[:40]!r}")
                self._received += got[len(answer) :]
        except (OSError, BusError) as error:
            self._socket.close()
            raise error if isinstance(error, BusError) else BusError(f"{uri}: no answer: {error}") from error
        self._socket.setblocking(False)

    def _connect(self, address: tuple[str, int], patience_s: float) -> socket.socket:
        limit = time.monotonic() + patience_s
        while True:
            try:
                connection = socket.create_connection(address, timeout=5.0)
            except OSError as error:
                if time.monotonic() > limit:
                    raise BusError(
                        f"{self.uri}: no bus there ({error.strerror or error}); start one: gateway bus"
                    ) from error
                time.sleep(0.1)
            else:
                connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                return connection

    def fileno(self) -> int:
        """Return the connection."""
        return self._socket.fileno()

    def receive(self, out: Frames) -> int:
        """Take what the hub has sent."""
        if not self._waiting:
            self._read()
        count = min(len(out), len(self._waiting))
        for k in range(count):
            t_ns, can_id, flags, data = self._waiting.popleft()
            put(out, k, t_ns, can_id, data, bus=self.index, flags=flags)
        self.statistics.received += count
        return count

    def _read(self) -> None:
        try:
            data = self._socket.recv(1 << 14)
        except (BlockingIOError, InterruptedError):
            return
        except OSError as error:
            raise BusError(f"{self.uri}: the bus is gone: {error}") from error
        if not data:
            raise BusError(f"{self.uri}: the bus is gone: gateway bus has ended")
        self._received += data
        messages, garbage = split(self._received)
        self.statistics.rejected += garbage
        for words in messages:
            try:
                self._waiting.append(parse_extended(words))
            except (ValueError, IndexError):
                self.statistics.rejected += 1

    def send(self, frames: Frames) -> int:
        """Send frames to all others on the bus; waits a while until the hub takes them."""
        data = b"".join(
            # A remote frame's DLC goes as this number of zeros.
            extended_frame(
                (0, int(one["can_id"]), int(one["flags"]), bytes(one["data"][: one["length"]])), stamped=False
            )
            for one in frames
        )
        limit = time.monotonic() + SEND_PATIENCE_S
        while data:
            try:
                data = data[self._socket.send(data) :]
            except (BlockingIOError, InterruptedError):
                rest = limit - time.monotonic()
                if rest <= 0 or not select.select([], [self._socket], [], rest)[1]:
                    raise BusError(f"{self.uri}: the bus takes no frames") from None
            except OSError as error:
                raise BusError(f"{self.uri}: the bus is gone: {error}") from error
        self.statistics.sent += len(frames)
        return len(frames)

    def close(self) -> None:
        """Leave the bus."""
        self._socket.close()
