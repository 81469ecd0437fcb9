"""Sockets of the DoIP server: TCP, TLS and UDP, served in the daemon's loop without waiting, a little each turn."""

from __future__ import annotations

import ipaddress
import socket
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from gateway.bus.frames import Frames
from gateway.common.budget import Budget
from gateway.host.sockets import reuse
from gateway.host.waiting import Selector
from gateway.live.clock import Clock
from gateway.live.listening_sockets import ListeningSockets
from gateway.runtime.app import Gateway
from gateway_fdi.common.log import get_logger
from gateway_fdi.errors import InputError
from gateway_testers.doip.params import DoipParams
from gateway_testers.doip.peer import Peer, State
from gateway_testers.doip.server import DoipServer

#: Connections and datagrams of each socket that are taken in one turn of the loop.
MOST_IN_A_TURN = 8
#: TLS handshakes that are gone on with in one turn: each takes a millisecond of the frames' time.
HANDSHAKES_IN_A_TURN = 1
#: Closed testers that may take what was sent to them last.
LINGERING = 32
#: The vehicle is announced this often, with this time between (ISO 13400-2, Table 42) [s].
ANNOUNCEMENTS, ANNOUNCE_S = 3, 0.5
#: Longest datagram that makes sense [byte].
DATAGRAM = 2048

#: Does what is due at a listening socket.
_Attend = Callable[[socket.socket], None]

log = get_logger(__name__)


