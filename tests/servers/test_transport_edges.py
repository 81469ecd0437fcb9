"""The edges of ISO 15765-2 and ISO 14229-2, frame by frame (D6, D7, D8)."""

from itertools import pairwise

import pytest
from rig import FUNCTIONAL, MS

REQUEST, RESPONSE = 0x7E0, 0x7E8
KEEP = (FUNCTIONAL, bytes.fromhex("023e80"))


def extended(uds, messages=20):
    rig, ask = uds(messages=messages)
    for k in range(messages):
        rig.fail(k)
    assert ask("1003")
    rig.sent.clear()
    return rig, ask


def begin(rig, flow):
    """Ask for an answer of several frames, and give a flow control; returns the frames that follow at once."""
    rig.feed((REQUEST, bytes.fromhex("03190208")))
    return rig.feed((REQUEST, bytes.fromhex(flow)))


# Flow control


@pytest.mark.evidence("ISO 15765-2: STmin")
@pytest.mark.parametrize("stmin", [0x80, 0xA5, 0xF0, 0xFA, 0xFF])
def test_a_reserved_separation_time_is_the_longest_one(uds, stmin):
    rig, _ = extended(uds)
    first = begin(rig, f"3000{stmin:02x}")
    times = [rig.now] * len(first)
    for _ in range(3000):
        times += [rig.now] * len(rig.wait(1, step=1))
    assert len(times) == 11, "the whole answer"
    assert all(127 * MS <= b - a <= 129 * MS for a, b in pairwise(times[1:]))


@pytest.mark.evidence("ISO 15765-2: STmin")
@pytest.mark.parametrize("stmin", [0x00, 0x7F, 0xF1, 0xF9])
def test_other_separation_times_are_what_they_are(uds, stmin):
    from gateway.isotp.edges import judge

    frame = bytes([0x30, 0, stmin])
    assert judge(frame) == (frame, False)


@pytest.mark.evidence("ISO 15765-2: flow status")
@pytest.mark.parametrize("status", [3, 7, 0xF])
def test_a_reserved_flow_status_ends_the_answer(uds, status):
    rig, ask = extended(uds)
    assert begin(rig, f"3{status:x}0000") == []
    assert ask("3e00") == "7e00", "served again at once"
    assert rig.gateway.summary(1.0)["counters"]["isotp_errors"] == 1


@pytest.mark.evidence("ISO 15765-2: flow status")
def test_a_reserved_flow_status_that_nobody_waits_for_does_nothing(uds):
    rig, _ = extended(uds)
    frames = begin(rig, "300305")
    rig.feed((REQUEST, bytes.fromhex("3f0000")))
    for _ in range(30):
        frames += rig.wait(1, step=1)
    assert [data[0] for _, data in frames] == [0x21, 0x22, 0x23]


# First frames


@pytest.mark.evidence("ISO 15765-2: first frame")
@pytest.mark.parametrize(
    ("frame", "why"),
    [
        ("10073e0000000000", "seven bytes go into a single frame"),
        ("1001190200000000", "one byte does"),
        ("1000000000083e00", "the escape form of a length that needs none"),
        ("100000000fff3e00", "likewise: 4095"),
        ("1008", "not full"),
        ("100822f190f1", "not full"),
        ("100822f190f190", "one byte is missing"),
    ],
)
def test_first_frames_that_are_none_get_no_flow_control(uds, frame, why):
    rig, ask = uds()
    assert rig.feed((REQUEST, bytes.fromhex(frame))) == [], why
    assert ask("3e00") == "7e00"


@pytest.mark.evidence("ISO 15765-2: single frame")
def test_a_first_frame_of_eight_bytes_is_one(uds):
    rig, _ = uds()
    ((_, data),) = rig.feed((REQUEST, bytes.fromhex("100922f190f190f1")))
    assert data[0] == 0x30
    ((_, data),) = rig.feed((REQUEST, bytes.fromhex("1000000010003e00")))
    assert data[0] == 0x32, "too long for us: overflow"


@pytest.mark.evidence("ISO 15765-2: first frame")
def test_a_first_frame_that_is_none_leaves_what_is_under_way_alone(uds):
    rig, _ = uds()
    rig.feed((REQUEST, bytes.fromhex("100922f190f190f1")))
    rig.feed((REQUEST, bytes.fromhex("10073e0000000000")))
    (frame,) = rig.feed((REQUEST, bytes.fromhex("2190f190")))
    assert frame[1][0] & 0xF0 == 0x10, "the answer begins"


