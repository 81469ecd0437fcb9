"""One address on ISO-TP: puts requests together from frames, and takes responses apart into frames."""

from __future__ import annotations

from typing import NamedTuple

import isotp
import numpy as np
from numpy.typing import NDArray

from gateway.bus.frames import BRS, EXTENDED, FD, ID_MASK, Frames, empty, payload, put
from gateway.isotp.layer import IsoTpLayer
from gateway.isotp.params import IsoTpParams

#: Responses on events that wait for the one under way.
MOST_PUSHED = 32
#: Tester present, its answer suppressed.
TESTER_PRESENT = b"\x3e\x80"


class Request(NamedTuple):
    """A request received whole: not empty, whether it was functional, when it was complete."""

    data: bytes
    functional: bool
    t_ns: int


class IsoTpEndpoint:
    """A physical and a functional identifier in, one identifier out.

    While an answer is under way, further requests are not taken, as a tester has to wait for it
    (ISO 15765-3, half-duplex); but for what keeps sessions, functional and without an answer (ISO 14229-2).

    Args:
        params: addresses and transport.
        bus: index of the bus.
        address: extended addressing: first byte of frames to us, and of ours; None: there is none.
    """

    def __init__(self, params: IsoTpParams, bus: int, address: tuple[int, int] | None = None) -> None:
        self._params, self._address = params, address
        self._bus = bus
        self._layer = IsoTpLayer(params, address)
        self._dropped = 0
        flags = params.flags
        self._physical = params.request | flags
        self._functional = None if params.functional is None else params.functional | flags

    def restart(self) -> None:
        """Drop what is under way; what was counted stays."""
        before = self._layer
        self._layer = IsoTpLayer(self._params, self._address)
        self._layer.errors = before.errors
        self._layer.advance(before.now_ns)

    def succeed(self, old: IsoTpEndpoint, bus: int | None) -> bool:
        """Keep requests and answers that are under way, if the addresses are the same; returns whether they are.

        Args:
            old: not to be used any more.
            bus: index here of the other's bus; None: it is no more.
        """
        if bus == self._bus and self._address == old._address and self._params.same_transport(old._params):
            self._layer, self._dropped = old._layer, old._dropped
            return True
        return False

    @property
    def bus(self) -> int:
        """Index of its bus."""
        return self._bus

    def asked_by(self, *, functional: bool) -> int:
        """Return the identifier of its requests, without EXTENDED."""
        return (self._physical if not functional or self._functional is None else self._functional) & ID_MASK

    @property
    def identifiers(self) -> list[int]:
        """Identifiers (with EXTENDED) of requests."""
        return [self._physical] if self._functional is None else [self._physical, self._functional]

    def wanted(self, frames: Frames) -> NDArray[np.bool_]:
        """Return which frames carry its request identifiers, shape (n,)."""
        ids = frames["can_id"]
        mine = ids == self._physical
        if self._functional is not None:
            mine |= ids == self._functional
        return np.asarray(mine & (frames["bus"] == self._bus), np.bool_)

    def receive(self, frame: np.void, t_ns: int) -> Request | None:
        """Take a frame of a request, or the flow control of an answer; returns the request that it completes.

        Args:
            frame: one that it wanted.
            t_ns: now.
        """
        now = self._layer.advance(t_ns)
        can_id = int(frame["can_id"])
        message = isotp.CanMessage(can_id & ID_MASK, data=payload(frame), extended_id=bool(can_id & EXTENDED))
        functional = can_id == self._functional and can_id != self._physical
        # A functional request is a single frame (ISO 15765-2); anything else is passed over.
        data = self._layer.single(message) if functional else self._layer.take(message)
        if data is None:
            return None
        keeps = functional and data == TESTER_PRESENT
        if not data or (self._layer.transmitting and not keeps):
            self._layer.process()
            return None
        return Request(data, functional, now)

    def peek(self, frame: np.void) -> bytes | None:
        """Return the physical request that a frame completes, without taking it; None: none, or it is not answered.

        Of a request of several frames it is what had come before.

        Args:
            frame: one that it wanted; each is given once, in its order.
        """
        data, can_id = payload(frame), int(frame["can_id"])
        content = self._layer.content(data)
        if can_id != self._physical or not content or self._layer.transmitting:
            return None
        if self._layer.receiving:
            return self._layer.completed_by(content)
        if content[0] >> 4:
            return None
        return self._layer.single(isotp.CanMessage(can_id & ID_MASK, data=data, extended_id=bool(can_id & EXTENDED)))

    def send(self, responses: list[bytes]) -> None:
        """Send responses one after the other."""
        self._layer.send(responses)

    def push(self, responses: list[bytes], t_ns: int) -> None:
        """Send responses that no request asked for just now; those that find no room are dropped."""
        self._layer.advance(t_ns)
        room = max(MOST_PUSHED - self._layer.waiting, 0)
        self._dropped += max(len(responses) - room, 0)
        self._layer.send(responses[:room])

    def advance(self, t_ns: int) -> int:
        """Set its clock, never back; returns what it shows. Timers that are due run with the next :meth:`send`."""
        return self._layer.advance(t_ns)

    def take_frames(self) -> Frames:
        """Return the frames to be sent by now, once."""
        sent = self._layer.take_sent()
        frames = empty(len(sent))
        for k, message in enumerate(sent):
            put(
                frames,
                k,
                self._layer.now_ns,
                message.arbitration_id | (EXTENDED if message.is_extended_id else 0),
                bytes(message.data),
                bus=self._bus,
                flags=FD | BRS if message.is_fd else 0,
            )
        return frames

    @property
    def busy(self) -> bool:
        """Whether a request or a response is under way."""
        return self._layer.busy

    @property
    def sending(self) -> bool:
        """Whether a message is being sent."""
        return self._layer.transmitting

    @property
    def next_ns(self) -> int:
        """Time of its next timer: separation time or timeout."""
        return self._layer.next_ns

    def counters(self) -> dict[str, int]:
        """Return frames that break ISO-TP, and responses on events that found no room."""
        return {"isotp_errors": self._layer.errors, "responses_dropped": self._dropped}
