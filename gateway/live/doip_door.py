"""Sockets of the DoIP server: TCP, TLS and UDP, served in the daemon's loop without waiting, a little each turn."""

from __future__ import annotations

import ipaddress
import selectors
import socket
from collections.abc import Callable
from typing import TYPE_CHECKING

from gateway.bus.frames import Frames
from gateway.host.sockets import reuse
from gateway.host.waiting import Selector
from gateway.live.clock import Clock
from gateway.live.listening import Listening
from gateway.runtime.app import Gateway
from gateway.servers.doip.connection import Connection
from gateway.servers.doip.params import DoipParams
from gateway.servers.doip.server import DoipServer
from gateway_fdi.common.log import get_logger
from gateway_fdi.errors import InputError

if TYPE_CHECKING:
    from ssl import SSLSocket

#: Most that is read or sent of one connection at once [byte]; connections and datagrams taken in one turn of the loop.
CHUNK_BYTES, MOST_IN_A_TURN = 64 << 10, 8
#: TLS handshakes that are gone on with in one turn: each takes a millisecond of the frames' time.
HANDSHAKES_IN_A_TURN = 1
#: Time for a closed tester to take what was sent to it last [s], and how many may take it.
LINGER_S, LINGERING = 1.0, 32
#: The vehicle is announced this often, with this time between (ISO 13400-2, Table 42) [s].
ANNOUNCEMENTS, ANNOUNCE_S = 3, 0.5
#: Longest datagram that makes sense [byte].
DATAGRAM = 2048

#: Does what is due at a listening socket.
_Attend = Callable[[socket.socket], None]

log = get_logger(__name__)


class _Peer:
    """A socket and its connection; ``shaking``: the TLS handshake is not over; ``until_s``: it only lingers."""

    def __init__(self, made: socket.socket, connection: Connection) -> None:
        self.socket, self.connection = made, connection
        self.shaking = connection.secure
        self.until_s: float | None = None
        self.events = selectors.EVENT_READ

    def shake(self) -> bool:
        """Go on with the handshake; returns whether it is over. Raises OSError where it fails."""
        tls: SSLSocket = self.socket  # type: ignore[assignment]
        tls.do_handshake()
        subject = (tls.getpeercert() or {}).get("subject", ())
        names = [value for part in subject for key, value in part if key == "commonName"]  # type: ignore[str-unpack]
        self.connection.certificate = str(names[0]) if len(names) == 1 else ""
        self.shaking = False
        return True


def _would_wait(error: OSError) -> int | None:
    """Return the event that an operation of a socket waits for; None: it has failed."""
    if isinstance(error, BlockingIOError):
        return 0
    name = type(error).__name__  # without ssl, which is slow to load
    return {"SSLWantReadError": selectors.EVENT_READ, "SSLWantWriteError": selectors.EVENT_WRITE}.get(name)


