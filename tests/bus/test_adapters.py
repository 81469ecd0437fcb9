"""Buses by URI, the python-can adapter, and SocketCAN's structs over a socket pair."""

import select
import socket
import struct
import time

import can
import numpy as np
import pytest
from can.interfaces.socketcan.socketcan import build_can_frame
from hypothesis import given
from hypothesis import strategies as st

from gateway.bus.adapter import PythonCanBus
from gateway.bus.base import Statistics
from gateway.bus.can_structs import Packer, RawReceiver
from gateway.bus.frames import (
    BRS,
    ERROR,
    ESI,
    EXTENDED,
    FD,
    FD_LENGTHS,
    REMOTE,
    empty,
    payload,
    put,
    put_message,
    to_message,
)
from gateway.bus.logs import LogReader
from gateway.bus.socketcand import parse_extended
from gateway.bus.uri import loopback_address, open_bus
from gateway_fdi.errors import BusError, InputError


@pytest.mark.parametrize(
    ("uri", "match"),
    [
        ("vcan0", "a bus is named as"),
        (":x", "a bus is named as"),
        ("nonsense:x", "no such kind of bus"),
        ("virtual:", "the channel is missing"),
        ("loopback:192.168.0.1:29536", "stays on this machine"),
        ("loopback:example.org", "stays on this machine"),
        ("loopback:127.0.0.1:99999", "a port is"),
        ("socketcan:vcan0?bitrate=1", "fd=true and rcvbuf"),
    ],
)
def test_wrong_uris_say_what_would_be_right(uri, match):
    with pytest.raises(InputError, match=match):
        open_bus(uri)


def test_addresses():
    assert loopback_address("") == ("127.0.0.1", 29536)
    assert loopback_address("127.0.0.1") == ("127.0.0.1", 29536)
    assert loopback_address("127.0.0.2:1") == ("127.0.0.2", 1)
    assert loopback_address("4711") == ("127.0.0.1", 4711)
    assert loopback_address("[::1]:5") == ("::1", 5)
    assert loopback_address("localhost:5") == ("127.0.0.1", 5)


def test_a_python_can_client_joins_the_virtual_bus():
    with open_bus("virtual:joined", 2) as ours, can.Bus("joined", interface="virtual") as theirs:
        theirs.send(can.Message(arbitration_id=0x55, data=b"\x01", is_extended_id=False))
        assert select.select([ours.fileno()], [], [], 5)[0]
        out = empty(4)
        assert ours.receive(out) == 1
        assert (int(out[0]["can_id"]), int(out[0]["bus"])) == (0x55, 2)
        assert abs(int(out[0]["t_ns"]) - time.time_ns()) < 10 * 10**9
        frames = empty(1)
        put(frames, 0, 5_000_000_000, 0x66 | EXTENDED, b"\x09")
        ours.send(frames)
        got = theirs.recv(5)
        assert (got.arbitration_id, got.timestamp, bytes(got.data)) == (0x66, 5.0, b"\x09")


class Broken(can.BusABC):
    def __init__(self):
        super().__init__(channel="broken")
        self.count = 0

    def _recv_internal(self, timeout):
        self.count += 1
        if self.count > 3:
            raise can.CanOperationError("the dongle was pulled")
        return can.Message(arbitration_id=self.count, timestamp=1.0, is_extended_id=False), True

    def send(self, msg, timeout=None):
        raise can.CanOperationError("no")


def test_an_error_that_stays_reaches_the_caller_after_the_frames_before_it():
    with PythonCanBus("broken:x", 0, Broken()) as bus:
        got, out = 0, empty(8)
        with pytest.raises(BusError, match="the dongle was pulled"):
            for _ in range(20):
                assert select.select([bus.fileno()], [], [], 5)[0]
                got += bus.receive(out)
        assert got == 3
        with pytest.raises(BusError, match="sending failed"):
            bus.send(out[:1])


def test_no_socketcan_here_is_a_clear_error():
    try:
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
    except OSError:
        with pytest.raises(BusError, match="no SocketCAN"):
            open_bus("socketcan:vcan0")
    else:
        with pytest.raises(BusError, match="ip link"):
            open_bus("socketcan:nosuchcan9")


@pytest.fixture
def pair():
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    ours.setblocking(False)
    yield ours, theirs
    ours.close()
    theirs.close()


