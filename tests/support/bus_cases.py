"""Cases that any bus can be held to, and a driver of python-can that misbehaves.

A test derives from :class:`BusCases` and gives two ends of one bus, the first of which is tried.
"""

import threading
import time
from collections import deque

import can
import numpy as np
import pytest

from gateway.bus.base import send_all
from gateway.bus.frames import BRS, EXTENDED, FD, FRAME, OWN, REMOTE, empty, joined, payload, put

#: Only to catch hangs [s].
PATIENCE_S = 20


def frame(can_id, data=b"", flags=0):
    made = empty(1)
    put(made, 0, 0, can_id, data, flags=flags)
    return made


def received(bus, count):
    """Return so many frames; the bus is asked as the daemon does, when its descriptor says so."""
    parts, out, limit = [], empty(64), time.monotonic() + PATIENCE_S
    while sum(map(len, parts)) < count:
        assert time.monotonic() < limit, f"{sum(map(len, parts))} of {count} frames came"
        got = bus.receive(out)
        parts.append(out[:got].copy())
        if not got:
            time.sleep(0.001)
    return joined(parts)


def known(frames):
    """Return what a bus has to keep of frames."""
    return [(int(one["can_id"]), int(one["length"]), int(one["flags"]) & ~OWN, payload(one)) for one in frames]


class BusCases:
    """The cases; a class of tests has a fixture ``ends``: the bus, and another one on the same wire."""

    #: Whether it carries CAN FD.
    fd = True

    def samples(self):
        made = [
            frame(0x123, b"\x11\x22"),
            frame(0x1ABCDEF0 | EXTENDED, bytes(8)),
            frame(0x7FF),
            frame(0x124 | REMOTE, bytes(3)),
        ]
        return joined([*made, frame(0x55, bytes(range(48)), FD | BRS)] if self.fd else made)

    def test_frames_go_both_ways_as_they_are(self, ends):
        ours, theirs = ends
        for here, there in ((ours, theirs), (theirs, ours)):
            send_all(here, self.samples(), patience_s=PATIENCE_S)
            assert known(received(there, len(self.samples()))) == known(self.samples())

    def test_a_burst_keeps_its_order(self, ends):
        ours, theirs = ends
        burst = joined([frame(0x100 + k % 16, k.to_bytes(4, "big")) for k in range(300)])
        send_all(ours, burst, patience_s=PATIENCE_S)
        assert known(received(theirs, 300)) == known(burst)
        assert ours.statistics.sent == 300
        assert theirs.statistics.received == 300

    def test_records_are_whole(self, ends):
        ours, theirs = ends
        send_all(theirs, frame(0x321, b"\x01"), patience_s=PATIENCE_S)
        (one,) = received(ours, 1)
        assert one.dtype == FRAME
        assert int(one["bus"]) == ours.index
        assert int(one["t_ns"]) > 0
        assert not np.any(one["data"][1:])

    def test_nothing_there_is_no_wait(self, ends):
        assert ends[0].receive(empty(4)) == 0

    def test_closing_twice_does_no_harm(self, ends):
        ends[0].close()
        ends[0].close()


class Wire:
    """What drivers share: each hears the others."""

    def __init__(self):
        self.lock, self.drivers = threading.Lock(), []


class BadDriver(can.BusABC):
    """A driver of python-can that raises, garbles, echoes and fills up, as it is told.

    Args:
        wire: shared with others.
        raises_every: reading raises once in so many calls; 1: always, 0: never.
        full_every: sending raises once in so many calls; 1: always, 0: never.
        echoes: its own frames come back, without a mark.
        garbles: a message that no frame can be made of comes before each one.
    """

    def __init__(self, wire, *, raises_every=0, full_every=0, echoes=False, garbles=False):
        super().__init__(channel="bad")
        self.wire, self.messages = wire, deque()
        self.raises_every, self.full_every, self.echoes, self.garbles = raises_every, full_every, echoes, garbles
        self.reads = self.sends = 0
        with wire.lock:
            wire.drivers.append(self)

    def _recv_internal(self, timeout):
        self.reads += 1
        if self.raises_every and self.reads % self.raises_every == 0:
            raise ValueError("could not read an integer of '\\x07t12'")
        if not self.messages:
            time.sleep(min(timeout or 0, 0.001))
            return None, False
        return self.messages.popleft(), False

    def send(self, msg, timeout=None):
        self.sends += 1
        if self.full_every and self.sends % self.full_every == 0:
            raise can.CanOperationError("transmit buffer full")
        if msg.is_fd and self.garbles:
            raise ValueError("CAN FD is not supported")
        msg.timestamp, msg.is_rx = time.time(), True
        with self.wire.lock:
            for driver in self.wire.drivers:
                if driver is self and not self.echoes:
                    continue
                if driver.garbles:
                    driver.messages.append(
                        can.Message(arbitration_id=1, data=bytes(65), dlc=65, is_fd=True, check=False)
                    )
                driver.messages.append(msg)


def raising(bus):
    """Wait until a bus is lost; returns the error."""
    limit, out = time.monotonic() + PATIENCE_S, empty(4)
    with pytest.raises(Exception) as error:  # noqa: PT011 - which one is the test's business
        while time.monotonic() < limit:
            bus.receive(out)
            time.sleep(0.001)
    return error.value
