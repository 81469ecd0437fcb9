"""Routes to ECUs behind the gateway, and what they let pass: reading; more by ``[access] route``."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

from gateway.servers.lines import Line
from gateway.servers.uds.nrc import SILENT_WHEN_FUNCTIONAL, Nrc
from gateway.servers.uds.server import UdsServer

#: Services that pass: of OBD all but clearing (04) and control (08); DTCs, data, tester present; of the sessions the
#: default one.
READING = frozenset({0x01, 0x02, 0x03, 0x06, 0x07, 0x09, 0x0A, 0x19, 0x22, 0x3E})
_DEFAULT_SESSION = (0x10, 0x01)
#: Longest request of a tester, to the gateway or by a route [byte].
LONGEST_REQUEST = 4095


def only_reads(request: bytes) -> bool:
    """Return whether a request passes without a rule."""
    if request[0] == _DEFAULT_SESSION[0]:
        return len(request) == 2 and request[1] & 0x7F == _DEFAULT_SESSION[1]
    return request[0] in READING


class Route:
    """A route."""

    def __init__(self, line: Line, counts: Counter[str]) -> None:
        self.line, self._counts = line, counts

    def _stamped(self, answer: bytes) -> bytes:
        """Return an answer with the route's part added to the times of its session (0x50: P2 in 1 ms, P2* in 10 ms)."""
        if answer[0] != 0x50 or len(answer) != 6:
            return answer
        p2, star = (int.from_bytes(answer[k : k + 2], "big") for k in (2, 4))
        p2, star = p2 + self.line.part_ms, star + -(-self.line.part_ms // 10)
        return answer[:2] + b"".join(min(each, 0xFFFF).to_bytes(2, "big") for each in (p2, star))

    def refusal(self, request: bytes, server: UdsServer, t_ns: int, by: int | None = None) -> bytes:
        """Return the negative response to a request that may not pass, which is noted; b"": it may.

        Args:
            request: its bytes.
            server: of the tester's session.
            t_ns: now.
            by: identifier that it came by; None: the tester's address.
        """
        code = 0 if only_reads(request) else server.passes(request, self.line.name, t_ns, by)
        self._counts["routes_refused"] += bool(code)
        return bytes([0x7F, request[0], code]) if code else b""

    def ask(
        self, request: bytes, owner: object, send_answer: Callable[[bytes | None], None], *, functional: bool
    ) -> bool:
        """Have a request sent that may pass; returns whether there is room for it.

        Args:
            request: at most LONGEST_REQUEST bytes.
            owner: the tester.
            send_answer: takes each answer that the tester is told; None: none comes.
            functional: whether it is to all ECUs.
        """

        def done(answer: bytes | None) -> None:
            self._counts["routes_without_answer"] += answer is None
            if answer is None or is_answered(answer, functional):
                send_answer(None if answer is None else self._stamped(answer))

        taken = self.line.ask(request, owner, done)
        self._counts["routed" if taken else "routes_skipped"] += 1
        return taken

    def pass_on(
        self,
        request: bytes,
        server: UdsServer,
        t_ns: int,
        send_answer: Callable[[bytes], None],
        *,
        functional: bool = False,
        by: int | None = None,
    ) -> None:
        """Pass a request on, if it may; an ECU that does not answer is named by the code, unless all were asked.

        Args:
            request: its bytes.
            server: of the tester's session.
            t_ns: now.
            send_answer: takes each answer: the ECU's, a refusal, 0x25 (no response), 0x21 (no room for it now).
            functional: whether it is to all ECUs.
            by: as of :meth:`refusal`.
        """

        def answered(answer: bytes | None) -> None:
            if answer is not None or not functional:
                send_answer(bytes([0x7F, request[0], Nrc.NO_RESPONSE_FROM_SUBNET]) if answer is None else answer)

        if not self.line.is_open:
            self._counts["routes_skipped"] += 1
            answered(None)
            return
        refusal = self.refusal(request, server, t_ns, by)
        if refusal:
            answered(refusal if is_answered(refusal, functional) else None)
        elif not self.ask(request, server, answered, functional=functional) and not functional:
            send_answer(bytes([0x7F, request[0], Nrc.BUSY]))

    def is_quiet(self, request: bytes) -> bool:
        """Return whether no good answer comes to a request."""
        return self.line.is_quiet(request)


def is_answered(answer: bytes, functional: bool) -> bool:
    """Return whether a tester is told an answer: refusals of those that were not meant are not, when all were asked."""
    return not (functional and answer[0] == 0x7F and len(answer) > 2 and answer[2] in SILENT_WHEN_FUNCTIONAL)
