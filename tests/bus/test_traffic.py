"""Bits on the wire, counted by another way than the kernel's: a frame as text, stuffed by a regular expression."""

import random
import re

import numpy as np
import pytest
from amount import amount

from gateway.bus.frames import BRS, ERROR, EXTENDED, FD, REMOTE, empty, put
from gateway.bus.traffic import IDENTIFIERS, Traffic, load_of


def crc15(bits):
    """By division of polynomials, as CAN 2.0 B has it."""
    value = int(bits + "0" * 15, 2)
    divisor = 0b1100010110011001
    for shift in range(len(bits) - 1, -1, -1):
        if value >> (shift + 15) & 1:
            value ^= divisor << shift
    return f"{value:015b}"


def stuff(bits):
    out, run, last = "", 0, ""
    for bit in bits:
        out += bit
        run, last = (run + 1, bit) if bit == last else (1, bit)
        if run == 5:
            last, run = ("0" if bit == "1" else "1"), 1
            out += last
    assert not re.search("0{6}|1{6}", out)
    return out


def classic(can_id, data, *, remote=False):
    body = "" if remote else "".join(f"{byte:08b}" for byte in data)
    if can_id & EXTENDED:
        plain = can_id & 0x1FFFFFFF
        head = f"0{plain >> 18:011b}11{plain & 0x3FFFF:018b}{remote:d}00"
    else:
        head = f"0{can_id:011b}{remote:d}00"
    bits = head + f"{len(data):04b}" + body
    return len(stuff(bits + crc15(bits))) + 13


def count(can_id, data, flags=0):
    frames = empty(1)
    put(frames, 0, 5, can_id, data, flags=flags)
    traffic = Traffic(1)
    traffic.write(frames)
    return int(traffic.loads[0]["nominal_bits"]), int(traffic.loads[0]["data_bits"])


def test_the_bits_of_classical_frames_are_those_of_the_standard():
    """Known figures too: 8 bytes take 111 bits unstuffed at least (standard), 131 (extended)."""
    draw = random.Random(3)
    for _ in range(amount(3000, 300, 60)):
        extended = draw.random() < 0.5
        can_id = draw.getrandbits(29) | EXTENDED if extended else draw.getrandbits(11)
        data = bytes(draw.choice((0, 0xFF, draw.getrandbits(8))) for _ in range(draw.randrange(9)))
        remote = draw.random() < 0.2
        got = count(can_id | (REMOTE if remote else 0), data)
        assert got == (classic(can_id, data, remote=remote), 0), (hex(can_id), data.hex(), remote)
    assert count(0x2AA, bytes([0xAA] * 8))[0] >= 111
    assert count(0x0AAAAAAA | EXTENDED, bytes([0x55] * 8))[0] >= 131


def test_an_fd_frame_sends_its_data_fast():
    nominal, data = count(0x555, bytes([0x55] * 64), FD | BRS)
    assert data > 64 * 8 + 4 + 21 + 7 > nominal
    assert nominal < 60
    slow, none = count(0x555, bytes([0x55] * 64), FD)
    # BRS and ESI are both recessive in the one, dominant in the other: stuff bits may differ by one.
    assert none == 0
    assert abs(slow - nominal - data) <= 1


def test_periods_payloads_and_error_frames():
    frames = empty(7)
    for k, t_ms in enumerate((0, 10, 20, 31)):
        put(frames, k, t_ms * 10**6, 0x123, bytes([k, 7]), bus=1)
    put(frames, 4, 0, 0x123, b"", bus=0)
    put(frames, 5, 0, ERROR, bytes(8), bus=1)
    put(frames, 6, 0, 0x999, b"", bus=9)  # of no bus here
    traffic = Traffic(2)
    traffic.write(frames[:2])
    traffic.write(frames[2:])
    rows = traffic.identifiers()
    assert rows[["bus", "can_id", "count"]].tolist() == [(0, 0x123, 1), (1, 0x123, 4)]
    row = rows[1]
    assert (row["shortest_ns"], row["longest_ns"], row["sum_ns"], row["gaps"]) == (10**7, 11 * 10**6, 31 * 10**6, 3)
    assert row["words"].tobytes()[: row["length"]] == bytes([3, 7])
    assert traffic.loads["errors"].tolist() == [0, 1]
    assert traffic.identifiers()["gaps"].tolist() == [0, 0], "since the last look"


def test_identifiers_without_a_place_are_counted():
    frames = empty(IDENTIFIERS + 10)
    for k in range(len(frames)):
        put(frames, k, k, k | EXTENDED, b"")
    traffic = Traffic(1)
    traffic.write(frames)
    assert len(traffic.identifiers()) + int(traffic.loads[0]["others"]) == len(frames)
    assert len(traffic.identifiers()) <= IDENTIFIERS
    assert int(traffic.loads[0]["frames"]) == len(frames)


@pytest.mark.parametrize(
    ("bits", "rates", "load"),
    [((50_000, 0), (500_000, None), 0.1), ((50_000, 200_000), (500_000, 2_000_000), 0.2),
     ((50_000, 1), (500_000, None), None), ((5, 0), (None, None), None)],
)  # fmt: skip
def test_load_is_the_share_of_time(bits, rates, load):
    got = load_of(bits, rates, 1.0)
    assert got is None if load is None else np.isclose(got, load)
