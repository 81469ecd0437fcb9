"""All clients of a gateway: frames that they want, the order in which they ask, and answers as frames."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from gateway.bus.frames import EXTENDED, Frames, empty, joined, payload, put
from gateway.bus.id_filter import IdFilter
from gateway.common.fence import Fence
from gateway.common.times import NEVER
from gateway.config.ecu import MARK
from gateway.faults.vehicle import TOLD, DtcAnswer
from gateway.isotp.addressing import FUNCTIONAL
from gateway.isotp.edges import FLOW_CONTROL, MOST_LONG, MOST_SHORT
from gateway.runtime.asking import Asking
from gateway.signals.reassembly import Woven
from gateway_ask.answers.answer_frames import NEGATIVE, FrameEncoder
from gateway_ask.clients.ask import Ask
from gateway_ask.clients.dm1 import MASKS, Dm1Listener
from gateway_ask.clients.dtcs import READ_DTCS, details_of, read_dtcs
from gateway_ask.clients.ecu import MS, EcuClient
from gateway_ask.clients.line import Line
from gateway_ask.clients.passive_reassembly import Reassembler
from gateway_ask.clients.pgn import ended_by, identifiers_of
from gateway_ask.clients.refusals import PENDING

#: Identifier of a frame behind each answer that tells DTCs, on the bus of the answers: it is the place in time of
#: :attr:`Poller.told`.
TELLS = EXTENDED | READ_DTCS << 16
#: DTCs whose data are read after one answer, at most; those of others are read after the next.
MOST_DETAILS = 16
#: Requests of testers a second to an ECU, where no route says how many.
REQUESTS_PER_S = 50.0
#: How long a frame of ours may take to come back [ns], and how many are remembered.
ECHO_NS, MOST_SENT = 1000 * MS, 1024
#: How often a bus that rests is looked at again [ns].
LOOK_NS = 100 * MS


@dataclass
class Ecu:
    """An ECU: who asks it, and what is heard of it.

    Attributes:
        client: of it.
        weaver: of its answers.
        answers: its messages.
        requests: messages to it.
        asked: the last one, until its answer.
        detailed: DTCs whose data have been asked for since they came.
        listed: DTCs that were there in the latest list of each kind, by the request's bytes.
    """

    client: EcuClient
    weaver: FrameEncoder
    answers: Reassembler = field(init=False)
    requests: Reassembler = field(init=False)
    asked: bytes = b""
    detailed: set[str] = field(default_factory=set)
    listed: dict[bytes, set[str]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.begin_again()

    def begin_again(self) -> None:
        """Forget the messages that are under way."""
        place = self.client.place
        self.answers, self.requests = Reassembler(place.tester, MOST_LONG), Reassembler(place.target)
        self.asked = b""

    def __str__(self) -> str:
        """Return its name."""
        return self.client.params.name


class Poller(Asking):
    """The clients, and those who hear DTCs that are broadcast.

    Args:
        ecus: in the order of the configuration.
        rates: requests a second at most, by index of the bus; on others nothing is asked.
        dm1: hears DTCs that are broadcast; None: nobody does.
        bus_of: index of the bus of the answers, by index of the bus.
        woven: puts messages of several frames together; None: there are none.
        may_ask: whether a bus may be asked now: it lives, the vehicle is awake, nobody has switched communication off.
        fence: counts exceptions that answers cause.

    Attributes:
        heard: what it listens to, on any bus.
        told: what answers say of DTCs, in the order of the frames TELLS.
        alter: changes frames with answers among them, as a fault of an ECU would; None: nobody does.
    """

    def __init__(
        self,
        ecus: Sequence[Ecu],
        rates: Mapping[int, float],
        may_ask: Callable[[int], bool],
        dm1: Dm1Listener | None = None,
        bus_of: Mapping[int, int] | None = None,
        fence: Fence | None = None,
        woven: Woven | None = None,
    ) -> None:
        super().__init__(woven, fence)
        self._dm1, self._bus_of = dm1, bus_of or {}
        self.ecus = tuple(ecus)
        self._may_ask = may_ask
        self._apart_ns = {bus: round(1e9 / rate) for bus, rate in rates.items()}
        self._next_of_bus = dict.fromkeys(rates, 0)
        self._said: list[Frames] = []
        self._sent: deque[tuple[int, int, int, bytes]] = deque(maxlen=MOST_SENT)
        self.told: deque[DtcAnswer] = deque()
        self._heard: dict[tuple[int, int], list[tuple[Ecu, bool]]] = {}
        self._functional: dict[tuple[int, int], list[Ecu]] = {}
        self._groups: dict[tuple[int, int], EcuClient] = {}
        for ecu in self.ecus:
            client = ecu.client
            self._heard.setdefault((client.bus, client.place.request), []).append((ecu, True))
            self._heard.setdefault((client.bus, client.place.response), []).append((ecu, False))
            groups = [ask.request for ask in client.asks if ask.request[0] == MARK]
            for can_id in identifiers_of(groups, client.params.address or 0):
                self._groups[client.bus, can_id] = client
            for can_id in FUNCTIONAL:
                self._functional.setdefault((client.bus, can_id), []).append(ecu)
        places = self._heard.keys() | self._functional.keys() | self._groups.keys()
        known = frozenset(can_id for _, can_id in places)
        self._listens = IdFilter(known, frozenset() if dm1 is None else MASKS)
        self.heard = self._listens if woven is None else self._listens.also(woven.heard)
        self._ids = np.asarray(sorted(known), np.uint32)
        self._places = places
        self._now_ns = 0
        self.next_ns = 0 if self._apart_ns else NEVER

    def identifiers_on(self, bus: int) -> list[int] | None:
        """Return the identifiers (with EXTENDED) that it listens to on a bus; None: they are too many to list."""
        if self._dm1 is not None and bus in self._dm1.buses:
            return None
        return [can_id for index, can_id in self._places if index == bus]

    def hear(self, frames: Frames) -> Frames:
        """Take frames in order of time; returns them with those of the answers and messages that they complete."""
        frames = super().hear(frames)
        if self._listens.has_none_of(frames):
            return frames
        mine = np.isin(frames["can_id"], self._ids)
        told = np.zeros(len(frames), np.bool_) if self._dm1 is None else self._dm1.among(frames)
        parts, start = [], 0
        for k in np.flatnonzero(mine | told):
            said = self._wall.keep(self._take, frames[k], of="an answer", instead=empty(0)) if mine[k] else empty(0)
            broadcast = self._wall.keep(self._broadcast, frames[k], told[k], of="DM1", instead=empty(0))
            made = joined([said, broadcast])
            if len(made):
                parts += [frames[start : k + 1], made]
                start = int(k) + 1
        self._plan()
        if not parts:
            return frames
        made = joined([*parts, frames[start:]])
        return made if self.alter is None else self.alter(made)

    def _take(self, frame: np.void) -> Frames:
        bus, can_id, t_ns = int(frame["bus"]), int(frame["can_id"]), int(frame["t_ns"])
        data, made, self._now_ns = payload(frame), [], t_ns
        if self._is_back(bus, can_id, data, t_ns):
            return empty(0)
        if (bus, can_id) in self._groups:
            ended = ended_by(frame)
            if ended is not None:
                self._groups[bus, can_id].on_group(ended, t_ns)
        for ecu in self._functional.get((bus, can_id), ()):
            ecu.client.give_way(t_ns)
            ecu.asked = Reassembler().take(data, t_ns) or b""
        for ecu, request in self._heard.get((bus, can_id), ()):
            address = ecu.client.place.target if request else ecu.client.place.tester
            if address is not None and data[:1] != bytes([address]):
                continue
            if request:
                ecu.client.give_way(t_ns)
                ecu.asked = ecu.requests.take(data, t_ns) or ecu.asked
            else:
                answer = self._wall.keep(self._answer, ecu, frame, data, of=ecu, ends=self._restart, instead=empty(0))
                made.append(answer)
        return joined(made)

    def _is_back(self, bus: int, can_id: int, data: bytes, t_ns: int) -> bool:
        """Return whether a frame is the one that was just sent, from a bridge, a second adapter, an echo: once."""
        while self._sent and t_ns - self._sent[0][0] > ECHO_NS:
            self._sent.popleft()
        for k, (_, *sent) in enumerate(self._sent):
            if sent == [bus, can_id, data]:
                del self._sent[k]
                return True
        return False

    def _restart(self, ecu: Ecu) -> None:
        """Give up what is under way with an ECU whose answer raised."""
        ecu.begin_again()
        ecu.client.restart(self._now_ns)

    def _answer(self, ecu: Ecu, frame: np.void, data: bytes) -> Frames:
        """Take a frame of an answer; returns the frames of the answer that it completes."""
        t_ns = int(frame["t_ns"])
        content = data if ecu.client.place.tester is None else data[1:]
        if content and content[0] >> 4 == FLOW_CONTROL:
            self._said.append(ecu.client.on_flow_control(frame, t_ns))
        before, errors = ecu.answers.receiving, ecu.answers.errors
        answer = ecu.answers.take(data, t_ns)
        if answer is None:
            if ecu.answers.too_long:
                self._said.append(ecu.client.on_too_long(t_ns))
            elif ecu.answers.receiving:
                began = not before or ecu.answers.errors > errors
                said = ecu.client.on_first_frame(t_ns) if began else ecu.client.on_more(t_ns)
                self._said += [said] if len(said) else []
            return empty(0)
        ours = ecu.client.is_read
        ecu.client.on_answer(answer, t_ns)
        if len(answer) > MOST_SHORT:  # only testers ask for so much; no layout has it
            ecu.asked, ecu.weaver.counts["longer"] = b"", ecu.weaver.counts["longer"] + 1
            return empty(0)
        asked, told = ecu.asked, read_dtcs(ecu.client.params.name, answer, ecu.asked)
        if answer[0] != NEGATIVE or answer[2:3] != bytes([PENDING]):
            ecu.asked = b""
        if told is None:
            return ecu.weaver.frames(answer, t_ns)
        if ours and told.covers and told.typed and ecu.client.params.dtcs is not None:
            self._read_details(ecu, asked, told, t_ns)
        return self._keep(told, t_ns, ecu.weaver.bus)

    def _keep(self, told: DtcAnswer, t_ns: int, bus: int) -> Frames:
        """Keep what is told, and return the frame that is its place in time."""
        made = empty(1)
        put(made, 0, t_ns, TELLS, b"", bus=bus)
        self.told.append(told)  # last: each has its frame
        return made

    def on_dtc(self, ecu: str | None, t_ns: int) -> None:
        """Have that asked which is asked when a DTC came: of an ECU, or of ours (None: of all ECUs)."""
        for each in self.ecus:
            if ecu in (None, each.client.params.name):
                each.client.on_dtc(t_ns)
        self._plan()

    def _broadcast(self, frame: np.void, wanted: bool) -> Frames:
        """Take a frame that may be of DM1; returns the place in time of what it completes."""
        told = None if self._dm1 is None or not wanted else self._dm1.take(frame)
        return empty(0) if told is None else self._keep(told, int(frame["t_ns"]), self._bus_of[int(frame["bus"])])

    def _read_details(self, ecu: Ecu, asked: bytes, told: DtcAnswer, t_ns: int) -> None:
        """Have the data of DTCs read that came, once each."""
        there = ecu.listed[asked] = {dtc for dtc, status in told.found.items() if status & TOLD}
        ecu.detailed &= set().union(*ecu.listed.values())
        for dtc in sorted(there - ecu.detailed)[:MOST_DETAILS]:
            ecu.detailed.add(dtc)
            ecu.client.asks += [Ask(request, NEVER, t_ns) for request in details_of(dtc)]

    def poll(self, t_ns: int) -> Frames:
        """Let time pass; returns the frames to send."""
        said, self._said = self._said, []
        self._now_ns, keep = t_ns, self._wall.keep
        for ecu in self.ecus:
            said.append(keep(ecu.client.on_time, t_ns, of=ecu, ends=self._restart, instead=empty(0)))
        for bus in self._apart_ns:
            if t_ns >= self._next_of_bus[bus]:
                said.append(keep(self._ask, bus, t_ns, of=bus, ends=self._rest, instead=empty(0)))
        for ecu in self.ecus:
            if ecu.client.passes(t_ns):
                said.append(keep(self._pass_on, ecu, t_ns, of=ecu, ends=self._restart, instead=empty(0)))
        self._plan()
        made = joined(said)
        self._sent += [(t_ns, int(one["bus"]), int(one["can_id"]), payload(one)) for one in made]
        return made

    def _pass_on(self, ecu: Ecu, t_ns: int) -> Frames:
        """Return the next request of a tester to an ECU."""
        if not self._may_ask(ecu.client.bus):
            ecu.client.waiting.give_up()
            return empty(0)
        made = ecu.client.pass_on(t_ns)
        ecu.asked = ecu.client.request
        return made

    def _rest(self, bus: int) -> None:
        """Ask nothing on a bus for a while, after an exception."""
        self._next_of_bus[bus] = self._now_ns + LOOK_NS

    def _ask(self, bus: int, t_ns: int) -> Frames:
        """Return the next request on a bus, if there is one."""
        ready = [ecu for ecu in self.ecus if ecu.client.bus == bus and ecu.client.is_due(t_ns)]
        if ready and not self._may_ask(bus):
            self._next_of_bus[bus] = t_ns + LOOK_NS
            return empty(0)
        for ecu in sorted(ready, key=lambda ecu: ecu.client.urgency):
            if ecu.client.postpone(t_ns):
                self._next_of_bus[bus] = t_ns + self._apart_ns[bus]
                made = ecu.client.begin(t_ns)
                for each in (ecu, *(other for other in ready if other.client.join(ecu.client, t_ns))):
                    each.asked = ecu.client.request
                return made
        return empty(0)

    @property
    def askable(self) -> list[str]:
        """Names of the ECUs that may be asked: their buses are not only listened to."""
        return [ecu.client.params.name for ecu in self.ecus if ecu.client.bus in self._apart_ns]

    def line(self, name: str, requests_per_s: float | None = None) -> Line:
        """Return the line to an ECU, for requests of testers.

        Args:
            name: of the ECU.
            requests_per_s: most of them, of all testers together; of several lines the least counts. None: that of
                the other lines, or REQUESTS_PER_S.
        """
        client = next(ecu.client for ecu in self.ecus if ecu.client.params.name == name)
        if requests_per_s is not None or not client.waiting.apart_ns:
            apart_ns = round(1e9 / (requests_per_s or REQUESTS_PER_S))
            client.waiting.apart_ns = max(client.waiting.apart_ns, apart_ns)
        return Line(client, self._may_ask, self._plan)

    def _plan(self) -> None:
        """Note when there is something to do next."""
        due = [0 if self._said else NEVER]
        for ecu in self.ecus:
            client = ecu.client
            at_ns = client.due_ns
            if client.bus in self._apart_ns or client.busy:
                due.append(at_ns if client.busy else max(at_ns, self._next_of_bus[client.bus]))
            if client.waiting.passed and not client.busy:
                due.append(client.waiting.next_ns)
        self.next_ns = min(due)

    def succeed(self, old: Asking, buses: Mapping[int, int]) -> None:
        """Go on where those of the configuration before stop, with the ECUs that both have.

        Args:
            old: not to be used any more.
            buses: index of a bus there -> its index here.
        """
        super().succeed(old, buses)
        if not isinstance(old, Poller):
            return
        before = {(buses.get(ecu.client.bus), ecu.client.place): ecu for ecu in old.ecus}
        for ecu in self.ecus:
            known = before.get((ecu.client.bus, ecu.client.place))
            if known is not None:
                ecu.client.succeed(known.client)
                ecu.answers, ecu.requests, ecu.asked = known.answers, known.requests, known.asked
                ecu.weaver.counts.update(known.weaver.counts)
        if self._dm1 is not None and old._dm1 is not None:
            self._dm1.succeed(old._dm1, buses)
        for bus, at_ns in old._next_of_bus.items():
            if buses.get(bus) in self._next_of_bus:
                self._next_of_bus[buses[bus]] = at_ns
        self._plan()

    def counters(self) -> dict[str, int]:
        """Return what they counted, of all ECUs together."""
        found: dict[str, int] = {} if self._dm1 is None else {"dm1_cut": self._dm1.errors}
        found |= super().counters()
        for state in self.states():
            for name, count in state.items():
                if isinstance(count, int):
                    found[f"ecu_{name}"] = found.get(f"ecu_{name}", 0) + count
        return found

    def states(self) -> list[dict[str, Any]]:
        """Return what is counted of each ECU, and which requests it refuses."""
        return [
            {
                "ecu": ecu.client.params.name,
                **ecu.client.counts,
                **{f"answers_{name}": count for name, count in ecu.weaver.counts.items()},
                "answers_cut": ecu.answers.errors,
                "speaks": ecu.client.speaks,
                "not_asked": {ask.name: ask.refused for ask in ecu.client.asks if ask.refused},
            }
            for ecu in self.ecus
        ]
