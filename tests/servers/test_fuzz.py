"""Mutated requests and frames: no crash, no hang, no growth; and afterwards the server answers as before.

A million inputs in all with GATEWAY_TESTS=full, from seeds that every service knows, in two parts: whole requests into
the UDS and OBD servers, and ISO-TP frames into the transport below them. The seed is printed.
"""

import random
import tracemalloc

import pytest
from amount import amount
from rig import MS, Rig, write_config

from gateway.bus.frames import empty, put
from gateway.servers.uds.services import SERVICES

EXTRA = """
[output.uds]
security = [{ level = 1, secret = "00", attempts = 2, delay_s = 0.1 }]
[output.obd]
vin = "1HGCM82633A004352"
pid = [{ id = 0x0C, signal = "M0.Value" }]
[output.j1939]
[[did]]
id = 0x0124
name = "setting"
hex = "0102"
writable = true
"""

REQUESTS = [
    bytes.fromhex(text)
    for text in [
        "1001",
        "1003",
        "1101",
        "14ffffff",
        "14100011",
        "1901ff",
        "1902ff",
        "1903",
        "1904100011ff",
        "190410001101",
        "190501",
        "1906100011ff",
        "191601",
        "1917ff01",
        "1918df1168ff01",
        "1919df1168ff01",
        "191a01",
        "19563303",
        "1907e0ff",
        "1908e0ff",
        "1909100011",
        "190a",
        "190b",
        "190c",
        "190d",
        "190e",
        "1914",
        "1915",
        "194233ffe0",
        "195533",
        "220124",
        "22f186",
        "2701",
        "270200000000",
        "280001",
        "280101",
        "2e01240304",
        "31010201",
        "31010202",
        "31030202",
        "3e00",
        "3e80",
        "8501",
        "8502",
        "86010208190208",
        "860502",
        "860002",
        "860602",
        "860402",
        "0100",
        "0101",
        "010c",
        "020200",
        "03",
        "04",
        "07",
        "06e0",
        "06e1",
        "22f40cf6e1f802",
        "0900",
        "0902",
        "0a",
    ]
]
TOTAL = amount(1_000_000, 15_000, 2_000)


def mutated(rng, seeds):
    """Return a seed with bytes changed, cut off, doubled, put in; or noise."""
    data = bytearray(rng.choice(seeds))
    for _ in range(rng.randrange(4)):
        what = rng.randrange(5)
        at = rng.randrange(len(data) + 1)
        if what == 0 and data:
            data[at % len(data)] = rng.randrange(256)
        elif what == 1 and data:
            data[at % len(data)] ^= 1 << rng.randrange(8)
        elif what == 2:
            del data[at:]
        elif what == 3:
            data[at:at] = rng.randbytes(rng.randrange(1, 5))
        else:
            data += rng.choice(seeds)
    return bytes(data[:4095]) or b"\x00"


@pytest.fixture
def rig(tmp_path):
    rig = Rig(write_config(tmp_path, 6, extra=EXTRA), heard=False)
    for k in range(4):
        rig.fail(k)
    yield rig
    rig.close()