@given(
    st.lists(
        st.tuples(
            st.integers(0, 2**29 - 1),
            st.booleans(),
            st.booleans(),
            st.sampled_from([0, BRS, ESI, BRS | ESI]),
            st.sampled_from(FD_LENGTHS),
        ),
        max_size=40,
    ),
    st.randoms(use_true_random=False),
)
def test_structs_go_into_the_batch_and_come_out_of_it(rows, random):
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    ours.setblocking(False)
    with ours, theirs:
        statistics = Statistics()
        receiver = RawReceiver(ours, statistics)
        sent = empty(len(rows))
        for k, (can_id, extended, fd, flags, length) in enumerate(rows):
            can_id = can_id | EXTENDED if extended else can_id & 0x7FF
            body = random.randbytes(length if fd else min(length, 8))
            put(sent, k, 0, can_id, body, bus=5, flags=FD | flags if fd else 0)
        out = empty(64)
        out["data"] = 0xEE  # what was there before must not shine through
        pack = Packer()
        for frame in sent:
            theirs.send(pack(frame))
            beyond = frame.copy()
            beyond["data"][int(frame["length"]) :] = 0xEE  # is not sent
            theirs_made = bytearray(build_can_frame(to_message(frame)))
            theirs_made[7] = 0  # reserved: python-can has the length here once more
            assert pack(beyond) == pack(frame) == theirs_made
        assert receiver.receive(out, 5) == len(rows)
        got = out[: len(rows)].copy()
        assert all(abs(int(t) - time.time_ns()) < 60 * 10**9 for t in got["t_ns"])
        got["t_ns"] = 0
        np.testing.assert_array_equal(got, sent)
        assert statistics.received == len(rows)


def test_each_call_may_bring_a_batch_of_its_own(pair):
    ours, theirs = pair
    receiver = RawReceiver(ours, Statistics())
    batches = [empty(2) for _ in range(3)]
    for k, out in enumerate(batches):
        theirs.send(struct.pack("=IBBBB8s", 0x100 + k, 1, 0, 0, 0, bytes(8)))
        assert receiver.receive(out, 0) == 1
    assert [int(out[0]["can_id"]) for out in batches] == [0x100, 0x101, 0x102]


def test_bytes_beyond_the_length_are_not_taken(pair):
    ours, theirs = pair
    receiver = RawReceiver(ours, Statistics())
    theirs.send(struct.pack("=IBBBB8s", 0x123, 2, 0, 0, 0, b"abcdefgh"))
    theirs.send(struct.pack("=IBBBB8s", 0x123 | REMOTE, 4, 0, 0, 0, b"abcdefgh"))
    out = empty(4)
    assert receiver.receive(out, 0) == 2
    assert payload(out[0]) == b"ab"
    assert out[0]["data"].tolist() == [97, 98] + [0] * 62
    assert payload(out[1]) == b""
    assert (int(out[1]["length"]), out[1]["data"].any()) == (4, False), "its DLC is kept"


def test_datagrams_that_are_no_frames_are_counted(pair):
    ours, theirs = pair
    statistics = Statistics()
    receiver = RawReceiver(ours, statistics)
    for size in (1, 15, 17, 71):
        theirs.send(bytes(range(size)))
    theirs.send(struct.pack("=IBBBB8s", 0x123, 200, 0, 0, 0, b"abcdefgh"))
    out = empty(8)
    assert receiver.receive(out, 0) == 1
    assert payload(out[0]) == b"abcdefgh"
    assert statistics.rejected == 4


def test_a_frame_with_the_flags_of_a_whole_message_is_an_error_frame_at_each_door(tmp_path):
    """Both flags at once mark messages that the gateway has put together: nobody may send one in."""
    can_id, data = EXTENDED | ERROR | REMOTE | 0x123, bytes([1, 2, 3, 4, 5, 6, 7, 8])
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    received = empty(2)
    with ours, theirs:
        ours.setblocking(False)
        theirs.send(struct.pack("=IB3x8s", can_id, 8, data))
        assert RawReceiver(ours, Statistics()).receive(received, 0) == 1
    log = tmp_path / "a.log"
    log.write_text(f"(1.000000) can0 {can_id:08X}#{data.hex()}\n")
    message = can.Message(arbitration_id=0x123, is_error_frame=True, is_remote_frame=True)
    put_message(received, 1, message)
    doors = {
        "raw socket": int(received["can_id"][0]),
        "python-can": int(received["can_id"][1]),
        "hub": parse_extended(["x", f"{can_id:X}", "-", "0", data.hex()])[1],
        "log": int(next(iter(LogReader(log)))["can_id"][0]),
    }
    assert doors == dict.fromkeys(doors, EXTENDED | ERROR | 0x123)
