"""One request of an ECU's schedule, and the requests that show which protocol of OBD it speaks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from gateway.answers.weave import POSITIVE, READ_SERVICES
from gateway.clients.params import DTC_SERVICES, OBD, ON_UDS
from gateway.clients.pgn import MARK, pgn_of

#: Requests instead of one that is refused for good, one turn after the other.
Turns = tuple[tuple[bytes, ...], ...]
#: Protocol of OBD -> request for its map of PIDs, which shows that an ECU speaks it; the newer first.
PROBES = {ON_UDS: b"\x22\xf4\x00", OBD: b"\x01\x00"}


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
        instead: what is asked instead where it is refused for good.
        declined: what was refused before, with the reasons.
        protocol: of OBD that it is of, where that is to be found; "": none.
        probes: whether its answer shows that the ECU speaks this protocol.
        to_all: whether it goes to all ECUs of the bus.
        first: the request as the configuration has it.
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

    def __post_init__(self) -> None:
        self.first = self.first or self.request

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
