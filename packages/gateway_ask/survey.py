"""Survey of a bus: ECUs that are there, and their answers. It only reads, and asks slowly.

First it listens; then it asks all at once (functional), then each address by itself, and in the end each ECU that has
answered. An ECU is one only if it answers twice, so that a late answer is not taken for one of the next address.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, field

import numpy as np

from gateway.bus.frames import EXTENDED, ID_MASK, Frames, empty, joined, payload, put
from gateway.isotp.addressing import FUNCTIONAL
from gateway_ask.clients.dm1 import Dm1Listener
from gateway_ask.clients.poller import Ecu, Poller
from gateway_ask.identification import Questioned, Said, questioned

MS = 1_000_000
#: How long it listens before it asks, and how long an answer may take [ns].
LISTEN_NS, P2_NS = 1_000 * MS, 100 * MS
#: Read the active session, then tester present: each UDS server answers in one frame, if only by a refusal.
PROBES = (b"\x22\xf1\x86", b"\x3e\x00")
#: Requests to all: PIDs of OBD, classic and on UDS, tester present.
TO_ALL = (b"\x01\x00", b"\x22\xf4\x00", b"\x3e\x00")
FUNCTIONAL_11, FUNCTIONAL_29 = FUNCTIONAL
TESTER = 0xF1
#: Physical addresses: of 11 bits, and of 29 bits in normal fixed addressing with the tester F1.
PHYSICAL = (*range(0x700, 0x800), *(EXTENDED | 0x18DA0000 | k << 8 | TESTER for k in range(256)))
#: J1939: request for the address claimed, to all, from the null address (J1939-81); the group of the answers.
ASK_NAMES, NAMES, GROUP = EXTENDED | 0x18EAFFFE, 0xEE00, b"\x00\xee\x00"


@dataclass(frozen=True)
class Place:
    """Address of an ECU: identifiers with EXTENDED."""

    request: int
    response: int

    @property
    def name(self) -> str:
        """How it is called where it has no name."""
        return f"ecu_{self.request & ID_MASK:X}"


@dataclass
class Found:
    """Result of a survey.

    Attributes:
        frames: heard while nothing was asked, and in which time [ns].
        heard_ns: that time.
        ecus: address -> what it has said; None: it has not been asked yet.
        names: J1939 source address -> name, 64 bits.
        active: J1939 source address -> DTCs that it broadcasts (DM1).
        not_tried: identifiers that were not asked, as there was traffic on them.
        unclear: identifiers that answered once, and not again.
    """

    frames: int = 0
    heard_ns: int = LISTEN_NS
    ecus: dict[Place, Said | None] = field(default_factory=dict)
    names: dict[int, int] = field(default_factory=dict)
    active: dict[int, list[str]] = field(default_factory=dict)
    not_tried: list[int] = field(default_factory=list)
    unclear: list[int] = field(default_factory=list)


#: Frames to send, and how long answers are waited for [ns]; the frames that came are sent back.
_Script = Generator[tuple[Frames, int], Frames, None]


class Survey:
    """The survey; it reads no clock, and has no bus.

    Args:
        rate: requests a second at most.
        may_ask: called after it has listened: whether it may ask.
        physical: identifiers of requests to one ECU, with EXTENDED, which are tried.

    Attributes:
        found: so far.
        done: whether it is over.
        step: number of the question, of how many, for people.
    """

    def __init__(
        self,
        rate: float,
        may_ask: Callable[[Found], bool] = lambda found: True,
        physical: Sequence[int] = PHYSICAL,
    ) -> None:
        self.found = Found()
        self.done = False
        self.step, self.steps = 0, 1
        self._apart_ns, self._rate, self._may_ask = round(1e9 / rate), rate, may_ask
        self._physical = tuple(physical)
        self._script = self._run()
        self._heard: list[Frames] = []
        self._traffic: set[int] = set()
        self._until_ns = -1
        self._asking: Poller | None = None
        self._dm1 = Dm1Listener([0], {}, {0: ""}, ())

    def poll(self, t_ns: int, heard: Frames) -> Frames:
        """Go on.

        Args:
            t_ns: now.
            heard: frames of others since the last call.

        Returns:
            frames to send.
        """
        if self.done:
            return empty(0)
        if self._asking is not None:
            return self._question(t_ns, heard)
        self._heard.append(heard)
        self._listen(heard)
        if t_ns < self._until_ns:
            return empty(0)
        came, self._heard = joined(self._heard), []
        try:
            out, wait_ns = next(self._script) if self._until_ns < 0 else self._script.send(came)
        except StopIteration:
            return self._begin_questions(t_ns)
        out["t_ns"] = t_ns
        self._until_ns = t_ns + max(wait_ns, self._apart_ns if len(out) else 0)
        return out

    # Search for ECUs.

    def _run(self) -> _Script:
        came = yield empty(0), LISTEN_NS
        self.found.frames = len(came)
        self._traffic = {int(can_id) for can_id in np.unique(came["can_id"])}
        if not self._may_ask(self.found):
            self.done = True
            return
        self.steps = 2 * len(TO_ALL) + 1 + len(self._physical)
        came = yield self._frame(ASK_NAMES, GROUP), 3 * P2_NS
        self._note_names(came)
        for can_id in (FUNCTIONAL_11, FUNCTIONAL_29):
            for request in TO_ALL:
                came = yield self._single(can_id, request), 3 * P2_NS
                self._note_functional(came, request)
        for can_id in self._physical:
            if can_id in self._traffic:
                self.found.not_tried.append(can_id)
            elif can_id != FUNCTIONAL_11 and not any(can_id in (one.request, one.response) for one in self.found.ecus):
                yield from self._probe(can_id)
            self.step += 1

    def _probe(self, can_id: int) -> _Script:
        """Ask one address, and again if it answers."""
        came = yield self._single(can_id, PROBES[0]), P2_NS
        first = self._answered(came, PROBES[0])
        if not first:
            return
        came = yield self._single(can_id, PROBES[1]), 3 * P2_NS
        both = first & self._answered(came, PROBES[1])
        if len(both) == 1 and not (can_id ^ min(both)) & EXTENDED:
            self.found.ecus.setdefault(Place(can_id, both.pop()), None)
        else:
            self.found.unclear.append(can_id)

    def _answered(self, came: Frames, request: bytes) -> set[int]:
        """Return the identifiers that answer a request, of those that were silent before it."""
        found = set()
        for frame in came:
            data, can_id = payload(frame), int(frame["can_id"])
            start = 2 if data[:1] and data[0] >> 4 == 1 else 1
            said = data[start : start + len(request)]
            positive = said == bytes([request[0] + 0x40]) + request[1:]
            if can_id not in self._traffic and (positive or said[:2] == bytes([0x7F, request[0]])):
                found.add(can_id)
        return found

    def _note_functional(self, came: Frames, request: bytes) -> None:
        self.step += 1
        for can_id in sorted(self._answered(came, request)):
            plain = can_id & ID_MASK
            if not can_id & EXTENDED and 0x7E8 <= plain <= 0x7EF:
                self.found.ecus.setdefault(Place(plain - 8, plain), None)
            elif plain >> 8 == 0x18DA00 | TESTER:
                place = Place(EXTENDED | 0x18DA0000 | (plain & 0xFF) << 8 | TESTER, can_id)
                self.found.ecus.setdefault(place, None)

    def _note_names(self, came: Frames) -> None:
        self.step += 1
        for frame in came:
            can_id = int(frame["can_id"])
            if can_id & EXTENDED and can_id >> 8 & 0x3FF00 == NAMES and frame["length"] == 8:
                self.found.names[can_id & 0xFF] = int.from_bytes(payload(frame), "little")

    def _listen(self, heard: Frames) -> None:
        """Note DTCs that are broadcast."""
        for frame in heard[self._dm1.among(heard)]:
            told = self._dm1.take(frame)
            if told is not None:
                self.found.active[int(told.ecu.rpartition(":")[2], 16)] = list(told.found)

    def _frame(self, can_id: int, data: bytes) -> Frames:
        made = empty(1)
        put(made, 0, 0, can_id, data)
        return made

    def _single(self, can_id: int, request: bytes) -> Frames:
        return self._frame(can_id, (bytes([len(request)]) + request).ljust(8, b"\xcc"))

    # Questions to each ECU.

    def _begin_questions(self, t_ns: int) -> Frames:
        ecus = [questioned(place.name, place.request, place.response) for place in self.found.ecus]
        if self.done or not ecus:
            self.done = True
            return empty(0)
        self._asking = Poller(ecus, {0: self._rate}, lambda bus: True)
        self.steps += sum(len(ecu.client.asks) for ecu in ecus)
        return self._question(t_ns, empty(0))

    def _question(self, t_ns: int, heard: Frames) -> Frames:
        assert self._asking is not None
        self._asking.hear(heard)
        out = self._asking.poll(t_ns)
        clients = [_client(ecu) for ecu in self._asking.ecus]
        self.found.ecus = {place: Said(client.answers) for place, client in zip(self.found.ecus, clients, strict=True)}
        self.step = self.steps - sum(len(client.asks) for client in clients)
        self.done = all(client.done for client in clients)
        return out


def _client(ecu: Ecu) -> Questioned:
    assert isinstance(ecu.client, Questioned)
    return ecu.client
