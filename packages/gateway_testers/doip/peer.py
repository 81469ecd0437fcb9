"""One tester's TCP connection to the DoIP door: its socket, the bytes that it owes, and its one state."""

from __future__ import annotations

import socket
from enum import Enum
from selectors import EVENT_READ, EVENT_WRITE
from typing import TYPE_CHECKING, Protocol

from gateway_testers.doip.connection import Connection

if TYPE_CHECKING:
    from ssl import SSLContext

#: Most that is read or sent of one connection in one turn [byte], and most of TLS that is kept to be sent.
CHUNK_BYTES, KEPT_BYTES = 64 << 10, 256 << 10
#: Most that is read of TLS in one turn [byte]: 16 KiB are a record; a thousand small ones take some milliseconds.
TLS_BYTES = 16 << 10
#: Time for a closed tester to take what was sent to it last [s].
LINGER_S = 1.0


class State(Enum):
    """States of a connection; it goes from one to a later one only."""

    HANDSHAKING = "its TLS handshake is not over"
    OPEN = "served"
    LINGERING = "ended: it takes what was sent last; what it sends is thrown away"
    CLOSED = "gone"


class Tls(Protocol):
    """TLS of a connection, without its socket (:mod:`gateway_testers.doip.tls_stream`)."""

    sent: bytearray
    certificate: str
    ended: bool

    def shake(self, data: bytes) -> bool:
        """Take bytes of a handshake; returns whether it is over. Raises OSError: it failed."""

    def decrypted(self, data: bytes = b"") -> bytes | None:
        """Return what bytes carry; None: they are no whole record. b"": the end. Raises OSError: they are none."""

    def encrypt(self, data: bytes) -> None:
        """Have bytes among those to be sent."""

    def end(self) -> None:
        """Have the end among what is to be sent."""


class Peer:
    """A connection.

    Args:
        made: its socket, which does not wait.
        connection: of the server.

    Attributes:
        socket, connection: the same.
        state: where it is.
        until_s: when lingering is over.
        events: those that its door waits for.
    """

    def __init__(self, made: socket.socket, connection: Connection) -> None:
        self.socket, self.connection = made, connection
        self._tls: Tls | None = None
        self.state = State.HANDSHAKING if connection.secure else State.OPEN
        self.until_s = 0.0
        self.events = 0

    def secure(self, context: SSLContext) -> None:
        """Have it speak TLS, which it does not wait for."""
        from gateway_testers.doip.tls_stream import TlsStream  # noqa: PLC0415 - ssl takes long to load

        self._tls = TlsStream(context)

    def __str__(self) -> str:
        """Return its name."""
        return self.connection.name

    @property
    def has_ended(self) -> bool:
        """Whether its tester has said by TLS that it sends no more."""
        return self._tls is not None and self._tls.ended

    @property
    def is_served(self) -> bool:
        """Whether the server has it."""
        return self.state in (State.HANDSHAKING, State.OPEN)

    def hear(self) -> bytes | None:
        """Return what came, a piece at most; None: nothing for the server. b"": its end.

        Raises:
            OSError: the connection has failed.
        """
        try:
            data = self.socket.recv(CHUNK_BYTES if self._tls is None else TLS_BYTES)
        except BlockingIOError:
            return None
        if not data or self._tls is None or self.state is State.LINGERING:
            return data
        if self.state is State.HANDSHAKING:
            if not self._tls.shake(data):
                return None
            self.state = State.OPEN
            self.connection.certificate = self._tls.certificate
            return self._tls.decrypted()  # what came behind the handshake
        return self._tls.decrypted(data)

    @property
    def _owed(self) -> bytearray:
        """The bytes that go to its socket."""
        return self.connection.out if self._tls is None else self._tls.sent

    def send(self) -> None:
        """Send what its socket takes now, a piece at most.

        Raises:
            OSError: the connection has failed.
        """
        out = self.connection.out
        if self._tls is not None and out and self.state is State.OPEN and len(self._tls.sent) < CHUNK_BYTES:
            self._tls.encrypt(bytes(out[:CHUNK_BYTES]))
            del out[:CHUNK_BYTES]
        owed = self._owed
        if owed:
            try:
                del owed[: self.socket.send(owed[:CHUNK_BYTES])]
            except BlockingIOError:
                return

    @property
    def wanted(self) -> int:
        """The events that it waits for."""
        if self.state is State.CLOSED:
            return 0
        if self.state is State.LINGERING:
            return EVENT_READ
        owed = bool(self._owed) or (self.state is State.OPEN and bool(self.connection.out))
        heard = len(self._owed) < KEPT_BYTES if self.state is State.HANDSHAKING else self._may_be_heard
        return (EVENT_READ if heard else 0) | (EVENT_WRITE if owed else 0)

    @property
    def _may_be_heard(self) -> bool:
        return self.connection.hungry and (self._tls is None or len(self._tls.sent) < KEPT_BYTES)

    def linger(self, now_s: float) -> None:
        """Send the end; who does not take it now gets it in the linger time.

        Raises:
            OSError: the connection has failed.
        """
        ended_early = self.state is State.HANDSHAKING
        self.send()
        self.state, self.until_s = State.LINGERING, now_s + LINGER_S
        if self._tls is not None and not ended_early:
            self._tls.end()
            self.send()
        self.socket.shutdown(socket.SHUT_WR)
