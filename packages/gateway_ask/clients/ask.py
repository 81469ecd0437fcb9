"""One request of an ECU's schedule, and the requests that show which protocol of OBD it speaks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from gateway.common.times import NEVER
from gateway.config.ecu import DTC, DTC_SERVICES, MARK, OBD, ON_UDS, READ_SERVICES, START, WHEN
from gateway_ask.answers.answer_frames import POSITIVE
from gateway_ask.clients.pgn import pgn_of

#: Requests instead of one that is refused for good, one turn after the other.
Turns = tuple[tuple[bytes, ...], ...]
#: Protocol of OBD -> request for its map of PIDs, which shows that an ECU speaks it; the newer first.
PROBES = {ON_UDS: b"\x22\xf4\x00", OBD: b"\x01\x00"}
#: How often conditions are looked at: those of a request by time, and those that are an event [ns].
UNMET_NS, EVENT_NS = 1_000_000_000, 100_000_000
#: Wait until a request of an event is tried again after a refusal or silence, doubled each time, and how often [ns].
_AGAIN_NS, _MOST_AGAIN = 1_000_000_000, 6


@dataclass
class Ask:
    """A request of the schedule.

    Attributes:
        request: its bytes, of a single frame.
        every_ns: time between two, on an event the least; NEVER: once.
        due_ns: when it is next.
        delays: refusals in a row, each of which doubled the time to the next.
        refused: reason why it is not asked any more; "": it is.
        ready: whether its conditions are met now.
        instead: what is asked instead where it is refused for good.
        declined: what was refused before, with the reasons.
        protocol: of OBD that it is of, where that is to be found; "": none.
        probes: whether its answer shows that the ECU speaks this protocol.
        to_all: whether it goes to all ECUs of the bus.
        first: the request as the configuration has it.
        on: event on which it is asked, instead of by time; "": none.
        armed: whether the event has come, and has had no answer; of WHEN: whether its conditions were not met since.
        free_ns: on an event: when it may be asked again.
    """

    request: bytes
    every_ns: int
    due_ns: int = 0
    delays: int = 0
    refused: str = ""
    ready: Callable[[], bool] = lambda: True
    instead: Turns = ()
    declined: str = ""
    protocol: str = ""
    probes: bool = False
    to_all: bool = False
    first: bytes = b""
    on: str = ""
    armed: bool = False
    free_ns: int = 0

    def __post_init__(self) -> None:
        self.first = self.first or self.request
        if self.on == DTC and not self.armed:
            self.due_ns = NEVER
        self.armed = self.armed or self.on in (START, WHEN)

    def waits(self, t_ns: int) -> bool:
        """Return whether it has to wait for its conditions; it is looked at again later."""
        met = self.ready()
        if self.on == WHEN:
            self.armed = self.armed or not met
        if met and (self.armed or not self.on) and t_ns >= self.free_ns:
            return False
        self.due_ns = t_ns + (EVENT_NS if self.on == WHEN else UNMET_NS)
        return True

    def come(self, t_ns: int) -> None:
        """Take its event."""
        self.armed, self.due_ns, self.delays = True, min(self.due_ns, max(t_ns, self.free_ns)), 0

    def end(self, t_ns: int, *, done: bool) -> None:
        """Wait for the next event, or try again where there was no answer to this one."""
        if done:
            self.armed, self.delays, self.free_ns = False, 0, t_ns + self.every_ns
            self.due_ns = t_ns + EVENT_NS if self.on == WHEN else NEVER
        else:
            self.due_ns = t_ns + (_AGAIN_NS << min(self.delays, _MOST_AGAIN))

    @property
    def name(self) -> str:
        """Its bytes for people, or its parameter group."""
        return f"PGN {pgn_of(self.request)}" if self.request[0] == MARK else self.request.hex().upper()


def allowed(request: bytes) -> bool:
    """Return whether a request only reads: nothing else leaves a client."""
    return bool(request) and request[0] in (*READ_SERVICES, *DTC_SERVICES, MARK)


def spoken_in(answer: bytes) -> str:
    """Return the protocol of OBD whose map of PIDs an answer is; "": none's."""
    for protocol, (service, *identifier) in PROBES.items():
        head = bytes([service + POSITIVE, *identifier])
        if answer.startswith(head) and len(answer) == len(head) + 4:
            return protocol
    return ""


def probe_forms(expected: str, *, alone: bool) -> list[tuple[str, bool]]:
    """Return the order in which an ECU is asked for its protocol of OBD, and whether the request goes to all.

    Args:
        expected: protocol that is asked for first; "": the newer one.
        alone: no request goes to all, as its frames have an address byte.
    """
    order = sorted(PROBES, key=lambda protocol: protocol != expected)
    return [(protocol, to_all) for to_all in ((False,) if alone else (True, False)) for protocol in order]
