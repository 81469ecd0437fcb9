"""The UDS server: a request's way through the checks of ISO 14229-1 (7.5, 8.7) to its service's handler."""

from __future__ import annotations

from collections.abc import Sequence

from gateway.common.times import NEVER
from gateway.faults.entries import DtcChange
from gateway.faults.interventions import DONE
from gateway.servers.access import ROUTE
from gateway.servers.application import Application
from gateway.servers.authority import WATCH_NS
from gateway.servers.uds.context import DEFAULT, Context, Later, Service
from gateway.servers.uds.nrc import SILENT_WHEN_FUNCTIONAL, NegativeError, Nrc, refuse_unless
from gateway.servers.uds.services import SERVICES
from gateway.servers.uds.services.x86_response_on_event import responses_to

#: Refusals that say that a tester may not, or not now; others are of requests that make no sense.
TRACED = frozenset(
    {
        Nrc.SERVICE_NOT_SUPPORTED_IN_SESSION,
        Nrc.SECURITY_ACCESS_DENIED,
        Nrc.AUTHENTICATION_REQUIRED,
        *(Nrc(number) for number in Nrc if 0x50 <= number <= 0x58),
        Nrc.INVALID_KEY,
        Nrc.EXCEEDED_NUMBER_OF_ATTEMPTS,
        Nrc.REQUIRED_TIME_DELAY_NOT_EXPIRED,
        Nrc.CONDITIONS_NOT_CORRECT,
        Nrc.GENERAL_PROGRAMMING_FAILURE,
    }
)


def _negative(sid: int, nrc: Nrc) -> bytes:
    return bytes([0x7F, sid, nrc])


