"""Messages of several frames that nodes send to each other or to all: they are only heard, and nothing is sent.

Transport protocol (SAE J1939-21, 5.10), and fast packets (NMEA 2000): frames of the group itself, whose byte 0 has a
sequence number of the message in the upper three bits and the number of the frame, from 0; byte 1 of frame 0 is the
length. A message is whole or none: what is missing, late, given up or replaced is counted.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection

from gateway.j1939.frame import GLOBAL, TP_CM, TP_DT, Pdu
from gateway.j1939.transport import (
    ABORT,
    BAM,
    CTS,
    END_OF_MESSAGE,
    RTS,
    T1_NS,
    T2_NS,
    T3_NS,
    T4_NS,
    Incoming,
    Message,
    announced,
)

#: From this parameter group on (data page 1) a group that is longer than a frame comes as a fast packet.
FAST = 0x10000
#: Bytes of a fast packet at most.
LONGEST_FAST = 223
#: Messages that are under way at most.
MOST = 512
#: Why a message was not whole: a packet was not heard, the next one was late, a side gave it up, its sender began
#: another one, what its frames say cannot be, too many were under way.
CUTS = ("lost", "late", "aborted", "replaced", "malformed", "refused")
#: Packets whose beginning was not heard.
STRAY = "stray"

_Key = tuple[int, ...]


class Overheard:
    """Puts messages of all senders of one bus together.

    Args:
        wanted: parameter groups; messages of others are neither returned nor counted.
    """

    def __init__(self, wanted: Collection[int]) -> None:
        self._wanted = frozenset(wanted)
        self._open: dict[_Key, Incoming] = {}
        self._counts: Counter[str] = Counter()

    @property
    def counts(self) -> Counter[str]:
        """Messages that were not whole, by CUTS, and STRAY packets."""
        return self._counts + Counter(one.broken for one in self._open.values() if one.broken and self._wants(one))

    @property
    def cut(self) -> int:
        """Messages that were not whole."""
        return sum(count for reason, count in self.counts.items() if reason != STRAY)

    def _wants(self, session: Incoming) -> bool:
        return session.pgn in self._wanted

    def take(self, pdu: Pdu, t_ns: int) -> Message | None:
        """Take a frame of TP.CM, TP.DT or a fast packet; returns the message that it completes."""
        data = pdu.data
        if not data:
            return None
        if pdu.pgn == TP_CM:
            if len(data) == 8:
                self._control(pdu, t_ns)
            return None
        if pdu.pgn == TP_DT:
            return self._packet((pdu.source, pdu.destination), pdu, data[0], data[1:], t_ns)
        key = pdu.source, pdu.destination, pdu.pgn, data[0] >> 5
        number = data[0] & 0x1F
        if number:
            return self._packet(key, pdu, number, data[1:], t_ns)
        if len(data) < 3 or not 1 <= data[1] <= LONGEST_FAST:
            self._end(key)
            self._counts["malformed"] += pdu.pgn in self._wanted
            return None
        if self._begin(key, Incoming(pdu.pgn, data[1], t_ns + T1_NS, next=0), t_ns):
            return self._packet(key, pdu, 0, data[2:], t_ns)
        return None

    def _begin(self, key: _Key, made: Incoming, t_ns: int) -> bool:
        """Begin a message; returns whether there is room for it. One that was under way there is not whole."""
        before = self._open.get(key)
        if before is not None:
            began = before.next - made.next <= (len(key) > 2) and (before.pgn, before.size) == (made.pgn, made.size)
            if not before.broken and not began:  # the same beginning, sent twice, takes nothing away
                before.broken = "late" if t_ns >= before.due_ns else "replaced"
            self._end(key)
        elif len(self._open) >= MOST:
            self.pass_time(t_ns)
            if len(self._open) >= MOST:
                self._counts["refused"] += self._wants(made)
                return False
        self._open[key] = made
        return True

    def _end(self, key: _Key) -> None:
        """Forget a message; one that was not whole is counted."""
        session = self._open.pop(key, None)
        if session is not None and session.broken and self._wants(session):
            self._counts[session.broken] += 1

    def _packet(self, key: _Key, pdu: Pdu, number: int, part: bytes, t_ns: int) -> Message | None:
        session = self._open.get(key)
        if session is None:
            self._counts[STRAY] += 1
            return None
        late = t_ns >= session.due_ns
        session.due_ns = t_ns + T1_NS
        if session.broken:
            return None
        room = 7 if number or len(key) == 2 else 6
        if late:
            session.broken = "late"
        elif len(part) < min(room, session.size - len(session.data)):
            session.broken = "malformed"
        elif not session.take(number, part):
            session.broken = "lost"
        elif session.is_whole:
            del self._open[key]
            if self._wants(session):
                return session.message(pdu.source, pdu.destination, pdu.priority)
        return None

    def _control(self, pdu: Pdu, t_ns: int) -> None:
        data, pgn = pdu.data, int.from_bytes(pdu.data[5:8], "little")
        kind, forth, back = data[0], (pdu.source, pdu.destination), (pdu.destination, pdu.source)
        if kind in (RTS, BAM):
            size, possible = announced(data)
            if possible and (kind == BAM) == (pdu.destination == GLOBAL):
                self._begin(forth, Incoming(pgn, size, t_ns + (T1_NS if kind == BAM else T3_NS)), t_ns)
            else:
                self._counts["malformed"] += pgn in self._wanted
        for key in (forth, back) if kind == ABORT else (back,) if kind in (CTS, END_OF_MESSAGE) else ():
            session = self._open.get(key)
            if session is None or session.pgn != pgn:
                continue
            if kind == CTS:
                self._go_on(session, data[1], data[2], t_ns)
                continue
            session.broken = session.broken or ("aborted" if kind == ABORT else "lost")
            self._end(key)

    def _go_on(self, session: Incoming, count: int, first: int, t_ns: int) -> None:
        """Take that the receiver grants packets, or asks for some again, or holds the connection (``count`` 0)."""
        session.due_ns = t_ns + (T2_NS if count else T4_NS)
        if count and 1 <= first <= session.next:
            del session.data[7 * (first - 1) :]
            session.next, session.broken = first, ""
        elif count:
            session.broken = session.broken or "lost"

    def succeed(self, old: Overheard) -> None:
        """Go on with the messages that are under way, and the counts; the old one is not to be used any more."""
        self._open |= old._open
        self._counts.update(old._counts)

    def pass_time(self, t_ns: int) -> None:
        """Give up messages whose next packet is late."""
        for key, session in list(self._open.items()):
            if t_ns >= session.due_ns:
                session.broken = session.broken or "late"
                self._end(key)
