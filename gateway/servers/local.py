"""Testers of this machine, by the status socket: a session each, and the routes of testers by DoIP.

They have the services, rules, trace and firewall of testers on a bus. A tester ends with the reader that it came by.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from gateway.bus.frames import Frames, empty
from gateway.common.budget import Budget
from gateway.common.times import NEVER
from gateway.faults.entries import DtcChange
from gateway.servers.bus_server import BusServer
from gateway.servers.lines import Lines
from gateway.servers.route import LONGEST_REQUEST, Route
from gateway.servers.uds.nrc import Nrc
from gateway.servers.uds.server import UdsServer
from gateway_fdi.errors import InputError, nearest

#: Name of the gateway itself among the ECUs.
SELF = "self"
#: Testers of a reader at a time, and requests of a tester that may wait.
MOST_TESTERS, MOST_WAITING = 32, 8
#: Longest answer [byte].
LONGEST_ANSWER = 65535

#: Takes the last answers to a request, in order; none where it is to stay silent.
Done = Callable[[Sequence[bytes]], None]
#: Takes an answer that comes by itself: number of the reader, name of the tester.
Push = Callable[[int, str, bytes], None]


class _Asked(NamedTuple):
    """A request that waits."""

    ecu: str
    request: bytes
    done: Done


@dataclass
class _Tester:
    """A tester, and ``open``: whom the answer is for that the server has promised."""

    reader: int
    name: str
    server: UdsServer
    waiting: deque[_Asked] = field(default_factory=deque)
    open: _Asked | None = None

    def __str__(self) -> str:
        return f"reader {self.reader}, tester {self.name}"

    @property
    def is_idle(self) -> bool:
        """Whether nothing of it lasts."""
        return not self.waiting and self.server.next_ns == NEVER


class LocalServer(BusServer):
    """The testers of all readers.

    Args:
        new_tester: makes the session of a tester: takes the name of its transport, and a source address.

    Attributes:
        routes: to ECUs, by their names.
        counts: what it counted.
        push: takes answers that come by themselves.
    """

    normal = False
    prompt = True
    door = "status"

    def __init__(self, new_tester: Callable[[str, int], UdsServer]) -> None:
        self._new_tester = new_tester
        self.routes: dict[str, Route] = {}
        self.counts: Counter[str] = Counter()
        self.push: Push = lambda reader, tester, answer: None
        self._testers: dict[tuple[int, str], _Tester] = {}
        self._now_ns = 0
        self._budget, self._first = Budget(), 0

    def connect_routes(self, lines: Lines, wake: Callable[[], None]) -> None:
        """Take the lines to all ECUs; the last server does, as the lines have the rates of the routes then."""
        self.routes = {name: Route(lines.line(name), self.counts) for name in lines.askable}

    def identifiers(self, bus: int) -> list[int]:
        """Return that it listens to nothing on a bus."""
        return []

    def ask(self, reader: int, who: str, tester: str, asked: tuple[str, bytes], done: Done) -> None:
        """Take a request, which is answered when time passes next, or when the ECU has answered.

        Args:
            reader: number of the reader.
            who: user and process of the reader, for people.
            tester: its name, of the reader's own.
            asked: name of the ECU, and the request.
            done: takes the answers.

        Raises:
            InputError: there is no such ECU, the request is too long, or too many wait.
        """
        ecu, request = asked
        if ecu != SELF and ecu not in self.routes:
            text = f'"{SELF}" or an [[ecu]] that may be asked: {", ".join(self.routes) or "none"}'
            raise InputError(f"{text}{nearest(ecu, self.routes)}", key="ecu", value=ecu)
        if not 1 <= len(request) <= LONGEST_REQUEST:
            raise InputError(f"1 to {LONGEST_REQUEST} bytes", key="uds", value=f"{len(request)} bytes")
        one = self._tester(reader, who, tester)
        if len(one.waiting) >= MOST_WAITING:
            raise InputError(f"{MOST_WAITING} requests of this tester wait", key="tester", value=tester)
        one.waiting.append(_Asked(ecu, request, done))
        self.counts["local_requests"] += 1

    def _tester(self, reader: int, who: str, name: str) -> _Tester:
        known = self._testers.get((reader, name))
        if known is not None:
            return known
        mine = [each for each in self._testers.values() if each.reader == reader]
        if len(mine) >= MOST_TESTERS:
            idle = next((each for each in mine if each.is_idle), None)
            if idle is None:
                raise InputError(f"{MOST_TESTERS} testers have sessions", key="tester", value=name)
            self._end(idle)
        made = self._testers[reader, name] = _Tester(reader, name, self._new_tester(f"local {name} ({who})", 0))
        return made

    def leave(self, reader: int) -> None:
        """End the sessions of a reader that has gone, or of whose gateway the settings are others now."""
        for each in [each for each in self._testers.values() if each.reader == reader]:
            self._end(each)

    def _end(self, one: _Tester) -> None:
        del self._testers[one.reader, one.name]
        one.waiting.clear()
        self.wall.keep(one.server.leave, of=one)
        for route in self.routes.values():
            self.wall.keep(route.line.forget, one.server, of=one)

    def _fail(self, one: _Tester) -> None:
        """End a tester whose work raised; its requests are rejected."""
        waits = [*([] if one.open is None else [one.open]), *one.waiting]
        self._end(one)
        for asked in waits:
            asked.done([bytes([0x7F, asked.request[0], Nrc.GENERAL_REJECT])])

    def succeed(self, old: BusServer, buses: Mapping[int, int]) -> None:
        """Have requests asked again (0x21) that the configuration before did not answer; its sessions are over."""
        for one in old._testers.values() if isinstance(old, LocalServer) else ():
            for asked in (*one.waiting, *([] if one.open is None else [one.open])):
                asked.done([bytes([0x7F, asked.request[0], Nrc.BUSY])])
        if isinstance(old, LocalServer):
            self.counts.update(old.counts)
            self._now_ns, old._testers = old._now_ns, {}

    def on_time(self, t_ns: int) -> Frames:
        """Answer what waits, and let sessions end."""
        self._now_ns = max(self._now_ns, t_ns)  # that of the monitors lags
        self._budget.begin()
        testers = list(self._testers.values())
        self._first = (self._first + 1) % max(len(testers), 1)  # each is first in turn: none waits for ever
        for one in [*testers[self._first :], *testers[: self._first]]:
            self.wall.keep(self._pass_time, one, of=one, ends=self._fail)
        return empty(0)

    def _pass_time(self, one: _Tester) -> None:
        self._take(one, one.server.pass_time(self._now_ns))
        while one.waiting and one.open is None and not self._budget.over:
            self._answer(one, one.waiting.popleft())

    def _take(self, one: _Tester, answers: Sequence[bytes]) -> None:
        """Give answers that come later, or by themselves, to whom they are for."""
        if one.open is not None and answers:
            asked, one.open = one.open, None
            asked.done(answers)
            return
        for answer in answers:
            self.push(one.reader, one.name, answer)

    def _answer(self, one: _Tester, asked: _Asked) -> None:
        if asked.ecu == SELF:
            answers = self.answered(one.server, asked.request, False, self._now_ns)
            if answers and is_pending(answers[-1]):
                one.open = asked
            else:
                asked.done(answers)
            return
        waits = True

        def send_answer(answer: bytes) -> None:
            nonlocal waits
            if is_pending(answer):
                return
            if waits:
                asked.done([answer])
            else:
                self.push(one.reader, one.name, answer)
            waits = False

        route = self.routes[asked.ecu]
        route.pass_on(asked.request, one.server, self._now_ns, send_answer)
        if waits and route.is_quiet(asked.request):
            waits = False
            asked.done([])

    def on_changes(self, changes: Sequence[DtcChange], t_ns: int) -> Frames:
        """Push the responses that testers asked for on changes (0x86)."""
        self._now_ns = max(self._now_ns, t_ns)
        for one in list(self._testers.values()):
            self.wall.keep(self._report_changes, one, changes, of=one, ends=self._fail)
        return empty(0)

    def _report_changes(self, one: _Tester, changes: Sequence[DtcChange]) -> None:
        for answer in one.server.on_changes(changes, self._now_ns):
            self.push(one.reader, one.name, answer)

    @property
    def next_ns(self) -> int:
        """Time of the next end of a session; the past, where a request waits."""
        return min((0 if one.waiting else one.server.next_ns for one in self._testers.values()), default=NEVER)

    def counters(self) -> dict[str, int]:
        """Return what it counted."""
        return dict(self.counts)


def is_pending(answer: bytes) -> bool:
    """Return whether an answer says that another one comes (0x78)."""
    return answer[0] == 0x7F and answer[2:3] == bytes([Nrc.RESPONSE_PENDING])
