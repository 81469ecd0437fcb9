"""A client of one ECU: one request at a time, its answer, its refusal, or its silence."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain

import numpy as np

from gateway.bus.frames import BRS, EXTENDED, FD, ID_MASK, Frames, empty, put
from gateway.common.times import NEVER
from gateway.config.ecu import DTC, DTC_SERVICES, MARK, OBD, ON_UDS, EcuParams
from gateway.isotp.addressing import FUNCTIONAL, EcuAddress
from gateway.isotp.endpoint import IsoTpEndpoint
from gateway.isotp.params import IsoTpParams
from gateway_ask.answers.answer_frames import NEGATIVE, POSITIVE
from gateway_ask.clients.ask import PROBES, Ask, allowed, probe_forms, spoken_in
from gateway_ask.clients.forwarded_requests import ForwardedRequests, Waiting
from gateway_ask.clients.passive_reassembly import N_CR_NS
from gateway_ask.clients.pgn import WAIT_MS, Ended, frame_of
from gateway_ask.clients.refusals import BUSY, FINAL, PENDING, TOO_LONG, UNKNOWN
from gateway_fdi.common.log import get_logger

log = get_logger(__name__)

MS = 1_000_000
#: Rest after another tester was heard: his session may last that long (ISO 14229-2, S3) [ns].
YIELD_NS = 5_000 * MS
#: Time until a busy ECU is asked again [ns], and how often in a row before it is given up.
AGAIN_NS, MOST_AGAIN = 200 * MS, 10
#: Announcements (0x78) in a row that an ECU may give.
MOST_PENDING = 60
#: Absences in a row that make an ECU silent: it is asked once in 1 s, 2 s, 4 s ... then.
SILENT, FIRST_REST_NS, LONGEST_REST_NS = 3, 1_000 * MS, 60_000 * MS

#: Counters of each ECU. ``requests`` is the sum of all up to ``yielded``, and of the one under way.
#: ``passed`` are those of testers, ``passed_in_vain`` those of them without an answer.
COUNTED = ("requests", "answers", "refused", "absent", "yielded", "pending", "skipped", "passed", "passed_in_vain")


@dataclass
class EcuClient:
    """The client.

    Args:
        params: of the ECU.
        bus: index of its bus.
        asks: its schedule.
        open: further requests by the protocol of OBD that it speaks, where that is to be found.

    Attributes:
        speaks: protocol of OBD that it answers, as far as it is known; "": not.
        counts: by COUNTED.
        waiting: requests of testers.
        silent: absences in a row.
    """

    params: EcuParams
    bus: int
    asks: list[Ask]
    open: Mapping[str, Sequence[Ask]] = field(default_factory=dict)
    speaks: str = ""
    counts: dict[str, int] = field(default_factory=lambda: dict.fromkeys(COUNTED, 0))
    silent: int = 0
    waiting: Waiting = field(default_factory=Waiting)
    _asked: Ask | ForwardedRequests | None = None
    _deadline_ns: int = NEVER
    _rests_ns: int = 0
    _pending: int = 0
    _again: int = 0
    _begun_ns: int = 0
    _probed: int = 0
    _declined: dict[str, int] = field(default_factory=dict)
    _expected: str = ""
    _keep: Callable[[str], None] = lambda _protocol: None

    def __post_init__(self) -> None:
        self.place: EcuAddress = self.params.place
        self._sender = self._new_sender()
        if self.open:
            self._probe(0)

    def _new_sender(self) -> IsoTpEndpoint:
        """Return what sends requests of several frames."""
        request, response, target, tester = self.place
        long = bool(request & EXTENDED)
        params = IsoTpParams(
            request=response & ID_MASK, response=request & ID_MASK, functional=None, extended=long, fd=self.params.fd
        )
        return IsoTpEndpoint(params, self.bus, None if target is None or tester is None else (tester, target))

    @property
    def busy(self) -> bool:
        """Whether an answer is waited for."""
        return self._asked is not None

    @property
    def is_read(self) -> bool:
        """Whether the answer to a request of its schedule is waited for."""
        return isinstance(self._asked, Ask)

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
            if not ask.refused and ask.due_ns <= t_ns:
                ask.waits(t_ns)
        return self.due_ns <= t_ns

    def on_dtc(self, t_ns: int) -> None:
        """Note that a DTC came."""
        for ask in chain(self.asks, *self.open.values()):
            if ask.on == DTC:
                ask.come(t_ns)

    def begin(self, t_ns: int) -> Frames:
        """Return the request that is most overdue."""
        ask = self._next()
        if not allowed(ask.request):
            raise AssertionError(f"{ask.name} would change something")
        self._wait_for(ask, t_ns)
        if ask.request[0] == MARK:
            return frame_of(ask.request, self.params.address or 0, self.bus, t_ns)
        can_id = FUNCTIONAL[bool(self.place.request & EXTENDED)] if ask.to_all else self.place.request
        return self._frame(bytes([len(ask.request)]) + ask.request, t_ns, can_id)

    def join(self, other: EcuClient, t_ns: int) -> bool:
        """Wait for the answer to a request of another client, if it goes to all, and would be the next one here."""
        theirs = other._asked
        if not isinstance(theirs, Ask) or not theirs.to_all or not self.is_due(t_ns):
            return False
        alike = not (self.place.request ^ other.place.request) & EXTENDED and self.params.fd == other.params.fd
        mine = self._next()
        if mine.to_all and mine.request == theirs.request and alike:
            self._wait_for(mine, t_ns)
            return True
        return False

    def _next(self) -> Ask:
        return min((each for each in self.asks if not each.refused), key=lambda each: each.due_ns)

    def _wait_for(self, ask: Ask, t_ns: int) -> None:
        ask.due_ns = ask.due_ns or t_ns
        wait_ms = WAIT_MS if ask.request[0] == MARK else self.params.p2_ms
        self._asked, self._deadline_ns, self._pending = ask, t_ns + round(wait_ms * MS), 0
        self._begun_ns = t_ns
        self.counts["requests"] += 1

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

    def _frame(self, data: bytes, t_ns: int, can_id: int | None = None) -> Frames:
        before = b"" if self.place.target is None else bytes([self.place.target])
        frame, flags = empty(1), FD | BRS if self.params.fd else 0
        to = self.place.request if can_id is None else can_id
        put(frame, 0, t_ns, to, (before + data).ljust(8, b"\xcc"), bus=self.bus, flags=flags)
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
        if isinstance(one, ForwardedRequests):
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
        if self.open and (spoken := spoken_in(answer)):
            self._learn(spoken)
        if ask is None or not answer:
            return
        if isinstance(ask, ForwardedRequests):
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

    def _pass_back(self, one: ForwardedRequests, answer: bytes, t_ns: int) -> None:
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
        if code not in FINAL:
            ask.delays = min(ask.delays + 1, 16)
        elif ask.instead:
            self._turn(ask, code, t_ns)
            return
        elif ask.probes:
            self._declined[ask.protocol] = code
        else:
            ask.refused = f"{ask.declined}{FINAL[code]} (0x{code:02X})"
            self._report(ask)
        self._end(ask, t_ns, heard=True)

    def _report(self, ask: Ask) -> None:
        """Tell of a request that is not asked again."""
        name = self.params.name
        log.warning("an ECU refuses, and is not asked this again", ecu=name, request=ask.name, reason=ask.refused)

    def _turn(self, ask: Ask, code: int, t_ns: int) -> None:
        """Ask in another way what is refused for good; it is told when no way is left."""
        (request, *more), *later = ask.instead
        ask.declined += f"{ask.name}: {FINAL[code]} (0x{code:02X}); "
        # Each request of a turn goes on with those at its place of later turns, the first also with what is new there.
        self.asks += [
            replace(ask, request=each, due_ns=t_ns, instead=tuple((turn[k],) for turn in later if len(turn) > k))
            for k, each in enumerate(more, 1)
        ]
        ask.request, ask.instead = request, tuple((turn[0], *turn[1 + len(more) :]) for turn in later)
        self._end(ask, t_ns, heard=True)
        ask.due_ns, ask.free_ns, ask.armed = t_ns, t_ns, bool(ask.on)

    def expect(self, protocol: str, keep: Callable[[str], None]) -> None:
        """Ask first by the protocol of OBD that it answered before the start ("": none); have kept what it answers."""
        self._expected, self._keep = protocol, keep
        if self.open and not self._begun_ns:
            self.asks, self._probed = [ask for ask in self.asks if not ask.probes], 0
            self._probe(0)

    def _probe(self, t_ns: int) -> None:
        """Ask which protocol of OBD it speaks: all ECUs at once, then it alone; each round later than the one before.

        After the first round it is asked on, as it may answer requests and not for the map of them.
        """
        forms = probe_forms(self._expected, alone=self.place.target is not None)
        rounds, at = divmod(self._probed, len(forms))
        refuses = self._declined.keys() == PROBES.keys()
        if (rounds, at) == (1, 0) and not refuses:
            self.asks += self.open[OBD]
        if refuses:
            self._refuses_maps(tried=rounds > 0)
            return
        protocol, to_all = forms[at]
        rest_ns = min(FIRST_REST_NS << rounds - 1, LONGEST_REST_NS) if rounds and not at else 0
        self._probed += 1
        self.asks.insert(0, Ask(PROBES[protocol], NEVER, t_ns + rest_ns, protocol=protocol, probes=True, to_all=to_all))

    def _refuses_maps(self, *, tried: bool) -> None:
        """Ask on by the protocol whose service it knows, where it refuses both maps for good."""
        unknown = {protocol for protocol, code in self._declined.items() if code in UNKNOWN}
        by = ON_UDS if unknown == {OBD} else OBD
        kept = [ask for ask in self.asks if ask.protocol != OBD] if tried else self.asks
        self.asks, self.open = [*kept, *self.open[by]], {}
        reason = "; ".join(
            f"{PROBES[protocol].hex().upper()}: {FINAL[code]}" for protocol, code in self._declined.items()
        )
        log.warning("an ECU tells no map of OBD", ecu=self.params.name, reason=reason, asked_by=by)

    def _learn(self, protocol: str) -> None:
        """Ask on by a protocol of OBD."""
        self.speaks, asks, self.open = protocol, self.open[protocol], {}
        self._keep(protocol)
        kept = [ask for ask in self.asks if ask is self._asked or not ask.protocol or ask.protocol == protocol]
        kept = [ask for ask in kept if ask is self._asked or not ask.probes]
        self.asks = kept + [ask for ask in asks if not any(ask is each for each in kept)]
        log.info("an ECU answers OBD", ecu=self.params.name, protocol=protocol)

    def _end(self, ask: Ask, t_ns: int, *, heard: bool) -> None:
        """Put a request back into the schedule."""
        self._asked, self._deadline_ns, self._again = None, NEVER, 0
        if heard:
            self.silent, self._rests_ns = 0, 0
        if ask.on:
            ask.end(t_ns, done=heard and not ask.delays)
            return
        if ask.every_ns == NEVER:
            self.asks.remove(ask)
            if ask.probes and self.open:
                self._probe(t_ns)
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
        if isinstance(ask, ForwardedRequests):
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
        if isinstance(self._asked, ForwardedRequests):
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
        for one in ([old._asked] if isinstance(old._asked, ForwardedRequests) else []) + list(old.waiting.passed):
            one.send_back()
        self.silent, self._rests_ns = old.silent, max(old._rests_ns, old._deadline_ns if old.busy else 0)
        if old.speaks in self.open:
            self._learn(old.speaks)
        before: dict[bytes, list[Ask]] = {}
        for ask in old.asks:
            before.setdefault(ask.first, []).append(ask)
        self.asks = [
            replace(known, every_ns=ask.every_ns, ready=ask.ready) if known.on == ask.on else ask
            for ask in self.asks
            for known in before.get(ask.first, [ask])
        ]
