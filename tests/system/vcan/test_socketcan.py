"""The bus on a real interface, with python-can, raw sockets and can-utils as peers."""

import select
import socket
import struct
import subprocess
import time
from contextlib import suppress

import can
import numpy as np
import pytest
from kernel_can import can_frame, candump, drops_of, ip, raw

from gateway.bus import conditions as c
from gateway.bus.frames import BRS, ERROR, EXTENDED, FD, OWN, REMOTE, empty, payload, put
from gateway.bus.uri import open_bus
from gateway.live.transmit import Transmitter
from gateway_fdi.errors import BusError

pytestmark = pytest.mark.vcan


def take(bus, count):
    out = empty(count)
    got = 0
    while got < count and select.select([bus.fileno()], [], [], 60)[0]:
        got += bus.receive(out[got:])
    return out[:got]


def test_frames_of_all_kinds_both_ways():
    sent = empty(4)
    put(sent, 0, 0, 0x123, b"\x01\x02", bus=6)
    put(sent, 1, 0, 0x12345678 | EXTENDED, bytes(range(48)), bus=6, flags=FD | BRS)
    put(sent, 2, 0, 0x77 | REMOTE, b"", bus=6)
    put(sent, 3, 0, 0x7FF, bytes(8), bus=6)
    with (
        open_bus("socketcan:vcan0?rcvbuf=1000000", 6) as ours,
        can.Bus("vcan0", interface="socketcan", fd=True) as theirs,
        open_bus("socketcan:vcan0", 6) as other,
    ):
        assert ours.send(sent) == 4
        for frame in sent:
            message = theirs.recv(5)
            assert message.arbitration_id == int(frame["can_id"]) & 0x1FFFFFFF
            assert message.is_extended_id == bool(int(frame["can_id"]) & EXTENDED)
            assert message.is_remote_frame == bool(int(frame["can_id"]) & REMOTE)
            assert message.is_fd == bool(int(frame["flags"]) & FD)
            assert bytes(message.data) == payload(frame)
            theirs.send(message)
        for bus in (ours, other):
            got = take(bus, 4 if bus is ours else 8)
            got = got[-4:]
            assert all(abs(int(t) - time.time_ns()) < 60 * 10**9 for t in got["t_ns"])
            assert (np.diff(got["t_ns"]) > 0).all(), "the kernel's own stamps"
            got["t_ns"] = 0
            np.testing.assert_array_equal(got, sent)


def test_kernel_filters_keep_foreign_frames_back_and_error_frames_pass():
    with (
        open_bus("socketcan:vcan0", 0) as ours,
        can.Bus("vcan0", interface="socketcan") as theirs,
        raw("vcan0") as errors,
    ):
        ours.set_filters([0x700, 0x18FECA00 | EXTENDED])
        for can_id, extended in ((0x701, False), (0x700, True), (0x700, False), (0x18FECA00, True)):
            theirs.send(can.Message(arbitration_id=can_id, is_extended_id=extended))
        errors.send(can_frame(ERROR | c.BUS_OFF, bytes(8)))
        got = take(ours, 3)["can_id"].tolist()
        assert got == [0x700, 0x18FECA00 | EXTENDED, ERROR | c.BUS_OFF]
        assert ours.receive(empty(1)) == 0
        ours.set_filters(None)
        theirs.send(can.Message(arbitration_id=0x701, is_extended_id=False))
        assert take(ours, 1)["can_id"].tolist() == [0x701]


def test_own_frames_come_back_marked_when_asked_for():
    frame = empty(1)
    put(frame, 0, 0, 0x321, b"own")
    with open_bus("socketcan:vcan0", 0) as ours, raw("vcan0") as theirs:
        ours.send(frame)
        assert not select.select([ours.fileno()], [], [], 0.1)[0]
        assert ours.set_echo(True)
        ours.send(frame)
        theirs.send(can_frame(0x322))
        got = take(ours, 2)
        assert got["can_id"].tolist() == [0x321, 0x322]
        assert (got["flags"] & OWN != 0).tolist() == [True, False]
        assert got[0]["t_ns"] < got[1]["t_ns"], "stamped by the kernel when it was on the bus"


def test_overflow_is_counted_as_the_kernel_counts_it_and_told_where_it_was():
    with open_bus("socketcan:vcan0?rcvbuf=8192", 0) as ours, raw("vcan0") as theirs:
        for k in range(400):
            theirs.send(can_frame(0x100, k.to_bytes(2, "big")))
        dropped = drops_of(socket.socket(fileno=socket.dup(ours.fileno())))
        assert 0 < dropped < 400
        out = empty(256)
        first = ours.receive(out)
        assert first == 400 - dropped
        assert not ours.losses, "the kernel tells with the first frame behind the gap"
        for k in range(400, 403):
            theirs.send(can_frame(0x100, k.to_bytes(2, "big")))
        got = take(ours, 3)
        assert [int.from_bytes(payload(f), "big") for f in got] == [400, 401, 402]
        assert ours.statistics.overflow == dropped
        # Once more, with a gap in the middle of a batch.
        for k in range(400):
            theirs.send(can_frame(0x100, k.to_bytes(2, "big")))
        half = ours.receive(out[:5])
        assert half == 5
        for k in range(400, 450):
            theirs.send(can_frame(0x100, k.to_bytes(2, "big")))
        more = ours.receive(out)
        ((place, lost),) = ours.losses
        numbers = [int.from_bytes(payload(f), "big") for f in out[:more]]
        assert numbers[place] - numbers[place - 1] - 1 == lost
        assert ours.statistics.received == first + 3 + half + more


