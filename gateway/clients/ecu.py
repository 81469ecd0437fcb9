"""A client of one ECU: one request at a time, its answer, its refusal, or its silence."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from gateway.answers.weave import NEGATIVE, POSITIVE, READ_SERVICES
from gateway.bus.frames import EXTENDED, ID_MASK, Frames, empty, put
from gateway.clients.params import DTC_SERVICES, EcuParams
from gateway.clients.passed import Passed, Waiting
from gateway.clients.pgn import MARK, WAIT_MS, Ended, frame_of, pgn_of
from gateway.clients.refusals import BUSY, FINAL, PENDING, TOO_LONG
from gateway.common.times import NEVER
from gateway.isotp.endpoint import IsoTpEndpoint
from gateway.isotp.heard import N_CR_NS
from gateway.isotp.params import IsoTpParams
from gateway.isotp.place import EcuAddress
from gateway_fdi.common.log import get_logger

log = get_logger(__name__)

MS = 1_000_000
#: Rest after another tester was heard: his session may last that long (ISO 14229-2, S3) [ns].
YIELD_NS = 5_000 * MS
#: Time until a busy ECU is asked again [ns], and how often in a row before it is given up.
AGAIN_NS, MOST_AGAIN = 200 * MS, 10
#: Announcements (0x78) in a row that an ECU may give.
MOST_PENDING = 60
#: How often conditions that are not met are looked at again [ns].
UNMET_NS = 1_000 * MS
#: Absences in a row that make an ECU silent: it is asked once in 1 s, 2 s, 4 s ... then.
SILENT, FIRST_REST_NS, LONGEST_REST_NS = 3, 1_000 * MS, 60_000 * MS

#: Counters of each ECU. ``requests`` is the sum of all up to ``yielded``, and of the one under way.
#: ``passed`` are those of testers, ``passed_in_vain`` those of them without an answer.
COUNTED = ("requests", "answers", "refused", "absent", "yielded", "pending", "skipped", "passed", "passed_in_vain")


@dataclass
class Ask:
    """A request of the schedule.

    Attributes:
        request: its bytes, of a single frame.
        every_ns: time between two; NEVER: once.
        due_ns: when it is next.
        delays: refusals in a row, each of which doubled the time to the next.
        refused: reason why it is not asked any more; "": it is.
        ready: whether its conditions are met now.
    """

    request: bytes
    every_ns: int
    due_ns: int = 0
    delays: int = 0
    refused: str = ""
    ready: Callable[[], bool] = lambda: True

    @property
    def name(self) -> str:
        """Its bytes for people, or its parameter group."""
        return f"PGN {pgn_of(self.request)}" if self.request[0] == MARK else self.request.hex().upper()


def allowed(request: bytes) -> bool:
    """Return whether a request only reads: nothing else leaves a client."""
    return bool(request) and request[0] in (*READ_SERVICES, *DTC_SERVICES, MARK)


@dataclass
class EcuClient:
    """The client.

    Args:
        params: of the ECU.
        bus: index of its bus.
        asks: its schedule.

    Attributes:
        counts: by COUNTED.
        waiting: requests of testers.
        silent: absences in a row.
    """

    params: EcuParams
    bus: int
    asks: list[Ask]
    counts: dict[str, int] = field(default_factory=lambda: dict.fromkeys(COUNTED, 0))
    silent: int = 0
    waiting: Waiting = field(default_factory=Waiting)
    _asked: Ask | Passed | None = None
    _deadline_ns: int = NEVER
    _rests_ns: int = 0
    _pending: int = 0
    _again: int = 0
    _begun_ns: int = 0

    def __post_init__(self) -> None:
        self.place: EcuAddress = self.params.place
        self._sender = self._new_sender()

    def _new_sender(self) -> IsoTpEndpoint:
        """Return what sends requests of several frames."""
        request, response, target, tester = self.place
        long = bool(request & EXTENDED)
        params = IsoTpParams(request=response & ID_MASK, response=request & ID_MASK, functional=None, extended=long)
        return IsoTpEndpoint(params, self.bus, None if target is None or tester is None else (tester, target))

    @property
    def busy(self) -> bool:
        """Whether an answer is waited for."""
        return self._asked is not None

    @property
    def due_ns(self) -> int:
        """When its next request is due, or its answer overdue; NEVER: nothing is."""
        if self._asked is not None:
            sends_ns = self._sender.next_ns if self._sender.sending else NEVER
            return min(self._deadline_ns, sends_ns)
        return max(min((ask.due_ns for ask in self.asks if not ask.refused), default=NEVER), self._rests_ns)

    @property
    def request(self) -> bytes:
        """The request whose answer is waited for; empty: none is."""
        return b"" if self._asked is None else self._asked.request

    @property
    def urgency(self) -> tuple[int, int]:
        """Order of clients that are due: the most overdue first, of these the one whose last request is longest ago."""
        return self.due_ns, self._begun_ns

    def is_due(self, t_ns: int) -> bool:
        """Return whether it may ask now."""
        return self._asked is None and self.due_ns <= t_ns

    def postpone(self, t_ns: int) -> bool:
        """Put off requests that are due and whose conditions are not met; returns whether one is left."""
        for ask in self.asks:
            if not ask.refused and ask.due_ns <= t_ns and not ask.ready():
                ask.due_ns = t_ns + UNMET_NS
        return self.due_ns <= t_ns

    def begin(self, t_ns: int) -> Frames:
        """Return the request that is most overdue."""
        ask = min((each for each in self.asks if not each.refused), key=lambda each: each.due_ns)
        if not allowed(ask.request):
            raise AssertionError(f"{ask.name} would change something")
        ask.due_ns = ask.due_ns or t_ns
        group = ask.request[0] == MARK
        wait_ms = WAIT_MS if group else self.params.p2_ms
        self._asked, self._deadline_ns, self._pending = ask, t_ns + round(wait_ms * MS), 0
        self._begun_ns = t_ns
        self.counts["requests"] += 1
        if group:
            return frame_of(ask.request, self.params.address or 0, self.bus, t_ns)
        return self._frame(bytes([len(ask.request)]) + ask.request, t_ns)

    def passes(self, t_ns: int) -> bool:
        """Return whether a tester's request may go now."""
        return bool(self.waiting.passed) and self._asked is None and t_ns >= self.waiting.next_ns

    def pass_on(self, t_ns: int) -> Frames:
        """Return a tester's request, or its first frame."""
        one = self.waiting.take(t_ns)
        self._asked, self._deadline_ns, self._pending = one, t_ns + round(self.params.p2_ms * MS), 0
        self.counts["passed"] += 1
        if len(one.request) <= (7 if self.place.target is None else 6):
            return self._frame(bytes([len(one.request)]) + one.request, t_ns)
        self._sender.advance(t_ns)
        self._sender.send([one.request])
        self._deadline_ns += N_CR_NS
        return self._sender.take_frames()

    def on_flow_control(self, frame: np.void, t_ns: int) -> Frames:
        """Take the ECU's flow control of a request of several frames; returns the frames that follow."""
        if not self._sender.sending:
            return empty(0)
        self._sender.receive(frame, t_ns)
        return self._go_on(t_ns)

    def _go_on(self, t_ns: int) -> Frames:
        self._sender.advance(t_ns)
        self._sender.send([])
        self._deadline_ns = t_ns + round(self.params.p2_ms * MS) + (N_CR_NS if self._sender.sending else 0)
        return self._sender.take_frames()

    def _frame(self, data: bytes, t_ns: int) -> Frames:
        before = b"" if self.place.target is None else bytes([self.place.target])
        frame = empty(1)
        put(frame, 0, t_ns, self.place.request, (before + data).ljust(8, b"\xcc"), bus=self.bus)
        return frame

    def on_first_frame(self, t_ns: int) -> Frames:
        """Return the flow control that has the rest of an answer sent, if it is ours."""
        if self._asked is None:
            return empty(0)
        self._deadline_ns = t_ns + N_CR_NS
        return self._frame(bytes([0x30, 0, 0]), t_ns)

    def on_too_long(self, t_ns: int) -> Frames:
        """Return the flow control (overflow) that ends an answer, if it is ours; a tester that asked is told so."""
        one = self._asked
        if one is None:
            return empty(0)
        if isinstance(one, Passed):
            self._asked, self._deadline_ns = None, NEVER
            one.done(bytes([NEGATIVE, one.request[0], TOO_LONG]))
        return self._frame(bytes([0x32, 0, 0]), t_ns)

    def on_more(self, t_ns: int) -> Frames:
        """Note that an answer goes on; no frame is due for that."""
        if self._asked is not None:
            self._deadline_ns = max(self._deadline_ns, t_ns + N_CR_NS)
        return empty(0)

    def on_answer(self, answer: bytes, t_ns: int) -> None:
        """Take an answer of the ECU, to us or to others."""
        ask = self._asked
        if ask is None or not answer:
            return
        if isinstance(ask, Passed):
            self._pass_back(ask, answer, t_ns)
            return
        if answer[0] == NEGATIVE:
            if len(answer) > 2 and answer[1] == ask.request[0]:
                self._refused(ask, answer[2], t_ns)
            return
        echo = 1 if ask.request[0] in DTC_SERVICES else len(ask.request)
        if answer[0] != ask.request[0] + POSITIVE or answer[1:echo] != ask.request[1:echo]:
            return  # of another request, which was given up
        if ask.request[0] == 0x19 and answer[1:2] != ask.request[1:2]:
            return
        self._answered(ask, t_ns)

    def on_group(self, ended: Ended, t_ns: int) -> None:
        """Take a frame that may end the request for a parameter group."""
        ask = self._asked
        if not isinstance(ask, Ask) or ask.request != ended.request:
            return
        if ended.code:
            self._refused(ask, ended.code, t_ns)
        else:
            self._answered(ask, t_ns)

    def _answered(self, ask: Ask, t_ns: int) -> None:
        self.counts["answers"] += 1
        ask.delays = 0
        self._end(ask, t_ns, heard=True)

    def _pass_back(self, one: Passed, answer: bytes, t_ns: int) -> None:
        """Give a tester the answer to its request; 0x78 says that another one comes."""
        if not one.is_answered_by(answer):
            return
        if answer[0] == NEGATIVE and answer[2] == PENDING and self._pending < MOST_PENDING:
            self._pending += 1
            self.counts["pending"] += 1
            self._deadline_ns = t_ns + round(self.params.p2_star_ms * MS)
        else:
            self._asked, self._deadline_ns, self.silent, self._rests_ns = None, NEVER, 0, 0
        one.done(answer)

    def _refused(self, ask: Ask, code: int, t_ns: int) -> None:
        if code == PENDING:
            self.counts["pending"] += 1
            self._pending += 1
            if self._pending <= MOST_PENDING:
                self._deadline_ns = t_ns + round(self.params.p2_star_ms * MS)
                return
            self._absent(t_ns)
            return
        self.counts["refused"] += 1
        if code == BUSY and self._again < MOST_AGAIN:
            self._again += 1
            self._asked, self.silent, ask.due_ns = None, 0, t_ns + AGAIN_NS
            self._rests_ns = t_ns + AGAIN_NS
            return
        if code in FINAL:
            ask.refused = f"{FINAL[code]} (0x{code:02X})"
            self._tell(ask)
        else:
            ask.delays = min(ask.delays + 1, 16)
        self._end(ask, t_ns, heard=True)

    def _tell(self, ask: Ask) -> None:
        """Tell of a request that is not asked again."""
        name = self.params.name
        log.warning("an ECU refuses, and is not asked this again", ecu=name, request=ask.name, reason=ask.refused)

    def _end(self, ask: Ask, t_ns: int, *, heard: bool) -> None:
        """Put a request back into the schedule."""
        self._asked, self._deadline_ns, self._again = None, NEVER, 0
        if heard:
            self.silent, self._rests_ns = 0, 0
        if ask.every_ns == NEVER:
            self.asks.remove(ask)
            return
        late = max(t_ns - ask.due_ns, 0) // ask.every_ns
        self.counts["skipped"] += late
        ask.due_ns += (late + 1) * ask.every_ns
        if ask.delays:
            ask.due_ns += min(ask.every_ns << ask.delays, LONGEST_REST_NS)

    def on_time(self, t_ns: int) -> Frames:
        """Give up an answer that is overdue; returns the next frames of a request of several."""
        if self._asked is not None and t_ns >= self._deadline_ns:
            self._absent(t_ns)
        elif self._sender.sending and t_ns >= self._sender.next_ns:
            return self._go_on(t_ns)
        return empty(0)

    def _absent(self, t_ns: int) -> None:
        ask = self._asked
        assert ask is not None
        if isinstance(ask, Passed):
            self._asked, self._deadline_ns = None, NEVER
            if not ask.is_quiet:
                self.counts["passed_in_vain"] += 1
                ask.done(None)
            return
        self.counts["absent"] += 1
        self.silent += 1
        self._end(ask, t_ns, heard=False)
        if self.silent >= SILENT:
            rest_ns = min(FIRST_REST_NS << min(self.silent - SILENT, 16), LONGEST_REST_NS)
            self._rests_ns = t_ns + rest_ns

    def give_way(self, t_ns: int) -> None:
        """Rest: another tester asks this ECU, and two at once break each other's answers."""
        if isinstance(self._asked, Passed):
            one, self._asked, self._deadline_ns = self._asked, None, NEVER
            self._sender = self._new_sender()
            one.send_back()  # whose answer comes now cannot be told
        elif self._asked is not None:
            self.counts["yielded"] += 1
            ask, self._asked, self._deadline_ns = self._asked, None, NEVER
            ask.due_ns = t_ns
        self._rests_ns = max(self._rests_ns, t_ns + YIELD_NS)

    def restart(self, t_ns: int) -> None:
        """Give up what is under way, after an exception, and rest."""
        self._sender = self._new_sender()
        try:
            if self._asked is not None:
                self._absent(t_ns)
        finally:
            self._asked, self._deadline_ns = None, NEVER
            self._rests_ns = max(self._rests_ns, t_ns + FIRST_REST_NS)

    def succeed(self, old: EcuClient) -> None:
        """Go on where the client of the configuration before stops, if it is of the same ECU.

        Its request that is under way is counted as one that gave way: its answer is not waited for any more.
        """
        self.counts = dict(old.counts)
        if isinstance(old._asked, Ask):
            self.counts["yielded"] += 1
        for one in ([old._asked] if isinstance(old._asked, Passed) else []) + list(old.waiting.passed):
            one.send_back()
        self.silent, self._rests_ns = old.silent, max(old._rests_ns, old._deadline_ns if old.busy else 0)
        before = {ask.request: ask for ask in old.asks}
        for ask in self.asks:
            known = before.get(ask.request)
            if known is not None:
                ask.due_ns, ask.refused, ask.delays = known.due_ns, known.refused, known.delays


def asks_of(params: EcuParams) -> list[Ask]:
    """Return the schedule of an ECU's reads."""
    return [Ask(read.request, round(read.every_ms * MS)) for read in params.read]
