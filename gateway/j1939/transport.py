"""Transport protocol (SAE J1939-21, 5.10): messages of 9 to 1785 bytes, to all (BAM) and to one (RTS/CTS).

Driven by the frames it is given and by time; every queue and table is bounded.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

from gateway.common.times import NEVER
from gateway.j1939.frame import GLOBAL, TP_CM, TP_DT, Pdu, pgn_bytes

RTS, CTS, END_OF_MESSAGE, BAM, ABORT = 16, 17, 19, 32, 255
#: Reasons of an abort.
RESOURCES, TIMEOUT, BAD_SEQUENCE = 2, 3, 7

LONGEST = 1785
#: Time between the packets of a broadcast; the standard allows 50 to 200 ms.
BAM_GAP_NS = 50_000_000
#: Timeouts T1 (next packet), T2 (packet after CTS), T3 (answer to RTS or the last packet), T4 (after a hold).
T1_NS, T2_NS, T3_NS, T4_NS = 750_000_000, 1_250_000_000, 1_250_000_000, 1_050_000_000
#: Packets that one CTS grants a sender.
GRANT = 16
#: Messages that wait to be sent, and messages that are being received, at most.
MOST_WAITING, MOST_RECEIVING = 32, 64


@dataclass
class _Outgoing:
    pgn: int
    destination: int
    data: bytes
    next: int = 1  # packet, from 1
    granted: int = 0  # last packet that may be sent now
    due_ns: int = NEVER

    @property
    def packets(self) -> int:
        return -(-len(self.data) // 7)

    def packet(self, number: int) -> bytes:
        part = self.data[7 * (number - 1) : 7 * number]
        return bytes([number]) + part.ljust(7, b"\xff")

    def header(self, control: int) -> bytes:
        last = b"\xff"
        size = len(self.data).to_bytes(2, "little")
        return bytes([control]) + size + bytes([self.packets]) + last + pgn_bytes(self.pgn)


@dataclass(frozen=True)
class Message:
    """A message received whole."""

    pgn: int
    source: int
    destination: int
    data: bytes
    priority: int = 6


@dataclass
class Incoming:
    """A message that is being received.

    Attributes:
        pgn: its parameter group.
        size: its length [byte].
        due_ns: when the next packet is late.
        data: that has come.
        next: packet that is to come, from 1.
        broken: why it will not be whole; "": it may be.
    """

    pgn: int
    size: int
    due_ns: int
    data: bytearray = field(default_factory=bytearray)
    next: int = 1
    broken: str = ""

    @property
    def packets(self) -> int:
        """Packets of the transport protocol that it has."""
        return -(-self.size // 7)

    @property
    def is_whole(self) -> bool:
        """Whether all of it has come."""
        return len(self.data) >= self.size

    def take(self, number: int, part: bytes) -> bool:
        """Take a packet; returns whether it is in its place. The last one, sent twice, is, and changes nothing."""
        if number == self.next:
            self.data += part
            self.next += 1
            return True
        return number == self.next - 1

    def message(self, source: int, destination: int, priority: int = 6) -> Message:
        """Return it, whole."""
        return Message(self.pgn, source, destination, bytes(self.data[: self.size]), priority)


def announced(data: bytes) -> tuple[int, bool]:
    """Return the length that an RTS or BAM announces [byte], and whether it can be so."""
    size = int.from_bytes(data[1:3], "little")
    return size, 9 <= size <= LONGEST and data[3] == -(-size // 7)


@dataclass
class _Session(Incoming):
    granted: int = 0  # 0: a broadcast
    most: int = GRANT  # packets that one CTS may grant


class Transport:
    """Sessions of one address.

    Args:
        address: our address; may change with :attr:`address`.
    """

    def __init__(self, address: int) -> None:
        self.address = address
        self._waiting: deque[_Outgoing] = deque()
        self._broadcast: _Outgoing | None = None
        self._sending: _Outgoing | None = None
        self._receiving: dict[tuple[int, int], _Session] = {}
        self.aborted = 0
        self.refused = 0

    def reset(self) -> None:
        """Forget every session, as when the address is lost."""
        self._waiting.clear()
        self._broadcast = self._sending = None
        self._receiving.clear()

    def send(self, pgn: int, data: bytes, destination: int, t_ns: int) -> list[Pdu]:
        """Send a message; returns what leaves now.

        A message of the same group to the same address that still waits is replaced: only the latest counts.
        """
        if len(data) <= 8:
            return [Pdu(pgn, self.address, destination, data.ljust(8, b"\xff"))]
        if len(data) > LONGEST:
            raise ValueError(f"{len(data)} bytes: the transport protocol carries {LONGEST}")
        made = _Outgoing(pgn, destination, data)
        for k, other in enumerate(self._waiting):
            if (other.pgn, other.destination) == (pgn, destination):
                self._waiting[k] = made
                return []
        if len(self._waiting) >= MOST_WAITING:
            self.refused += 1
            return []
        self._waiting.append(made)
        return self._begin(t_ns)

    def _begin(self, t_ns: int) -> list[Pdu]:
        """Begin what waits: one broadcast and one message to an address at a time."""
        made = []
        for message in list(self._waiting):
            if message.destination == GLOBAL and self._broadcast is None:
                self._broadcast = message
                message.due_ns = t_ns + BAM_GAP_NS
                message.granted = message.packets
                made.append(self._control(GLOBAL, message.header(BAM)))
            elif message.destination != GLOBAL and self._sending is None:
                self._sending = message
                message.due_ns = t_ns + T3_NS
                made.append(self._control(message.destination, message.header(RTS)))
            else:
                continue
            self._waiting.remove(message)
        return made

    def _control(self, destination: int, data: bytes) -> Pdu:
        return Pdu(TP_CM, self.address, destination, data, 7)

    def _abort(self, destination: int, pgn: int, reason: int) -> Pdu:
        self.aborted += 1
        return self._control(destination, bytes([ABORT, reason, 0xFF, 0xFF, 0xFF]) + pgn_bytes(pgn))

    def on_pdu(self, pdu: Pdu, t_ns: int) -> tuple[list[Pdu], Message | None]:
        """Take a frame of TP.CM or TP.DT; returns what leaves now, and a message that is complete."""
        if len(pdu.data) != 8:
            return [], None
        if pdu.pgn == TP_DT:
            return self._on_packet(pdu, t_ns)
        control = pdu.data[0]
        pgn = int.from_bytes(pdu.data[5:8], "little")
        if control in (RTS, BAM):
            return self._on_announcement(pdu, pgn, t_ns), None
        if control == CTS:
            return self._on_clear_to_send(pdu, pgn, t_ns), None
        sending = self._sending
        ours = sending is not None and (sending.destination, sending.pgn) == (pdu.source, pgn)
        if ours and control in (END_OF_MESSAGE, ABORT):
            self.aborted += control == ABORT
            self._sending = None
            return self._begin(t_ns), None
        if control == ABORT:
            key = pdu.source, pdu.destination
            if key in self._receiving and self._receiving[key].pgn == pgn:
                del self._receiving[key]
        return [], None

    def _on_announcement(self, pdu: Pdu, pgn: int, t_ns: int) -> list[Pdu]:
        size, possible = announced(pdu.data)
        to_all = pdu.data[0] == BAM
        if to_all != (pdu.destination == GLOBAL):
            return []
        if not possible:
            return [] if to_all else [self._abort(pdu.source, pgn, RESOURCES)]
        key = pdu.source, pdu.destination
        if key not in self._receiving and len(self._receiving) >= MOST_RECEIVING:
            self.refused += 1
            return [] if to_all else [self._abort(pdu.source, pgn, RESOURCES)]
        most = pdu.data[4]  # that the sender can send after one CTS; 0xFF: any number
        if not to_all and not most:
            return [self._abort(pdu.source, pgn, RESOURCES)]
        session = _Session(pgn, size, t_ns + T1_NS, most=min(GRANT, most))
        self._receiving[key] = session
        return [] if to_all else [self._grant(pdu.source, session, t_ns)]

    def _grant(self, source: int, session: _Session, t_ns: int) -> Pdu:
        count = min(session.most, session.packets - session.next + 1)
        session.granted = session.next + count - 1
        session.due_ns = t_ns + T2_NS
        data = bytes([CTS, count, session.next, 0xFF, 0xFF]) + pgn_bytes(session.pgn)
        return self._control(source, data)

    def _on_packet(self, pdu: Pdu, t_ns: int) -> tuple[list[Pdu], Message | None]:
        key = pdu.source, pdu.destination
        session = self._receiving.get(key)
        if session is None:
            return [], None
        before = session.next
        if not session.take(pdu.data[0], pdu.data[1:]):
            del self._receiving[key]
            if pdu.destination == GLOBAL:
                self.aborted += 1
                return [], None
            return [self._abort(pdu.source, session.pgn, BAD_SEQUENCE)], None
        if session.next == before:
            return [], None
        session.due_ns = t_ns + T1_NS
        if not session.is_whole:
            if session.granted and session.next > session.granted:
                return [self._grant(pdu.source, session, t_ns)], None
            return [], None
        del self._receiving[key]
        message = session.message(pdu.source, pdu.destination)
        if pdu.destination == GLOBAL:
            return [], message
        size = session.size.to_bytes(2, "little")
        data = bytes([END_OF_MESSAGE]) + size + bytes([session.packets, 0xFF])
        return [self._control(pdu.source, data + pgn_bytes(session.pgn))], message

    def _on_clear_to_send(self, pdu: Pdu, pgn: int, t_ns: int) -> list[Pdu]:
        sending = self._sending
        if sending is None or (sending.destination, sending.pgn) != (pdu.source, pgn):
            return []
        count, first = pdu.data[1], pdu.data[2]
        if count == 0:  # hold the connection
            sending.due_ns = t_ns + T4_NS
            return []
        if not 1 <= first <= sending.packets:
            self._sending = None
            return [self._abort(pdu.source, pgn, BAD_SEQUENCE), *self._begin(t_ns)]
        last = min(first + count - 1, sending.packets)
        sending.next = last + 1
        sending.due_ns = t_ns + T3_NS
        return [Pdu(TP_DT, self.address, pdu.source, sending.packet(number), 7) for number in range(first, last + 1)]

    def on_time(self, t_ns: int) -> list[Pdu]:
        """Send broadcast packets that are due, and give up sessions that have waited too long."""
        made: list[Pdu] = []
        for key, session in list(self._receiving.items()):
            if t_ns >= session.due_ns:
                del self._receiving[key]
                if key[1] == GLOBAL:
                    self.aborted += 1
                else:
                    made.append(self._abort(key[0], session.pgn, TIMEOUT))
        sending = self._sending
        if sending is not None and t_ns >= sending.due_ns:
            self._sending = None
            made.append(self._abort(sending.destination, sending.pgn, TIMEOUT))
        broadcast = self._broadcast
        if broadcast is not None and t_ns >= broadcast.due_ns:
            made.append(Pdu(TP_DT, self.address, GLOBAL, broadcast.packet(broadcast.next), 7))
            broadcast.next += 1
            # From now on, not from when it was due: receivers may rely on the least gap.
            broadcast.due_ns = t_ns + BAM_GAP_NS
            if broadcast.next > broadcast.packets:
                self._broadcast = None
        return made + self._begin(t_ns)

    @property
    def next_ns(self) -> int:
        """Time at which :meth:`on_time` has something to do."""
        sessions = [*self._receiving.values(), self._sending, self._broadcast]
        return min((s.due_ns for s in sessions if s is not None), default=NEVER)
