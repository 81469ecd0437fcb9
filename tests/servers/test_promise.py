"""Testers whose requests come while a successor is made are told to wait (0x78), if an answer comes for certain."""

import pytest
from rig import FUNCTIONAL, MS, REQUEST, Rig, write_config

from gateway.bus.frames import empty, payload, put

SERVERS = '[output.uds]\n[output.obd]\n[[did]]\nid = 0xF190\nname = "vin"\ntext = "ABC"\n'


@pytest.fixture
def rig(tmp_path):
    made = Rig(write_config(tmp_path, 1, extra=SERVERS))
    yield made
    made.close()


def held(rig, *payloads, can_id=REQUEST):
    """Return what is said to frames that a successor is fed, each of a turn of its own."""
    said = []
    for data in payloads:
        rig.now += MS
        frames = empty(1)
        put(frames, 0, rig.now, can_id, bytes.fromhex(data))
        said += [payload(f).hex() for f in rig.gateway.promise(frames, rig.now)]
    return said


def fed(rig, *payloads):
    return [data.hex() for _, data in rig.feed(*[(REQUEST, bytes.fromhex(data)) for data in payloads])]


@pytest.mark.evidence("ISO 14229-1: NRC 78")
def test_a_request_whose_last_frame_comes_meanwhile_is_promised_its_answer_once(rig):
    assert fed(rig, "101122f190f190f1") == ["300000cccccccccc"]
    rest = ["2190f190f190f190", "22f190f190cccccc"]
    assert held(rig, rest[0]) == [], "not whole"
    assert held(rig, rest[1]) == ["037f2278cccccccc"]
    assert held(rig, "2390f190f190f190") == []
    (first,) = fed(rig, *rest)
    assert first.startswith("10"), "and it is answered"


def test_more_frames_than_sequence_numbers_are_counted(rig):
    count = 20
    length = 6 + 7 * count
    assert len(fed(rig, f"10{length:02x}2ef190000000")) == 1
    rest = [f"2{k % 16:x}" + "00" * 7 for k in range(1, count + 1)]
    assert held(rig, *rest[:-1]) == []
    assert held(rig, rest[-1]) == ["037f2e78cccccccc"]


@pytest.mark.parametrize(
    ("rest", "why"),
    [
        (["22f190f190cccccc"], "a frame is missing"),
        (["2190f190f190f190", "2190f190f190f190", "22f190f190cccccc"], "one came twice"),
        (["023e000000000000", "2190f190f190f190", "22f190f190cccccc"], "another request came between"),
    ],
)
def test_a_request_that_breaks_off_is_promised_nothing(rig, rest, why):
    fed(rig, "101122f190f190f1")
    assert held(rig, *rest) == [], why


def test_a_request_that_was_waited_for_too_long_is_promised_nothing(rig):
    fed(rig, "101122f190f190f1")
    rig.now += 2000 * MS
    assert held(rig, "2190f190f190f190", "22f190f190cccccc") == []


def test_an_answer_that_may_be_suppressed_is_not_promised(rig):
    """After 0x78 it must not be suppressed (ISO 14229-1, 8.7)."""
    fed(rig, "10083181020200")
    assert held(rig, "2100000000000000") == []


def test_frames_of_an_older_reload_that_failed_do_not_count(rig):
    fed(rig, "101122f190f190f1")
    held(rig, "2190f190f190f190")
    fed(rig, "2190f190f190f190")
    assert held(rig, "22f190f190cccccc") == ["037f2278cccccccc"]


def test_physical_requests_of_obd_are_promised_their_answers(rig):
    assert held(rig, "0103000000000000") == ["037f0378cccccccc"]
    assert held(rig, "0103000000000000", can_id=FUNCTIONAL) == [], "it may stay without an answer"
    assert fed(rig, "0103000000000000") == ["024300cccccccccc"]