def grown(work, rounds):
    """Return how many bytes are held after many rounds beyond those held when every kind of input was there."""
    first = min(rounds // 3, 10_000)
    tracemalloc.start()
    work(first)
    before, _ = tracemalloc.get_traced_memory()
    work(rounds - first)
    after, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    print(f"{after - before} bytes grown")
    return after - before


@pytest.mark.evidence("ISO 14229-1: mutants")
@pytest.mark.long
def test_mutated_requests(rig):
    seed = 77
    print(f"seed {seed}")
    rng = random.Random(seed)
    server = rig.gateway.servers.all[0]
    # The disk is not what is tested here: clearing and routines would write 10^5 times.
    seeds = [request for request in REQUESTS if request[0] not in (0x04, 0x11, 0x14, 0x2E, 0x31)]
    slow = [request for request in REQUESTS if request not in seeds]
    now, negative = rig.now, 0

    def work(rounds):
        nonlocal now, negative
        for n in range(rounds):
            now += 100_000
            if n % 50 == 0:
                rig.gateway.advance(now)  # what was done is told
            request = mutated(rng, slow if n % 50 == 0 else seeds)
            functional = bool(n & 1)
            answers = server._answer(request, functional, now)
            answers += server.uds.pass_time(now)
            for answer in answers:
                assert 1 <= len(answer) <= 4095
                if answer[0] == 0x7F:
                    negative += 1
                    assert len(answer) == 3
                    assert answer[1] == request[0] or answer[2] != 0x11
                elif request[0] in SERVICES:
                    assert answer[0] >= 0x40

    assert grown(work, TOTAL // 2) < 250_000
    assert negative > TOTAL // 20
    server._answer(b"\x10\x01", False, now)
    assert server._answer(b"\x3e\x00", False, now) == [b"\x7e\x00"]


def isotp_frames(rng):
    """Return frames of a valid exchange: requests in one frame or several, flow control."""
    request = rng.choice(REQUESTS)
    if len(request) < 7 and rng.random() < 0.7:
        return [bytes([len(request)]) + request]
    request += rng.randbytes(rng.randrange(7, 40))
    frames = [(0x1000 | len(request)).to_bytes(2, "big") + request[:6]]
    for number, at in enumerate(range(6, len(request), 7), start=1):
        frames.append(bytes([0x20 | number & 15]) + request[at : at + 7])
    return frames


@pytest.mark.evidence("ISO 15765-2: mutants")
@pytest.mark.long
def test_mutated_frames(rig):
    """ISO-TP and J1939 frames, through the servers as the gateway calls them."""
    seed = 78
    print(f"seed {seed}")
    rng = random.Random(seed)
    isotp, j1939, _ = rig.gateway.servers.all
    j1939.on_time(0)
    j1939.on_time(10**9)
    ids = [0x7E0, 0x7DF]
    now = rig.now
    pages = [0xEA, 0xEB, 0xEC, 0xEE]
    batch = empty(1)

    def work(rounds):
        nonlocal now
        done = 0
        while done < rounds:
            frames = isotp_frames(rng)
            frames.append(bytes([0x30 | rng.randrange(4), rng.randrange(4), rng.randrange(256), 0, 0]))
            for frame in frames:
                now += rng.choice((10_000, MS, 300 * MS))
                data = mutated(rng, [frame])[:8] if rng.random() < 0.5 else frame
                put(batch, 0, now, rng.choice(ids), data)
                sent = isotp.on_frame(batch[0], now)
                assert len(sent) <= 700
                if done % 3 == 0:
                    number = rng.choice(pages) << 16 | rng.choice((0xFF, 0xF9)) << 8 | rng.randrange(254)
                    put(batch, 0, now, 0x98000000 | number, data.ljust(8, b"\xff")[:8])
                    j1939.on_frame(batch[0], now)
                    j1939.on_time(now)
                if done % 7 == 0:
                    isotp.on_time(now)
                if done % 70 == 0:
                    rig.gateway.advance(now)
                done += 1

    assert grown(work, TOTAL // 2) < 100_000
    now += 3_000 * MS
    isotp.on_time(now)
    isotp.on_time(now + 6_000 * MS)  # any session is over, any transfer given up
    now += 6_001 * MS
    put(batch, 0, now, 0x7E0, bytes.fromhex("023e00"))
    (answer,) = isotp.on_frame(batch[0], now)
    assert bytes(answer["data"][:3]) == bytes.fromhex("027e00")


def test_frames_of_a_bus_at_random_go_through_the_whole_gateway(rig):
    rng = random.Random(79)
    for _ in range(TOTAL // 250):
        can_id = rng.choice((0x7E0, 0x7DF, 256, 0x98EAFFF9, 0x98ECF921, rng.randrange(1 << 29) | 1 << 31))
        rig.feed((can_id, rng.randbytes(rng.randrange(9))))
        rig.sent.clear()
    rig.wait(10_000, step=100)
    rig.sent.clear()
    assert (0x7E8, bytes.fromhex("027e00cccccccccc")) in rig.feed((0x7E0, bytes.fromhex("023e00")))
