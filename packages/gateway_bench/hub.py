"""The hub: CAN buses between processes on this machine, speaking the socketcand protocol.

A frame from one client goes to all others on the same bus, stamped with the hub's clock as a CAN
controller would. A client that does not read loses its oldest frames; it never holds up the others.
"""

from __future__ import annotations

import errno
import os
import selectors
import socket
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field

from gateway.bus.socketcand import (
    Parts,
    extended_frame,
    parse_extended,
    parse_send,
    plain_frame,
    split,
)
from gateway.host.process import RAW
from gateway.host.sockets import reuse
from gateway.host.waiting import Selector
from gateway_fdi.common.log import get_logger
from gateway_fdi.errors import BusError

log = get_logger(__name__)

#: Frames that wait for a slow client.
QUEUE = 20_000
#: Time that a plain client's first frames wait [s]: python-can wants the answer to rawmode alone.
HOLD_S = 0.05


def _spare() -> int | None:
    """Return a descriptor to be given up when there is no other; None: not even this one."""
    try:
        return os.open(os.devnull, os.O_RDONLY | RAW)
    except OSError:
        return None


@dataclass
class HubStatistics:
    """Counters of a hub."""

    frames: int = 0
    dropped: int = 0  # frames and answers for slow clients
    inexpressible: int = 0  # FD and the like, for plain clients
    rejected: int = 0  # input that was no message
    refused: int = 0  # connections, for lack of descriptors


@dataclass(eq=False)
class _Client:
    socket: socket.socket
    received: bytearray = field(default_factory=bytearray)
    waiting: deque[bytes] = field(default_factory=deque)
    partial: bytes = b""
    bus: str | None = None
    raw: bool = False
    extended: bool = False
    held_until: float = 0.0
    ended: bool = False


