"""One address on J1939: claims it, and assembles requests to it and messages from it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gateway.bus.frames import ERROR, EXTENDED, REMOTE, Frames
from gateway.j1939.frame import (
    ACKNOWLEDGMENT,
    ADDRESS_CLAIMED,
    COMMANDED_ADDRESS,
    GLOBAL,
    NULL,
    REQUEST,
    TP_CM,
    TP_DT,
    Pdu,
    pgn_bytes,
    read_pdu,
    to_frames,
)
from gateway.j1939.transport import Message, Transport
from gateway_testers.j1939.claim import Claim, NameParams

#: Kinds of acknowledgment (J1939-21, 5.4.4).
POSITIVE, NEGATIVE, DENIED = 0, 1, 2
#: Upper bytes of the groups that it takes.
_PAGES = sorted({pgn >> 8 for pgn in (REQUEST, TP_CM, TP_DT, ADDRESS_CLAIMED)})
#: The same as values and masks of identifiers, of any sender and receiver.
MASKS = frozenset((EXTENDED | page << 16, EXTENDED | 0x3FF << 16) for page in _PAGES)


class PgnRequest(NamedTuple):
    """A request for a parameter group: by whom, to which address."""

    pgn: int
    source: int
    destination: int


class J1939Endpoint:
    """Address claim and transport protocol of one address: frames in, requests out; messages in, frames out.

    Args:
        name: our NAME.
        address: the one we would like.
        bus: index of the bus.
        commandable: whether others may command another address.

    Attributes:
        commanded: addresses that others have commanded: by whom, NAME and address; cleared when they are told.
    """

    def __init__(self, name: NameParams, address: int, bus: int, *, commandable: bool = False) -> None:
        self._asked = name, address
        self._commandable = commandable
        self.commanded: list[tuple[int, bytes]] = []
        self._bus = bus
        self._claim = Claim(name, address)
        self.transport = Transport(address)
        self._now_ns = 0
        self._made: list[Pdu] = []

    def succeed(self, old: J1939Endpoint, bus: int | None) -> bool:
        """Keep address and sessions, if name and address are the same; returns whether they are.

        Args:
            old: not to be used any more.
            bus: index here of the other's bus; None: it is no more.
        """
        if bus != self._bus or old._asked != self._asked:
            return False
        self._claim, self.transport, self._now_ns = old._claim, old.transport, old._now_ns
        return True

    def restart(self) -> None:
        """Drop what is under way; the address stays."""
        self.transport.reset()
        self._made.clear()

    @property
    def bus(self) -> int:
        """Index of its bus."""
        return self._bus

    @property
    def claimed(self) -> bool:
        """Whether the address is claimed: else it may not send."""
        return self._claim.claimed

    def wanted(self, frames: Frames) -> NDArray[np.bool_]:
        """Return which frames are of its protocols and for its address, or for all; shape (n,)."""
        ids = frames["can_id"]
        group = (ids >> 16) & 0x3FF
        destination = (ids >> 8) & 0xFF
        mine = (destination == GLOBAL) | (destination == self._claim.address)
        kind = (ids & (EXTENDED | ERROR | REMOTE)) == EXTENDED
        known = np.isin(group, _PAGES)
        return np.asarray(kind & known & mine & (frames["bus"] == self._bus), np.bool_)

    def receive(self, frame: np.void, t_ns: int) -> PgnRequest | None:
        """Take a claim, a request, or a part of a longer message; returns the request that it completes.

        Args:
            frame: one that it wanted.
            t_ns: now.
        """
        self._now_ns = max(self._now_ns, t_ns)
        pdu = read_pdu(frame)
        if pdu.pgn == ADDRESS_CLAIMED:
            self._made += self._claim.on_claim(pdu, self._now_ns)
            self._move()
            return None
        if pdu.source == self._claim.address != NULL:  # our own that has come back
            return None
        if pdu.pgn == REQUEST:
            request = self._requested(pdu.data, pdu.source, pdu.destination)
            return request if self._claim.claimed else None
        if not self._claim.claimed and pdu.destination != GLOBAL:
            return None
        made, message = self.transport.on_pdu(pdu, self._now_ns)
        self._made += made
        if message is None:
            return None
        if message.pgn == COMMANDED_ADDRESS and len(message.data) >= 9:
            self._command(message)
        if message.pgn != REQUEST or not self._claim.claimed:
            return None
        return self._requested(message.data, message.source, message.destination)

    def _move(self) -> None:
        """Have the transport protocol follow the address."""
        if self.transport.address != self._claim.address:
            self.transport.reset()
            self.transport.address = self._claim.address

    def _command(self, message: Message) -> None:
        if self._commandable:
            made = self._claim.command(message.data[:8], message.data[8], self._now_ns)
            self._made += made
            self._move()
            if made:
                self.commanded.append((message.source, message.data[:9]))

    def _requested(self, data: bytes, source: int, destination: int) -> PgnRequest | None:
        """Return a request, unless it is for the address claimed: that is answered here."""
        if len(data) < 3:
            return None
        pgn = int.from_bytes(data[:3], "little")
        if pgn == ADDRESS_CLAIMED:
            self._made += self._claim.on_request(self._now_ns)
            return None
        return PgnRequest(pgn, source, destination)

    def answer(self, request: PgnRequest, data: bytes) -> None:
        """Send the answer to a request; a request to all is answered to all (J1939-21, 5.4.2)."""
        self.send(request.pgn, data, GLOBAL if request.destination == GLOBAL else request.source)

    def acknowledge(self, kind: int, request: PgnRequest) -> None:
        """Acknowledge a request to this address alone; a request to all is not acknowledged."""
        if request.destination != GLOBAL:
            data = bytes([kind, 0xFF, 0xFF, 0xFF, request.source]) + pgn_bytes(request.pgn)
            self._made.append(Pdu(ACKNOWLEDGMENT, self.transport.address, GLOBAL, data))

    def send(self, pgn: int, data: bytes, destination: int) -> None:
        """Send a message, in one frame or in several."""
        self._made += self.transport.send(pgn, data, destination, self._now_ns)

    def pass_time(self, t_ns: int) -> int:
        """Claim, and send what is due of longer messages; returns its time, which never goes back."""
        self._now_ns = max(self._now_ns, t_ns)
        self._made += self._claim.on_time(self._now_ns)
        if self._claim.claimed:
            self._made += self.transport.on_time(self._now_ns)
        return self._now_ns

    def take_frames(self) -> Frames:
        """Return the frames to be sent by now, once."""
        made, self._made = self._made, []
        return to_frames(made, self._bus, self._now_ns)

    @property
    def next_ns(self) -> int:
        """Time at which :meth:`pass_time` has something to do next."""
        own = self._claim.next_ns
        return min(own, self.transport.next_ns) if self._claim.claimed else own

    def counters(self) -> dict[str, int]:
        """Return transport sessions that came to nothing, and those there was no room for."""
        return {"j1939_aborted": self.transport.aborted, "j1939_refused": self.transport.refused}