@pytest.mark.evidence("ISO 15765-2: first frame FD")
def test_a_first_frame_in_can_fd_is_longer_than_a_single_frame():
    from gateway.isotp.edges import judge

    def first(length, size):
        return (0x1000 | length).to_bytes(2, "big").ljust(size, b"\0")

    assert judge(first(62, 64)).data is None
    assert judge(first(63, 64)).data is not None
    assert judge(first(8, 12)).data is None
    assert judge(first(11, 12)).data is not None


# S3


@pytest.mark.evidence("ISO 14229-2: S3 long answer")
def test_a_long_answer_keeps_its_session(uds):
    """At 40 ms a frame it takes 9.2 s; with the tester's presence told meanwhile, and without."""
    rig, ask = extended(uds, 400)
    assert ask("8502") == "c502"
    for keeps in (True, False):
        begin(rig, "300028")
        for k in range(95):
            rig.wait(100)
            if keeps and k % 20 == 0:
                assert rig.feed(KEEP)[1:] == []
        rig.wait(4000)
        assert ask("22f186", patience=60) == "62f18603"
    rig.fail(0)
    assert rig.gateway.engine.tables.clock[0]["held"] == 1, "0x85 has lasted, too"


@pytest.mark.evidence("ISO 14229-2: S3 answer")
def test_the_session_ends_so_long_after_the_end_of_the_answer(uds):
    rig, ask = extended(uds, 60)
    begin(rig, "300014")
    ended = None
    for _ in range(2000):
        if rig.wait(1, step=1):
            ended = rig.now
    assert ended is not None
    rig.wait((ended + 4990 * MS - rig.now) / MS)
    assert rig.gateway.servers.all[0].uds.context.session == 3
    rig.wait(20)
    assert ask("22f186") == "62f18601"


@pytest.mark.evidence("ISO 14229-2: S3 request")
def test_a_request_on_its_way_keeps_the_session(uds):
    """Its first frame before the session's end, its last one after it."""
    rig, _ = extended(uds)
    rig.wait(4700)
    rig.feed((REQUEST, bytes.fromhex("100922f186f186f1")))
    rig.wait(600)
    ((_, data),) = rig.feed((REQUEST, bytes.fromhex("2186f186")))
    assert data[:2] == bytes([0x10, 13])
    rest = rig.feed((REQUEST, bytes.fromhex("300000")))
    assert (data[2:] + rest[0][1][1:]).hex().startswith("62f18603f18603f18603")


@pytest.mark.evidence("ISO 14229-2: S3 request")
def test_a_request_that_comes_to_nothing_keeps_it_only_so_long(uds):
    rig, ask = extended(uds)
    rig.wait(4700)
    rig.feed((REQUEST, bytes.fromhex("100922f186f186f1")))
    rig.wait(1100)  # given up after a second
    rig.wait(4800)
    assert rig.gateway.servers.all[0].uds.context.session == 3
    rig.wait(300)
    assert ask("22f186") == "62f18601"


@pytest.mark.evidence("ISO 14229-2: S3 late")
def test_a_first_frame_after_the_end_does_not_bring_the_session_back(uds):
    rig, _ = extended(uds)
    rig.now += 6000 * MS
    rig.feed((REQUEST, bytes.fromhex("100922f186f186f1")))
    ((_, data),) = rig.feed((REQUEST, bytes.fromhex("2186f186")))
    rest = rig.feed((REQUEST, bytes.fromhex("300000")))
    assert (data[2:] + rest[0][1][1:]).hex().startswith("62f18601")


@pytest.mark.evidence("ISO 14229-2: S3 silence")
def test_a_tester_that_falls_silent_in_an_answer_loses_its_session(uds):
    rig, ask = extended(uds)
    rig.feed((REQUEST, bytes.fromhex("03190208")))
    rig.wait(1100)  # no flow control
    rig.wait(4800)
    assert rig.gateway.servers.all[0].uds.context.session == 3
    rig.wait(300)
    assert ask("22f186") == "62f18601"


@pytest.mark.evidence("ISO 14229-2: one request")
def test_no_other_request_is_taken_during_an_answer(uds):
    rig, ask = extended(uds)
    rig.feed((REQUEST, bytes.fromhex("03190208")))
    assert rig.feed((FUNCTIONAL, bytes.fromhex("023e00"))) == []
    assert rig.feed((FUNCTIONAL, bytes.fromhex("021001"))) == []
    rig.wait(1100)
    assert ask("22f186") == "62f18603"
