"""A server behind DoIP: connections and datagrams of a tester."""

from __future__ import annotations

import socket
import struct
import time
from collections.abc import Sequence
from contextlib import suppress
from typing import NamedTuple
from urllib.parse import parse_qs, urlsplit

import pytest

from gateway_conformance.target import P2_STAR_NS, PATIENCE_NS, Answer, Target
from gateway_fdi.errors import InputError
from gateway_testers.doip.codec import HEADER, VERSIONS, Activation, Kind, packed

#: Longest wait for an answer of the entity itself (A_DoIP_Ctrl) [s].
CONTROL_S = 2.0


class Message(NamedTuple):
    """A message: payload type, payload."""

    kind: int
    body: bytes


class Stream:
    """A TCP connection to the entity."""

    def __init__(self, place: tuple[str, int]) -> None:
        self._socket = socket.create_connection(place, CONTROL_S)
        self._bytes = b""
        self.ended = False

    def send(self, kind: int, body: bytes = b"") -> None:
        """Send a message."""
        self.send_raw(packed(kind, body, VERSIONS[-1]))

    def send_raw(self, data: bytes) -> None:
        """Send bytes as they are."""
        with suppress(BrokenPipeError, ConnectionResetError):  # ended: seen by who reads
            self._socket.sendall(data)

    def next(self, seconds: float = CONTROL_S) -> Message | None:
        """Return the next message; None: none came, or the entity has ended the connection."""
        until = time.monotonic() + seconds
        while not self.ended:
            if len(self._bytes) >= HEADER.size:
                _, _, kind, length = HEADER.unpack_from(self._bytes)
                if len(self._bytes) >= HEADER.size + length:
                    body, self._bytes = self._bytes[HEADER.size :][:length], self._bytes[HEADER.size + length :]
                    return Message(kind, body)
            self._socket.settimeout(max(until - time.monotonic(), 1e-3))
            try:
                more = self._socket.recv(1 << 16)
            except TimeoutError:
                return None
            except ConnectionResetError:
                more = b""
            self.ended = not more
            self._bytes += more
        return None

    def ends(self) -> bool:
        """Return whether the entity ends the connection."""
        while self.next() is not None:
            pass
        return self.ended

    def activate(self, source: int, kind: int = 0) -> Message | None:
        """Ask for routing; returns the answer."""
        self.send(Kind.ACTIVATE, struct.pack(">HBI", source, kind, 0))
        return self.next()

    def close(self) -> None:
        """End it."""
        self._socket.close()


class DoipTarget(Target):
    """A server behind DoIP.

    Args:
        uri: ``doip://HOST:PORT/ADDRESS?source=0x0E00&functional=0xE400``.
        slack_ns: see :class:`Target`.
        demanded: the same.

    Raises:
        InputError: it is no such URI.
    """

    def __init__(self, uri: str, slack_ns: int, demanded: Sequence[str]) -> None:
        super().__init__(uri.partition("?")[0], slack_ns, demanded)
        found = urlsplit(uri)
        query = {key: values[-1] for key, values in parse_qs(found.query).items()}
        try:
            self.place = found.hostname or "127.0.0.1", found.port or 13400
            self.address = int(found.path.strip("/"), 0)
            self.source = int(query.pop("source", "0x0E00"), 0)
            self.to_all = int(query.pop("functional", "-1"), 0)
        except ValueError as error:
            raise InputError(f"a DoIP target is doip://HOST:PORT/ADDRESS: {error}", key="target", value=uri) from error
        if query:
            raise InputError("a DoIP target takes source= and functional=", key="target", value=", ".join(query))
        self.functional = self.to_all >= 0
        self._stream: Stream | None = None

    def stream(self) -> Stream:
        """Return a new connection, not activated."""
        return Stream(self.place)

    def activated(self) -> Stream:
        """Return a new connection whose routing is activated."""
        self.close()
        made = self.stream()
        told = made.activate(self.source)
        if told is None or told.kind != Kind.ACTIVATED or told.body[4] != Activation.DONE:
            pytest.fail(f"{self.name}: routing for 0x{self.source:04X} is not activated: {told}", pytrace=False)
        return made

    def datagram(self, data: bytes, seconds: float = CONTROL_S) -> Message | None:
        """Send a datagram; returns its answer, None: none came."""
        family = socket.AF_INET6 if ":" in self.place[0] else socket.AF_INET
        with socket.socket(family, socket.SOCK_DGRAM) as made:
            made.settimeout(seconds)
            made.sendto(data, self.place)
            try:
                got = made.recv(1 << 16)
            except TimeoutError:
                return None
        return Message(HEADER.unpack_from(got)[2], got[HEADER.size :]) if len(got) >= HEADER.size else Message(-1, got)

    def diagnostic(self, request: bytes, *, source: int | None = None, target: int | None = None) -> bytes:
        """Return the payload of a diagnostic message."""
        addresses = self.source if source is None else source, self.address if target is None else target
        return struct.pack(">HH", *addresses) + request

    def ask(self, request: str, *, functional: bool = False, patience_ns: int = PATIENCE_NS) -> Answer:
        """Send a request; returns all that comes until its final answer, or until patience ends."""
        data = bytes.fromhex(request)
        if self._stream is None or self._stream.ended:
            self._stream = self.activated()
        begun = time.monotonic_ns()
        until, first, waits = begun + patience_ns, 0, 0
        self._stream.send(Kind.DIAGNOSTIC, self.diagnostic(data, target=self.to_all if functional else None))
        came: list[bytes] = []
        while not came and (rest := until - time.monotonic_ns()) > 0:
            told = self._stream.next(rest / 1e9)
            if told is None:
                break
            if told.kind == Kind.DIAGNOSTIC_NACK:
                pytest.fail(f"{self.name}: {request} is refused by DoIP with {told.body[4:5].hex()}", pytrace=False)
            if told.kind != Kind.DIAGNOSTIC or told.body[:2] != self.address.to_bytes(2, "big"):
                continue
            first = first or time.monotonic_ns()
            if told.body[4:5] == b"\x7f" and told.body[6:] == b"\x78":
                waits, until = waits + 1, time.monotonic_ns() + P2_STAR_NS + self.slack_ns
            else:
                came.append(told.body[4:])
        return Answer(data, self.name, tuple(came), waits, max(first - begun, 0))

    def rest(self, ns: int) -> None:
        """Let time pass, and ask nothing."""
        time.sleep(ns / 1e9)

    def close(self) -> None:
        """End its connection."""
        if self._stream is not None:
            self._stream.close()
            self._stream = None
