"""The DoIP entity: routing activation, alive checks and diagnostic messages (ISO 13400-2:2019, clauses 8, 9 and 12).

It has no sockets: :mod:`gateway_testers.doip.door` brings what comes and takes what is to be sent.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

from gateway.bus.frames import Frames, empty
from gateway.common.budget import Budget
from gateway.common.times import NEVER
from gateway.faults.entries import DtcChange
from gateway.servers.bus_server import BusServer
from gateway.servers.lines import Lines
from gateway.servers.route import LONGEST_REQUEST, Route, is_answered
from gateway.servers.uds.nrc import Nrc
from gateway.servers.uds.server import UdsServer
from gateway_fdi.common.log import get_logger
from gateway_testers.doip.codec import CLOSING, Activation, Kind, Message, Nack, Refused, Splitter
from gateway_testers.doip.connection import MOST_BYTES, Connection
from gateway_testers.doip.identity import Identity
from gateway_testers.doip.params import ADDRESSES, DoipParams

if TYPE_CHECKING:
    from ssl import SSLContext

#: Timers of ISO 13400-2, Table 42 [ns]: until activation, without messages, for the answer to an alive check.
INITIAL_NS, GENERAL_NS, ALIVE_NS = 2_000_000_000, 300_000_000_000, 500_000_000
#: Connections without activation at a time; of more the oldest one gives way of the address that has most of them.
UNACTIVATED = 16
#: Messages of one connection in one turn of the loop.
MOST_IN_A_TURN = 16
#: Activation types: default, and by regulation.
TYPES = (0x00, 0x01)

log = get_logger(__name__)

#: Makes a tester's own session: takes the name of its transport, and its source address.
NewTester = Callable[[str, int], UdsServer]


class DoipServer(BusServer):
    """Testers that come by IP.

    Args:
        params: its settings.
        new_tester: makes the session of a tester.
        identity: answers datagrams.
        tls: of its TLS port; None: it has none.

    Attributes:
        connections: those that are open.
        routes: to ECUs, by their logical addresses.
        counts: what it counted.
    """

    normal = False
    prompt = True
    door = "doip"

    def __init__(
        self, params: DoipParams, new_tester: NewTester, identity: Identity, tls: SSLContext | None = None
    ) -> None:
        self.params, self.identity, self.tls = params, identity, tls
        self._new_tester = new_tester
        self.routes: dict[int, Route] = {}
        self.connections: list[Connection] = []
        self._own = params.address.to_bytes(2, "big")
        self.counts: Counter[str] = Counter()
        self._now_ns = 0
        self._budget, self._first = Budget(), 0

    def connect_routes(self, lines: Lines, wake: Callable[[], None]) -> None:
        """Take the lines to the ECUs of its routes."""
        self.routes = {
            each.address: Route(lines.line(each.ecu, each.requests_per_s), self.counts) for each in self.params.route
        }

    # Connections

    def identifiers(self, bus: int) -> list[int]:
        """Return that it listens to nothing on a bus."""
        return []

    def connect(self, peer: str, t_ns: int, *, secure: bool = False) -> Connection:
        """Take a connection."""
        waiting = [each for each in self.connections if each.source is None and not each.ends]
        if len(waiting) >= UNACTIVATED:
            self._count("displaced")
            held = Counter(each.peer for each in waiting)
            self._end(max(waiting, key=lambda each: held[each.peer]))  # the first of equals is the oldest
        made = Connection(peer, secure, t_ns, Splitter(self.params.most_bytes, self._room))
        self.connections.append(made)
        self._count("connections")
        return made

    def disconnect(self, gone: Connection) -> None:
        """Forget a connection that is closed."""
        try:
            self._end(gone)
        finally:
            self.connections.remove(gone)

    def succeed(self, old: BusServer, buses: Mapping[int, int]) -> None:
        """Take it that the sessions of the configuration before are over; :meth:`adopt` begins them again."""
        for each in old.connections if isinstance(old, DoipServer) else ():
            each.server = None

    def adopt(self, old: DoipServer) -> None:
        """Go on with the connections of the configuration before; testers find the default session.

        With other settings they are ended: an address that was right may not be so now.
        """
        self.counts.update(old.counts)
        self._now_ns = old._now_ns
        self.connections, old.connections = old.connections, []
        for each in self.connections:
            each.splitter.room = self._room
            if self.params != old.params:
                self._end(each)
            elif each.source is not None:
                each.server = self._new_tester(each.name, each.source)

    @property
    def active(self) -> list[Connection]:
        """Connections whose routing is activated."""
        return [each for each in self.connections if each.source is not None and not each.ends]

    def _room(self) -> int:
        """Return the bytes that there is room for, of all unfinished messages that are long."""
        return 2 * self.params.most_bytes - sum(each.splitter.claimed for each in self.connections)

    def _count(self, name: str) -> None:
        self.counts[f"doip_{name}"] += 1

    def counters(self) -> dict[str, int]:
        """Return what it counted."""
        return dict(self.counts)

    def _end(self, one: Connection) -> None:
        """Have a connection closed; the session of its tester is over, and those that waited for its place have it."""
        if one.ends:
            return
        one.ends, one.asks, one.more, one.check_ends_ns = True, None, False, None
        one.rivals.clear()
        server, one.server = one.server, None
        if server is not None:
            self.wall.keep(server.leave, of=one)
        for route in self.routes.values():
            self.wall.keep(route.line.forget, one, of=one)
        for other in self.connections:
            if one in other.rivals and other.asks is not None:
                other.rivals.clear()
                self.wall.keep(self._take_place, other, of=other, ends=self._end)

    def _take_place(self, other: Connection) -> None:
        """Activate a connection that has waited for a place."""
        asked, other.asks = other.asks, None
        assert asked is not None
        self._activate(other, asked)
        other.more = not other.ends

    # Messages

    def receive(self, one: Connection, data: bytes, t_ns: int) -> None:
        """Take bytes of a connection."""
        self._now_ns = max(self._now_ns, t_ns)
        if not one.ends:
            one.splitter.put(data)
            self._budget.begin()
            self._go_on(one)

    def _go_on(self, one: Connection) -> None:
        """Take the messages that have come, at most some of them, one at least."""
        one.more = False
        for k in range(MOST_IN_A_TURN):
            if one.stuck or one.asks is not None or (k and self._budget.over):
                break
            found = one.splitter.take()
            if found is None:
                return
            if one.source is not None:  # else it has its time from the start on, whatever it says
                one.heard_ns = self._now_ns
            if isinstance(found, Refused):
                self._count("header_refused")
                one.version = found.version
                one.put(Kind.NACK, bytes([found.code]))
                if found.code in CLOSING:
                    self._end(one)
            else:
                one.version = found.version
                self._take(one, found)
            if one.ends:
                return
        one.more = one.asks is None

    def _take(self, one: Connection, message: Message) -> None:
        match message.kind:
            case Kind.ACTIVATE:
                self._activate(one, message)
            case Kind.DIAGNOSTIC:
                self._diagnose(one, message.body)
            case Kind.ALIVE_REQUEST:
                one.put(Kind.ALIVE, self._own)
            case Kind.ALIVE if one.source is not None and message.body == one.source.to_bytes(2, "big"):
                self._is_alive(one)
            case _:
                self._count("passed_over")

    # Routing activation

    def _activate(self, one: Connection, message: Message) -> None:
        source, kind = int.from_bytes(message.body[:2], "big"), message.body[2]
        code = self._denial(one, source, kind)
        if code is None:
            one.asks = message
            return
        self._answer_activation(one, source, code)

    def _answer_activation(self, one: Connection, source: int, code: Activation) -> None:
        one.put(Kind.ACTIVATED, source.to_bytes(2, "big") + self._own + bytes([code]) + bytes(4))
        if code == Activation.DONE:
            if one.source is None:
                one.source, one.server = source, self._new_tester(one.name, source)
                one.heard_ns = self._now_ns
                self._count("activated")
            return
        self._count("activation_denied")
        times = self.counts["doip_activation_denied"]
        if not times & (times - 1):  # the 1st, 2nd, 4th, ...: nobody fills the log
            told = {"tester": one.name, "source": f"0x{source:04X}", "reason": code.name, "times": times}
            log.warning("DoIP: routing is not activated", **told)
        if code != Activation.AUTHENTICATION:  # it may come again with a certificate
            self._end(one)

    def _denial(self, one: Connection, source: int, kind: int) -> Activation | None:
        """Return the code of the response; None: alive checks of others are to say.

        The certificate is looked at before any other connection is asked to give way: no stranger has one closed.
        """
        entry, tls = self.params.tester_of(source), self.params.tls
        if entry is None:
            return Activation.UNKNOWN_SOURCE
        if kind not in TYPES:
            return Activation.UNSUPPORTED_TYPE
        if tls is not None and tls.required and not one.secure:
            return Activation.TLS_REQUIRED
        if one.source not in (None, source):
            return Activation.OTHER_SOURCE
        if entry.certificate is not None and entry.certificate != one.certificate:
            return Activation.AUTHENTICATION
        if one.source is not None:
            return Activation.DONE
        active = self.active
        rivals = [each for each in active if each.source == source]
        if not rivals and len(active) >= self.params.connections:
            rivals = active
        for rival in rivals:
            if rival.check_ends_ns is None:
                rival.check_ends_ns = self._now_ns + ALIVE_NS
                rival.put(Kind.ALIVE_REQUEST, b"")
        one.rivals = set(rivals)
        return None if rivals else Activation.DONE

    def _is_alive(self, one: Connection) -> None:
        """Take the answer to an alive check: it keeps its place."""
        one.check_ends_ns = None
        for other in self.connections:
            if one not in other.rivals or other.asks is None:
                continue
            other.rivals.discard(one)
            if not other.rivals:
                source = int.from_bytes(other.asks.body[:2], "big")
                same = one.source == source
                other.asks = None
                self._answer_activation(other, source, Activation.ACTIVE_ELSEWHERE if same else Activation.ALL_SOCKETS)

    # Diagnostic messages

    def _diagnose(self, one: Connection, body: bytes) -> None:
        source, target = int.from_bytes(body[:2], "big"), int.from_bytes(body[2:4], "big")
        request = body[ADDRESSES:]
        if one.source is None or one.source != source:
            self._refuse(one, body, Nack.INVALID_SOURCE)
            self._end(one)
            return
        route, functional = self.routes.get(target), target == self.params.functional
        obstacle = None
        if route is None and target != self.params.address and not functional:
            obstacle = Nack.UNKNOWN_TARGET
        elif len(request) > LONGEST_REQUEST:
            obstacle = Nack.TOO_LARGE
        elif route is not None and not route.line.is_open:
            obstacle = Nack.UNREACHABLE
        if obstacle is not None:
            self._refuse(one, body, obstacle)
            return
        assert one.server is not None
        if route is not None:
            self._pass_on(one, target, body)
            return
        self._acknowledge(one, body)
        for each in self.routes if functional else ():  # judged before our own server changes its session
            self._pass_on(one, each, body, functional=True)
        self._answer(one, self.answered(one.server, request, functional, self._now_ns))

    def _acknowledge(self, one: Connection, body: bytes) -> None:
        self._count("requests")
        one.put(Kind.DIAGNOSTIC_ACK, body[2:4] + body[:2] + b"\x00")

    def _pass_on(self, one: Connection, target: int, body: bytes, *, functional: bool = False) -> None:
        """Pass a request on to an ECU, if it may; of a functional one only the answers are told."""
        request, route = body[ADDRESSES:], self.routes[target]
        if functional and not route.line.is_open:
            self.counts["routes_skipped"] += 1
            return
        assert one.server is not None
        refusal = route.refusal(request, one.server, self._now_ns)

        def send_answer(answer: bytes | None) -> None:
            if one.ends:
                self._count("routes_without_tester")
            elif answer is not None:
                much = len(answer) > self.params.most_bytes - ADDRESSES
                self._answer(one, [bytes([0x7F, request[0], Nrc.RESPONSE_TOO_LONG]) if much else answer], target)

        taken = bool(refusal) or route.ask(request, one, send_answer, functional=functional)
        if not functional and not taken:
            self._refuse(one, body, Nack.OUT_OF_MEMORY)
            return
        if not functional:
            self._acknowledge(one, body)
        if refusal and is_answered(refusal, functional):
            send_answer(refusal)

    def _refuse(self, one: Connection, body: bytes, code: Nack) -> None:
        self._count("requests_refused")
        one.put(Kind.DIAGNOSTIC_NACK, body[2:4] + body[:2] + bytes([code]))

    def _answer(self, one: Connection, answers: Iterable[bytes], sender: int | None = None) -> None:
        """Send answers of the gateway, or of another ECU."""
        own = self._own if sender is None else sender.to_bytes(2, "big")
        for answer in answers:
            assert one.source is not None
            one.put(Kind.DIAGNOSTIC, own + one.source.to_bytes(2, "big") + answer)
            one.heard_ns = self._now_ns
        if len(one.out) > MOST_BYTES:
            self._count("sent_away")
            log.warning("DoIP: a tester does not take its answers, sent away", tester=one.name)
            one.out.clear()
            self._end(one)

    # Time

    def on_changes(self, changes: Sequence[DtcChange], t_ns: int) -> Frames:
        """Send the responses that testers asked for on changes (0x86)."""
        self._now_ns = max(self._now_ns, t_ns)
        for each in self.active:
            self.wall.keep(self._report_changes, each, changes, t_ns, of=each, ends=self._end)
        return empty(0)

    def _report_changes(self, one: Connection, changes: Sequence[DtcChange], t_ns: int) -> None:
        if one.server is not None:
            self._answer(one, one.server.on_changes(changes, t_ns))

    def on_time(self, t_ns: int) -> Frames:
        """Go on with messages that wait, send answers that come later, and close what has been silent for too long."""
        self._now_ns = max(self._now_ns, t_ns)  # that of the monitors lags
        self._budget.begin()
        self._first = (self._first + 1) % max(len(self.connections), 1)  # each is first in turn: none waits for ever
        for each in [*self.connections[self._first :], *self.connections[: self._first]]:
            self.wall.keep(self._pass_time, each, t_ns, of=each, ends=self._end)
        return empty(0)

    def _pass_time(self, one: Connection, t_ns: int) -> None:
        if one.server is not None:
            self._answer(one, one.server.pass_time(t_ns))
        if one.more and not one.stuck and not self._budget.over:
            self._go_on(one)
        if self._due_ns(one) <= t_ns and (one.stuck or not one.more):
            self._count("silent")
            self._end(one)

    def _due_ns(self, one: Connection) -> int:
        """Return when a connection is closed if nothing comes."""
        if one.ends:
            return NEVER
        if one.asks is not None:  # it waits for us
            return NEVER
        due = one.heard_ns + (INITIAL_NS if one.source is None else GENERAL_NS)
        return due if one.check_ends_ns is None else min(due, one.check_ends_ns)

    @property
    def next_ns(self) -> int:
        """When the first connection or session has something to do."""
        due = NEVER
        for each in self.connections:
            if each.more and not each.stuck:
                return 0
            due = min(due, self._due_ns(each), NEVER if each.server is None else each.server.next_ns)
        return due