@pytest.mark.parametrize(
    ("can_id", "data", "said"),
    [
        (c.BUS_OFF, {}, "bus-off"),
        (c.RESTARTED, {}, "restarted-after-bus-off"),
        (c.NO_ACK, {}, "no-acknowledgement-on-tx"),
        (c.LOST_ARBITRATION, {0: 5}, "lost-arbitration{at bit 5}"),
        (c.CONTROLLER, {1: c.RX_PASSIVE}, "rx-error-passive"),
        (c.CONTROLLER, {1: c.TX_WARNING}, "tx-error-warning"),
        (c.CONTROLLER, {1: c.ACTIVE}, "back-to-error-active"),
        (c.CONTROLLER, {1: c.RX_OVERFLOW}, "rx-overflow"),
        (c.PROTOCOL, {2: 0x04, 3: 0x08}, "protocol-violation"),
        (c.TRANSCEIVER, {}, "transceiver-status"),
        (c.BUS_ERROR, {}, "bus-error"),
        (c.TX_TIMEOUT, {}, "tx-timeout"),
    ],
)
def test_our_names_of_errors_are_those_of_candump(can_id, data, said, tmp_path):
    content = bytes(data.get(k, 0) for k in range(8))
    log = tmp_path / "dump"
    with (
        open_bus("socketcan:vcan0", 0) as ours,
        raw("vcan0") as theirs,
        candump("-e", "-n", "1", "vcan0,0:0,#FFFFFFFF", log=log) as dump,
    ):
        theirs.send(can_frame(ERROR | can_id, content))
        dump.wait(60)
        (frame,) = take(ours, 1)
    assert int(frame["can_id"]) == ERROR | can_id
    assert payload(frame) == content
    assert said in log.read_text()


def test_a_full_queue_gives_pressure_back_and_loses_nothing():
    """A real queueing discipline that takes some 2 kB: what it does not take waits here, in order."""
    command = "qdisc add dev vcan1 root tbf rate 200kbit burst 256 limit 512"
    subprocess.run(["tc", *command.split()], check=True)
    try:
        frames = empty(200)
        for k in range(200):
            put(frames, k, 0, 0x7E8, k.to_bytes(2, "big"))
        with open_bus("socketcan:vcan1", 0) as ours, raw("vcan1") as theirs:
            waiting = Transmitter()
            waiting.send(ours, frames)
            assert 0 < len(waiting) < 200, "the queue was full"
            theirs.settimeout(0.02)
            seen = []
            limit = time.monotonic() + 120
            while len(seen) < 200 and time.monotonic() < limit:
                waiting.flush(ours)
                with suppress(TimeoutError):
                    seen.append(int.from_bytes(theirs.recv(16)[8:10], "big"))
            assert seen == list(range(200))
            assert (ours.statistics.sent, waiting.given_up) == (200, 0)
    finally:
        subprocess.run(["tc", "qdisc", "del", "dev", "vcan1", "root"], check=True)


def test_a_frame_that_the_interface_cannot_carry_is_counted_and_the_next_one_sent():
    ip("link", "set", "vcan1", "down")
    ip("link", "set", "vcan1", "mtu", "16", "up")
    try:
        frames = empty(2)
        put(frames, 0, 0, 0x100, bytes(64), flags=FD)
        put(frames, 1, 0, 0x101, b"classic")
        with open_bus("socketcan:vcan1", 0) as ours, raw("vcan1") as theirs:
            assert ours.send(frames) == 2
            theirs.settimeout(60)
            assert struct.unpack("=I", theirs.recv(16)[:4]) == (0x101,)
            assert (ours.statistics.sent, ours.statistics.refused) == (1, 1)
    finally:
        ip("link", "set", "vcan1", "down")
        ip("link", "set", "vcan1", "mtu", "72", "up")


def test_an_interface_that_is_not_there_or_down_is_a_clear_error():
    with pytest.raises(BusError, match="ip link add dev nosuch0 type vcan"):
        open_bus("socketcan:nosuch0")
    ip("link", "set", "vcan1", "down")
    try:
        with pytest.raises(BusError, match="ip link set vcan1 up"):
            open_bus("socketcan:vcan1")
    finally:
        ip("link", "set", "vcan1", "up")


def test_what_was_queued_when_the_interface_went_down_still_comes():
    with open_bus("socketcan:vcan1", 0) as ours, raw("vcan1") as theirs:
        for k in range(3):
            theirs.send(can_frame(0x100 + k))
        ip("link", "set", "vcan1", "down")
        try:
            assert take(ours, 3)["can_id"].tolist() == [0x100, 0x101, 0x102]
            with pytest.raises(BusError, match="down"):
                ours.receive(empty(1))
            frame = empty(1)
            with pytest.raises(BusError, match="not sent"):
                ours.send(frame)
        finally:
            ip("link", "set", "vcan1", "up")