class UdsServer(Application):
    """Answers requests; knows sessions and their end, and answers that come later or by themselves."""

    def __init__(self, context: Context) -> None:
        self.context = context
        self._later: tuple[Service, bytes, Later] | None = None
        self._last_request_ns = 0
        self._watched_ns = 0
        self._busy = False

    def answer(self, request: bytes, functional: bool, t_ns: int) -> list[bytes]:
        """Return the responses to a request: none, one, or 0x78 with the final one to come.

        Args:
            request: with its service identifier, not empty.
            functional: whether it was meant for every server.
            t_ns: now.
        """
        # The rest of the last request's answer comes before the answer to this one.
        return self.pass_time(t_ns) + self._answer(request, functional, t_ns)

    def pending(self, request: bytes) -> list[bytes]:
        """Return 0x78, but where the answer may be suppressed: after 0x78 it must not be."""
        service = SERVICES.get(request[0])
        if service is not None and service.sub_functions is not None and len(request) > 1 and request[1] & 0x80:
            return []
        return [_negative(request[0], Nrc.RESPONSE_PENDING)]

    def _answer(self, request: bytes, functional: bool, t_ns: int) -> list[bytes]:
        c = self.context
        c.now_ns = self._last_request_ns = t_ns
        for attempts in (*c.security.attempts, *c.authentication.attempts):
            attempts.start(t_ns)
        c.asked_in = c.session, c.security.unlocked, c.authentication.role
        c.asked_by = (c.params.functional or 0) if functional else c.params.request
        sid = request[0]
        service = SERVICES.get(sid)
        try:
            if service is None or not service.offered(c):
                raise NegativeError(Nrc.SERVICE_NOT_SUPPORTED)
            found = self._serve(service, request)
        except NegativeError as error:
            if service is not None:
                self._note(service, request, error.nrc)
            if functional and error.nrc in SILENT_WHEN_FUNCTIONAL:
                return []
            return [_negative(sid, error.nrc)]
        if isinstance(found, Later):
            self._later = service, request, found
            return [_negative(sid, Nrc.RESPONSE_PENDING)]
        self._note(service, request, DONE)
        if service.sub_functions is not None and request[1] & 0x80:
            return []
        return [self._positive(sid, found)]

    def _serve(self, service: Service, request: bytes) -> bytes | Later:
        """Check a request in the standard's order, and let its service handle it."""
        c = self.context
        c.need = c.authority.need(service.action, undoing=service.undoes(request))
        in_session = c.session in service.sessions and not c.authority.session_refusal(c.need, c.asker)
        refuse_unless(in_session, Nrc.SERVICE_NOT_SUPPORTED_IN_SESSION)
        if service.sub_functions is not None:
            refuse_unless(len(request) >= 2, Nrc.INCORRECT_LENGTH)
            known = service.sub_functions(c)
            number = request[1] & 0x7F
            refuse_unless(number in known, Nrc.SUB_FUNCTION_NOT_SUPPORTED)
            refuse_unless(c.session in known[number], Nrc.SUB_FUNCTION_NOT_SUPPORTED_IN_SESSION)
        refuse_unless(len(request) >= service.shortest, Nrc.INCORRECT_LENGTH)
        refuse_unless(service.longest is None or len(request) <= service.longest, Nrc.INCORRECT_LENGTH)
        if not service.late:
            c.check_security()
        return service.handle(c, request)

    def passes(self, request: bytes, to: str, t_ns: int, by: int | None = None) -> int:
        """Judge and note a request to another ECU that does more than read; returns the refusal, 0: none.

        Args:
            request: its bytes.
            to: name of the ECU.
            t_ns: now.
            by: identifier that it came by; None: the tester's address.
        """
        c = self.context
        c.now_ns = max(c.now_ns, t_ns)
        self._end_session()
        c.asked_in = c.session, c.security.unlocked, c.authentication.role
        c.asked_by = c.params.request if by is None else by
        refusal = c.authority.refusal(ROUTE, c.asker)
        c.note(ROUTE, request, refusal, to=to)
        return refusal

    def leave(self) -> None:
        """End the session of a tester that has gone."""
        self._later = None
        self.context.leave()

    def _note(self, service: Service, request: bytes, outcome: int) -> None:
        """Keep what a request did, or was refused, if it would change anything."""
        c = self.context
        if service.traced(request) and (outcome == DONE or outcome in TRACED):
            c.note(service.action, request, outcome)
            if outcome == Nrc.EXCEEDED_NUMBER_OF_ATTEMPTS:
                c.note("lockout", request[:2], outcome)

    def _positive(self, sid: int, content: bytes) -> bytes:
        if 1 + len(content) > self.context.longest:
            return _negative(sid, Nrc.RESPONSE_TOO_LONG)
        return bytes([sid + 0x40]) + content

    def pass_time(self, t_ns: int) -> list[bytes]:
        """Let time pass; returns the answer that was still to come."""
        c = self.context
        c.now_ns = max(c.now_ns, t_ns)
        made: list[bytes] = []
        if self._later is not None:
            service, request, later = self._later
            self._later = None
            try:
                made.append(self._positive(service.sid, later.work()))
                self._note(service, request, DONE)
            except NegativeError as error:
                made.append(_negative(service.sid, error.nrc))
                self._note(service, request, error.nrc)
            self._last_request_ns = c.now_ns  # S3 starts with the final answer
        self._end_session()
        if c.holder.watches and c.now_ns >= self._watched_ns + WATCH_NS:
            self._watched_ns = c.now_ns
            c.holder.end_unmet()
        return made

    def _end_session(self) -> None:
        """End the session if S3 is over; it does not run while a message is under way."""
        c = self.context
        if c.session != DEFAULT and not self._busy and c.now_ns >= self._session_ends_ns:
            c.enter(DEFAULT)

    def hold(self, busy: bool, t_ns: int) -> None:
        """Stop S3 while a message is under way; it starts again when that is over (ISO 14229-2, 7.5)."""
        c = self.context
        c.now_ns = max(c.now_ns, t_ns)
        if busy and not self._busy:
            self._end_session()  # it may have been over before
        elif self._busy and not busy:
            self._last_request_ns = c.now_ns
        self._busy = busy

    @property
    def _session_ends_ns(self) -> int:
        return self._last_request_ns + self.context.params.s3_ms * 1_000_000

    @property
    def next_ns(self) -> int:
        """When it has something to do next."""
        if self._later is not None:
            return 0
        if self.context.session == DEFAULT:
            return NEVER
        ends = NEVER if self._busy else self._session_ends_ns
        return min(ends, self._watched_ns + WATCH_NS) if self.context.holder.watches else ends

    def on_changes(self, changes: Sequence[DtcChange], t_ns: int) -> list[bytes]:
        """Take changes of status bytes; returns the responses that were asked for on them (0x86)."""
        self.context.now_ns = max(self.context.now_ns, t_ns)
        made = []
        for request in responses_to(self.context, changes):
            service = SERVICES[request[0]]
            try:
                found = self._serve(service, request)
            except NegativeError as error:
                made.append(_negative(request[0], error.nrc))
                continue
            if isinstance(found, bytes):
                made.append(self._positive(request[0], found))
        return made