class Hub:
    """Serves buses on a loopback address; any bus name a client opens exists.

    Args:
        host: 127.0.0.1 or ::1.
        port: 0 takes a free one.
        clock_ns: stamps the frames [ns].

    Raises:
        BusError: the address is taken.
    """

    def __init__(
        self,
        host: str = "127.0.0.1",
        port: int = 29536,
        *,
        clock_ns: Callable[[], int] = time.time_ns,
    ) -> None:
        self.statistics = HubStatistics()
        self._clock_ns = clock_ns
        self._spare = _spare()
        self._selector = Selector()
        self._clients: list[_Client] = []
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        self._server = socket.socket(family, socket.SOCK_STREAM)
        reuse(self._server)
        try:
            self._server.bind((host, port))
        except OSError as error:
            self._server.close()
            raise BusError(f"loopback:{host}:{port}: {error.strerror}") from error
        self._server.listen()
        self._server.setblocking(False)
        self._selector.register(self._server, selectors.EVENT_READ)

    @property
    def address(self) -> tuple[str, int]:
        """Where it listens."""
        host, port = self._server.getsockname()[:2]
        return host, port

    def serve_forever(self, stop: Callable[[], bool]) -> None:
        """Serve until told to stop (asked at least ten times a second)."""
        while not stop():
            self.serve_once(0.1)

    def serve_once(self, timeout_s: float) -> None:
        """Wait for work, at most this time [s], and do it."""
        for key, mask in self._selector.select(timeout_s):
            client = key.data
            if client is None:
                self._accept()
                continue
            if mask & selectors.EVENT_READ:
                self._read(client)
            if mask & selectors.EVENT_WRITE and not client.ended:
                self._write(client)
        for client in [client for client in self._clients if client.ended]:
            self._drop(client)
        for client in self._clients:
            if client.waiting:
                self._write(client)

    def close(self) -> None:
        """Close all connections and the address."""
        for client in list(self._clients):
            self._drop(client)
        self._selector.unregister(self._server)
        self._server.close()
        if self._spare is not None:
            os.close(self._spare)
            self._spare = None
        self._selector.close()

    def _accept(self) -> None:
        try:
            connection, _ = self._server.accept()
        except OSError as error:
            if error.errno in (errno.EMFILE, errno.ENFILE):
                self._turn_away()
            return  # else the client that wanted in is gone already
        if self._spare is None:
            self._spare = _spare()
        connection.setblocking(False)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        # Bounded, so that frames for a slow client wait here, where they are counted.
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 1 << 18)
        client = _Client(connection)
        self._clients.append(client)
        self._selector.register(connection, selectors.EVENT_READ, client)
        self._answer(client, "hi")

    def _turn_away(self) -> None:
        """End a connection that there is no descriptor for: left waiting it would keep the loop busy for ever."""
        if self._spare is not None:
            os.close(self._spare)
            self._spare = None
        with suppress(OSError):
            self._server.accept()[0].close()
        self._spare = _spare()
        if not self.statistics.refused:
            log.warning("no descriptors left: connections are refused", clients=len(self._clients))
        self.statistics.refused += 1

    def _drop(self, client: _Client) -> None:
        self._clients.remove(client)
        self._selector.unregister(client.socket)
        client.socket.close()

    def _answer(self, client: _Client, text: str) -> None:
        self._make_room(client)
        client.waiting.append(f"< {text} >".encode())
        self._write(client)

    def _read(self, client: _Client) -> None:
        try:
            data = client.socket.recv(1 << 16)
        except (BlockingIOError, InterruptedError):
            return
        except OSError:
            data = b""
        if not data:
            client.ended = True
            return
        client.received += data
        messages, garbage = split(client.received)
        for _ in range(garbage):
            self._refuse(client, "malformed input")
        for words in messages:
            self._handle(client, words)

    def _refuse(self, client: _Client, why: str) -> None:
        self.statistics.rejected += 1
        self._answer(client, f"error {why}")

    def _handle(self, client: _Client, words: list[str]) -> None:
        command = words[0] if words else ""
        if command == "open" and len(words) == 2:
            client.bus = words[1]
            self._answer(client, "ok")
        elif command == "echo":
            self._answer(client, "echo")
        elif command not in ("send", "x", "rawmode", "xmode"):
            self._refuse(client, "unknown command")
        elif client.bus is None:
            self._refuse(client, "open a bus first")
        elif command == "rawmode":
            self._answer(client, "ok")
            client.raw = True
            if not client.extended:
                client.held_until = time.monotonic() + HOLD_S
        elif command == "xmode":
            client.extended = True
            self._answer(client, "ok")
        elif command == "x" and not client.extended:
            self._refuse(client, "malformed frame")
        else:
            try:
                parts = parse_extended(words) if command == "x" else parse_send(words)
            except (ValueError, IndexError):
                self._refuse(client, "malformed frame")
            else:
                self._spread(client, (self._clock_ns(), *parts[1:]))

    def _spread(self, sender: _Client, parts: Parts) -> None:
        self.statistics.frames += 1
        lines: dict[bool, bytes | None] = {}
        for client in self._clients:
            if client is sender or client.bus != sender.bus or not client.raw:
                continue
            if client.extended not in lines:
                lines[client.extended] = extended_frame(parts) if client.extended else plain_frame(parts)
            line = lines[client.extended]
            if line is None:
                self.statistics.inexpressible += 1
                continue
            self._make_room(client)
            client.waiting.append(line)

    def _make_room(self, client: _Client) -> None:
        """Give up the oldest of what waits for a client that does not read, be it frames or answers."""
        if len(client.waiting) >= QUEUE:
            client.waiting.popleft()
            self.statistics.dropped += 1

    def _write(self, client: _Client) -> None:
        if client.held_until:
            if time.monotonic() < client.held_until:
                return
            client.held_until = 0.0
        while client.waiting or client.partial:
            if not client.partial:
                count = min(len(client.waiting), 512)
                client.partial = b"".join(client.waiting.popleft() for _ in range(count))
            try:
                sent = client.socket.send(client.partial)
            except (BlockingIOError, InterruptedError):
                break
            except OSError:
                client.ended = True
                return
            client.partial = client.partial[sent:]
        events = selectors.EVENT_READ
        if client.waiting or client.partial:
            events |= selectors.EVENT_WRITE
        if self._selector.get_key(client.socket).events != events:
            self._selector.modify(client.socket, events, client)
