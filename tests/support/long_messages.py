"""Messages of several frames as others send them: can-j1939 for the transport protocol, fast packets by hand."""

import heapq
from unittest import mock

from cantools.database.can import Message, Signal
from cantools.database.conversion import BaseConversion
from j1939 import j1939_21

from gateway.bus.frames import EXTENDED, empty, put


class Stack:
    """One node of can-j1939; what it sends is kept."""

    def __init__(self, address, heard):
        self.address, self.sent = address, []
        self._stack = j1939_21.J1939_21(
            self._send, lambda: None, lambda *message: heard.append(message), 8, None, None, lambda to: to == address
        )

    def _send(self, can_id, extended, data):
        self.sent.append((can_id, bytes(data)))

    def __getattr__(self, name):
        return getattr(self._stack, name)


def transported(pgn, source, destination, data, begin_s=1.0):
    """Return frames of a message by the transport protocol: (time [s], identifier, data), of both sides."""
    frames, heard, now = [], [], [begin_s]
    with mock.patch.object(j1939_21.time, "time", side_effect=lambda: now[0]):
        nodes = [Stack(source, heard), Stack(0xFE if destination == 0xFF else destination, heard)]
        low = destination if pgn >> 8 & 0xFF < 240 else pgn & 0xFF
        assert nodes[0].send_pgn(pgn >> 16, pgn >> 8 & 0xFF, low, 6, source, list(data), 0, 0)
        for _ in range(4000):
            for node, other in (nodes, nodes[::-1]):
                for can_id, said in node.sent:
                    frames.append((now[0], can_id, said))
                    other.notify(can_id, bytearray(said), now[0])
                node.sent.clear()
                node.async_job_thread(now[0])
            if heard and not nodes[1].sent:
                break
            now[0] += 0.01
    assert bytes(heard[-1][5]) == bytes(data), "the other side has received it"
    return frames


def fast(pgn, source, destination, data, number, begin_s=1.0, gap_s=0.002, priority=6):
    """Return frames of a fast packet: (time [s], identifier, data)."""
    can_id = priority << 26 | pgn << 8 | source | (destination << 8 if pgn >> 8 & 0xFF < 240 else 0)
    parts = [bytes([len(data)]) + data[:6], *(data[k : k + 7] for k in range(6, len(data), 7))]
    padded = [bytes([number % 8 << 5 | k]) + part.ljust(7, b"\xff") for k, part in enumerate(parts)]
    return [(begin_s + gap_s * k, can_id, part) for k, part in enumerate(padded)]


def batch(*messages, bus=0):
    """Return frames of messages, joined by time."""
    rows = list(heapq.merge(*messages, key=lambda row: row[0]))
    made = empty(len(rows))
    for k, (t_s, can_id, data) in enumerate(rows):
        put(made, k, round(t_s * 1e9), can_id | EXTENDED, data, bus=bus)
    return made


def signal(name, start, length, *, big=False, signed=False, scale=1, **more):
    """Return a signal."""
    order = "big_endian" if big else "little_endian"
    conversion = BaseConversion.factory(scale, 0)
    return Signal(name, start, length, order, is_signed=signed, conversion=conversion, **more)


def long_message(name, pgn, length, signals, source=0xFE):
    """Return a parameter group of J1939."""
    return Message(
        6 << 26 | pgn << 8 | source, name, length, signals, is_extended_frame=True, protocol="j1939", strict=False
    )