class DoipDoor:
    """Listens for testers.

    Args:
        params: the table ``[output.doip]``.
        gateway: that serves them; one that does not is replaced before the first turn.
        clock: the engine's.

    Raises:
        InputError: this machine does not have an address, or a port is taken.
    """

    name = "doip"

    def __init__(self, params: DoipParams, gateway: Gateway, clock: Clock) -> None:
        self._params, self._gateway, self._clock = params, gateway, clock
        self._wall = gateway.fence.wall(self.name)
        self._found: DoipServer | None = _server_of(gateway)
        self._announced, self._announce_s = 0, 0.0
        self._now_s = 0.0
        self._shakes = 0
        self._open()

    def _open(self) -> None:
        self._selector, self._budget = Selector(), Budget()
        self._peers: list[Peer] = []
        self._lingering: list[Peer] = []
        self._listening = ListeningSockets(self._selector, "DoIP: a tester cannot be taken")
        self._datagrams: list[socket.socket] = []
        self._own: list[socket.socket] = []  # that it has opened to listen at
        try:
            for address in self._params.bind:
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
            self._own.append(made)
            self._listening.add(made, attend)
            if kind == socket.SOCK_DGRAM:
                self._datagrams.append(made)

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
        self._found, self._wall = _server_of(gateway), gateway.fence.wall(self.name)
        if before is not None:
            self._server.adopt(before)
        gateway.servers.wake(self._server)

    def turn(self, now_s: float, *, wanted: bool = True) -> None:
        """Take what has come and send what is to go, without waiting.

        Args:
            now_s: of a clock that is never set [s].
            wanted: whether the descriptor was readable.
        """
        self._now_s = now_s
        self._listening.turn(now_s)
        if self._announced < self._most_announcements and now_s >= self._announce_s:
            self._announced, self._announce_s = self._announced + 1, now_s + ANNOUNCE_S
            self._wall.keep(self._announce, of="announcement")
        if wanted:
            self._shakes = HANDSHAKES_IN_A_TURN
            for key, _ in self._budget.among(self._selector.select(0)):
                if isinstance(key.data, Peer):
                    self._wall.keep(self._hear, key.data, of=key.data, ends=self._close)
                else:
                    self._wall.keep(key.data, key.fileobj, of="no tester yet", ends=self._listening.rest)
        if self._peers:
            self._gateway.servers.wake(self._server)
            for peer in list(self._peers):
                self._wall.keep(self._flush, peer, of=peer, ends=self._close)
            for peer in list(self._peers):  # one that ended may have made room for another
                self._wall.keep(self._watch, peer, of=peer, ends=self._close)
        for peer in [each for each in self._lingering if now_s >= each.until_s]:
            self._close(peer)

    def restart(self) -> None:
        """End all connections, and listen again.

        Raises:
            InputError: a port is taken.
        """
        self.close()
        self._open()

    def close(self) -> None:
        """End all connections."""
        for peer in [*self._peers, *self._lingering]:
            self._close(peer)
        for made in self._own:
            made.close()
        self._selector.close()

    # Datagrams

    def _answer(self, made: socket.socket) -> None:
        for _ in range(MOST_IN_A_TURN):
            try:
                data, peer = made.recvfrom(DATAGRAM)
            except BlockingIOError:
                return
            except OSError as error:  # of an answer before
                log.debug("DoIP: nothing heard by UDP", reason=error.strerror)
                continue
            self._wall.keep(self._answer_one, made, data, peer, of=peer)

    def _answer_one(self, made: socket.socket, data: bytes, peer: Any) -> None:
        answer = self._server.identity.answer(data, len(self._server.active))
        try:
            if answer:
                made.sendto(answer, peer)
        except OSError as error:  # it cannot be sent, or there is no room
            log.debug("DoIP: no answer by UDP", reason=error.strerror)

    @property
    def _most_announcements(self) -> int:
        return ANNOUNCEMENTS if self._params.announce else 0

    def _announce(self) -> None:
        """Announce the vehicle by the interfaces of ``bind``; no router takes it further."""
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
            taken = self._listening.accept(listener)
            if taken is None:
                return
            made, address = taken
            self._take_or_close(made, address, secure)

    def _take_or_close(self, made: socket.socket, address: tuple[str, int], secure: bool) -> None:
        self._wall.keep(self._take, made, address[0], secure, of=address, ends=lambda _: made.close())

    def _take(self, made: socket.socket, address: str, secure: bool) -> None:
        try:
            made.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        except OSError:
            made.close()  # gone again
            return
        connection = self._server.connect(address, self._clock.now(), secure=secure)
        peer = Peer(made, connection)
        self._peers.append(peer)
        if secure and self._server.tls is not None:
            self._wall.keep(peer.secure, self._server.tls, of=peer, ends=self._close)
        self._wall.keep(self._watch, peer, of=peer, ends=self._close)

    def _accept_tls(self, listener: socket.socket) -> None:
        self._accept(listener, secure=True)

    def _hear(self, peer: Peer) -> None:
        if peer.state is State.HANDSHAKING:
            if not self._shakes:
                return
            self._shakes -= 1
        try:
            data = peer.hear()
        except OSError:
            self._drop(peer)
            return
        if data and peer.state is State.OPEN:
            self._server.receive(peer.connection, data, self._clock.now())
        if data == b"" or peer.has_ended:
            self._drop(peer)

    def _flush(self, peer: Peer) -> None:
        try:
            peer.send()
        except OSError:
            self._drop(peer)
            return
        if peer.connection.ends:
            self._end(peer)

    def _watch(self, peer: Peer) -> None:
        """Wait for the events that a connection wants."""
        events = peer.wanted
        if events == peer.events:
            return
        if not peer.events:
            self._selector.register(peer.socket, events, peer)
        elif not events:
            self._selector.unregister(peer.socket)
        else:
            self._selector.modify(peer.socket, events, peer)
        peer.events = events

    def _end(self, peer: Peer) -> None:
        """Close a connection so that its tester can take what was sent last, as an answer that says why."""
        self._peers.remove(peer)
        self._lingering.append(peer)
        self._server.disconnect(peer.connection)
        try:
            peer.linger(self._now_s)
        except OSError:
            self._close(peer)
        self._watch(peer)
        if len(self._lingering) > LINGERING:
            self._close(self._lingering[0])

    def _drop(self, peer: Peer) -> None:
        """Forget a connection that has failed, or whose tester has gone; it gets the alert of TLS, if there is one."""
        if peer.is_served:
            with suppress(OSError):
                peer.send()
        self._close(peer)

    def _close(self, peer: Peer) -> None:
        """Forget a connection, whatever is wrong with it."""
        peer.state = State.CLOSED
        for known in (self._peers, self._lingering):
            if peer in known:
                known.remove(peer)
        if peer.connection in self._server.connections:
            self._wall.keep(self._server.disconnect, peer.connection, of=peer)
        self._wall.keep(self._watch, peer, of=peer)
        self._wall.keep(peer.socket.close, of=peer)


def _server_of(gateway: Gateway) -> DoipServer | None:
    return next((server for server in gateway.servers.all if isinstance(server, DoipServer)), None)
