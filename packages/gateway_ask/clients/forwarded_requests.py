"""Requests of testers that a route passes on to an ECU: one queue an ECU, beside its schedule.

A request goes to the ECU when nothing else of it is under way, and the schedule does not use its turn. Answers go back
to the tester that asked, 0x78 and refusals, too; answers of the ECU to others do not.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

from gateway_ask.clients.refusals import BUSY

#: Services whose first parameter is a sub-function (ISO 14229-1, Table 2), its highest bit: no answer, if it is good.
SUB_FUNCTIONS = frozenset({0x10, 0x11, 0x19, 0x27, 0x28, 0x29, 0x2C, 0x31, 0x3E, 0x83, 0x85, 0x86, 0x87})
#: Services that answer with the identifier that was asked for first.
IDENTIFIERS = frozenset({0x22, 0x24, 0x2A, 0x2E, 0x2F})
#: Requests that wait for an ECU: of one tester, and of all.
MOST_OF_A_TESTER, MOST_WAITING = 8, 32

#: Takes an answer; None: there is none any more.
Done = Callable[[bytes | None], None]


def is_quiet(request: bytes) -> bool:
    """Return whether no good answer comes to a request."""
    return request[0] in SUB_FUNCTIONS and len(request) > 1 and bool(request[1] & 0x80)


@dataclass(eq=False)
class ForwardedRequests:
    """One request.

    Attributes:
        request: its bytes.
        owner: the tester.
        done: takes each answer; after the last one it is not called again.
    """

    request: bytes
    owner: object
    done: Done

    def send_back(self) -> None:
        """Have the tester ask again, later (0x21)."""
        self.done(bytes([0x7F, self.request[0], BUSY]))

    @property
    def is_quiet(self) -> bool:
        """Whether no good answer comes."""
        return is_quiet(self.request)

    def is_answered_by(self, answer: bytes) -> bool:
        """Return whether an answer can be to this request, by the service and what it repeats of it."""
        request = self.request
        if answer[0] == 0x7F:
            return len(answer) > 2 and answer[1] == request[0]
        if answer[0] != (request[0] + 0x40) & 0xFF:
            return False
        if request[0] in SUB_FUNCTIONS and len(request) > 1:
            return answer[1:2] == bytes([request[1] & 0x7F])
        return request[0] not in IDENTIFIERS or answer[1:3] == request[1:3]


@dataclass
class Waiting:
    """Requests that wait for one ECU.

    Args:
        apart_ns: least time between two [ns].

    Attributes:
        passed: the requests, the first is the next.
        next_ns: when the next one may go.
    """

    apart_ns: int = 0
    passed: deque[ForwardedRequests] = field(default_factory=deque)
    next_ns: int = 0

    def put(self, one: ForwardedRequests) -> bool:
        """Take a request; returns whether there is room."""
        own = sum(each.owner is one.owner for each in self.passed)
        if own >= MOST_OF_A_TESTER or len(self.passed) >= MOST_WAITING:
            return False
        self.passed.append(one)
        return True

    def take(self, t_ns: int) -> ForwardedRequests:
        """Return the next request."""
        self.next_ns = t_ns + self.apart_ns
        return self.passed.popleft()

    def give_up(self) -> None:
        """Tell all that no answer comes."""
        passed, self.passed = self.passed, deque()
        for each in passed:
            each.done(None)

    def forget(self, owner: object) -> None:
        """Take out what a tester that has gone had asked."""
        self.passed = deque(each for each in self.passed if each.owner is not owner)