class DoipDoor:
    """Listens for testers.

    Args:
        params: the table ``[output.doip]``.
        gateway: that serves them; one that does not is replaced before the first turn.
        clock: the engine's.

    Raises:
        InputError: this machine does not have an address, or a port is taken.
    """

    def __init__(self, params: DoipParams, gateway: Gateway, clock: Clock) -> None:
        self._params, self._gateway, self._clock = params, gateway, clock
        self._selector = Selector()
        self._found: DoipServer | None = _server_of(gateway)
        self._peers: list[_Peer] = []
        self._lingering: list[_Peer] = []
        self._listening = Listening(self._selector, "DoIP: a tester cannot be taken")
        self._datagrams: list[socket.socket] = []
        self._announced, self._announce_s = 0, 0.0
        self._now_s = 0.0
        self._shakes = 0
        try:
            for address in params.bind:
                self._listen(address)
        except BaseException:
            self.close()
            raise

    def _listen(self, address: str) -> None:
        family = socket.AF_INET6 if ipaddress.ip_address(address).version == 6 else socket.AF_INET
        wanted: list[tuple[str, int, int, _Attend]] = [
            ("port", self._params.port, socket.SOCK_STREAM, self._accept),
            ("port", self._params.port, socket.SOCK_DGRAM, self._answer),
        ]
        if self._params.tls is not None:
            wanted.append(("tls.port", self._params.tls.port, socket.SOCK_STREAM, self._accept_tls))
        for key, port, kind, attend in wanted:
            made = socket.socket(family, kind)
            try:
                if family == socket.AF_INET6:
                    made.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
                if kind == socket.SOCK_STREAM:
                    reuse(made)
                made.bind((address, port))
                if kind == socket.SOCK_STREAM:
                    made.listen(64)
            except OSError as error:
                made.close()
                if address == "::1" and "bind" not in self._params.model_fields_set:
                    log.warning("DoIP: this machine has no IPv6", reason=error.strerror)
                    return
                text = f"nothing can listen at {address}: {error.strerror or error}"
                raise InputError(text, key=f"output.doip.{key}", value=port) from error
            made.setblocking(False)
            if kind == socket.SOCK_STREAM:
                self._listening.add(made, attend)
            else:
                self._datagrams.append(made)
                self._selector.register(made, selectors.EVENT_READ, attend)

    @property
    def _server(self) -> DoipServer:
        assert self._found is not None, "made for a gateway to come: replace() comes first"
        return self._found

    def fileno(self) -> int:
        """Return a descriptor that is readable when a tester wants something, or can take more."""
        return self._selector.fileno()

    def listening(self) -> bool:
        """Return that nobody is shown the time."""
        return False

    def on_frames(self, frames: Frames) -> None:
        """Frames are nothing to it."""

    def fits(self, params: DoipParams) -> bool:
        """Return whether it can be that of another configuration: same addresses and ports."""
        return params.is_place_of(self._params)

    def replace(self, gateway: Gateway, params: DoipParams) -> None:
        """Have another gateway serve from now on; the connections stay, where the settings are the same."""
        before, self._gateway, self._params = self._found, gateway, params
        self._found = _server_of(gateway)
        if before is not None:
            self._server.adopt(before)
        gateway.servers.wake(self._server)

    def turn(self, now_s: float, *, wanted: bool = True) -> None:
        """Take what has come and send what is to go, without waiting.

        Args:
            now_s: of a clock that is never set [s].
            wanted: whether the descriptor was readable.
        """
        self._listening.turn(now_s)
        if self._announced < self._most_announcements and now_s >= self._announce_s:
            self._announce(now_s)
        if wanted:
            self._now_s, self._shakes = now_s, HANDSHAKES_IN_A_TURN
            for key, _ in self._selector.select(0):
                if isinstance(key.data, _Peer):
                    self._hear(key.data)
                else:
                    key.data(key.fileobj)
        if self._peers:
            self._gateway.servers.wake(self._server)
            for peer in list(self._peers):
                self._flush(peer, now_s)
            for peer in self._peers:  # one that ended may have made room for another
                if peer.connection.out and not peer.shaking:
                    self._watch(peer, peer.events | selectors.EVENT_WRITE)
        for peer in [each for each in self._lingering if now_s >= (each.until_s or 0.0)]:
            self._forget(peer)

    def close(self) -> None:
        """End all connections."""
        for peer in list(self._peers):
            self._drop(peer)
        for peer in list(self._lingering):
            self._forget(peer)
        for made in self._datagrams:
            made.close()
        self._listening.close()
        self._selector.close()

    # Datagrams

    def _answer(self, made: socket.socket) -> None:
        for _ in range(MOST_IN_A_TURN):
            try:
                data, peer = made.recvfrom(DATAGRAM)
                answer = self._server.identity.answer(data, len(self._server.active))
                if answer:
                    made.sendto(answer, peer)
            except BlockingIOError:
                return
            except OSError as error:  # of an answer before, or one that cannot be sent
                log.debug("DoIP: no answer by UDP", reason=error.strerror)

    @property
    def _most_announcements(self) -> int:
        return ANNOUNCEMENTS if self._params.announce else 0

    def _announce(self, now_s: float) -> None:
        """Announce the vehicle by the interfaces of ``bind``; no router takes it further."""
        self._announced += 1
        self._announce_s = now_s + ANNOUNCE_S
        for text in self._params.announce:
            to = ipaddress.ip_address(text)
            family = socket.AF_INET6 if to.version == 6 else socket.AF_INET
            for made in (each for each in self._datagrams if each.family == family):
                try:
                    if family == socket.AF_INET:
                        made.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
                    made.setsockopt(socket.SOL_SOCKET, socket.SO_DONTROUTE, 1)
                    made.sendto(self._server.identity.vehicle(), (text, self._params.port))
                except OSError as error:
                    log.warning("DoIP: not announced", to=text, reason=error.strerror)
                finally:
                    made.setsockopt(socket.SOL_SOCKET, socket.SO_DONTROUTE, 0)

    # Connections

    def _accept(self, listener: socket.socket, *, secure: bool = False) -> None:
        for _ in range(MOST_IN_A_TURN):
            taken = self._listening.accept(listener, self._now_s)
            if taken is None:
                return
            made, peer = taken
            try:
                made.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                if secure and self._server.tls is not None:
                    made = self._server.tls.wrap_socket(made, server_side=True, do_handshake_on_connect=False)
            except OSError:
                made.close()  # gone again
                continue
            connection = self._server.connect(peer[0], self._clock.now(), secure=secure)
            self._peers.append(_Peer(made, connection))
            self._selector.register(made, selectors.EVENT_READ, self._peers[-1])

    def _accept_tls(self, listener: socket.socket) -> None:
        self._accept(listener, secure=True)

    def _hear(self, peer: _Peer) -> None:
        try:
            if peer.shaking:
                if not self._shakes:
                    return
                self._shakes -= 1
                peer.shake()
            while True:
                data = peer.socket.recv(CHUNK_BYTES)
                if not data:
                    self._drop(peer)
                    return
                if peer.until_s is None:
                    self._server.receive(peer.connection, data, self._clock.now())
                if not (peer.connection.secure and peer.connection.hungry and self._pending(peer)):
                    return
        except OSError as error:
            waits = _would_wait(error)
            if waits is None:
                self._drop(peer)
            elif waits:
                self._watch(peer, waits)

    def _pending(self, peer: _Peer) -> bool:
        """Return whether TLS has bytes that no selector sees."""
        return bool(peer.socket.pending())  # type: ignore[attr-defined]

    def _flush(self, peer: _Peer, now_s: float) -> None:
        out, connection = peer.connection.out, peer.connection
        try:
            if out and not peer.shaking:
                del out[: peer.socket.send(out[:CHUNK_BYTES])]
        except OSError as error:
            if _would_wait(error) is None:
                self._drop(peer)
                return
        if connection.ends:
            self._end(peer, now_s)
        elif not peer.shaking:
            wanted = (selectors.EVENT_READ if connection.hungry else 0) | (selectors.EVENT_WRITE if out else 0)
            self._watch(peer, wanted)
            if connection.secure and connection.hungry and self._pending(peer):
                self._hear(peer)

    def _watch(self, peer: _Peer, events: int) -> None:
        if events == peer.events:
            return
        if not peer.events:
            self._selector.register(peer.socket, events, peer)
        elif not events:
            self._selector.unregister(peer.socket)
        else:
            self._selector.modify(peer.socket, events, peer)
        peer.events = events

    def _end(self, peer: _Peer, now_s: float) -> None:
        """Close a connection so that its tester can take what was sent last, as an answer that says why."""
        self._peers.remove(peer)
        self._server.disconnect(peer.connection)
        peer.until_s = now_s + LINGER_S
        self._lingering.append(peer)
        try:
            peer.socket.shutdown(socket.SHUT_WR)
        except OSError:
            self._forget(peer)
            return
        self._watch(peer, selectors.EVENT_READ)
        if len(self._lingering) > LINGERING:
            self._forget(self._lingering[0])

    def _drop(self, peer: _Peer) -> None:
        """Forget a connection whose tester has gone."""
        if peer.until_s is None:
            self._peers.remove(peer)
            self._server.disconnect(peer.connection)
            self._lingering.append(peer)
        self._forget(peer)

    def _forget(self, peer: _Peer) -> None:
        self._watch(peer, 0)
        self._lingering.remove(peer)
        peer.socket.close()


def _server_of(gateway: Gateway) -> DoipServer | None:
    return next((server for server in gateway.servers.all if isinstance(server, DoipServer)), None)
