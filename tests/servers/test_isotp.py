"""ISO-TP below the servers: long requests and answers, CAN FD, a tester's pace and its silence."""

from itertools import pairwise

import pytest
from rig import MS, Tester


@pytest.mark.evidence("ISO 15765-2: CAN FD")
def test_can_fd_carries_an_answer_in_frames_of_64_bytes(uds):
    rig, _ = uds(messages=40, uds="fd = true")
    for k in range(40):
        rig.fail(k)
    tester = Tester(rig, can_fd=True, tx_data_length=64)
    answer = tester.ask("190208")
    assert len(answer) == 3 + 4 * 40
    lengths = [len(data) for can_id, data in rig.sent if can_id == 0x7E8]
    assert lengths == [64, 64, 48], "first frame, one whole, the rest padded to a length that there is"
    rig.sent.clear()
    assert tester.ask("22f190") == bytes.fromhex("62f190") + b"1HGCM82633A004352"
    ((_, data),) = [frame for frame in rig.sent if frame[0] == 0x7E8]
    assert data[:2] == bytes([0, 20]), "above 7 bytes a single frame has the escape form"


@pytest.mark.evidence("ISO 15765-2: CAN FD")
def test_a_classic_tester_is_answered_in_classic_frames(uds):
    rig, ask = uds()
    assert ask("22f190") == "62f190" + b"1HGCM82633A004352".hex()
    assert all(len(data) == 8 for can_id, data in rig.sent if can_id == 0x7E8)


@pytest.mark.evidence("ISO 15765-2: block size")
def test_the_testers_separation_time_and_block_size_are_kept(uds):
    rig, _ = uds(messages=20)
    for k in range(20):
        rig.fail(k)
    rig.sent.clear()
    (first,) = rig.feed((0x7E0, bytes.fromhex("03190208")))
    assert first[1][:2] == bytes.fromhex("1053")
    assert rig.wait(100) == [], "nothing more before flow control"
    sent = rig.feed((0x7E0, bytes.fromhex("300305")))  # 3 frames, 5 ms apart
    times = []
    for _ in range(40):
        times += [(rig.now, data[0]) for _, data in rig.wait(1, step=1)]
    assert [number for _, number in times] == [0x21, 0x22, 0x23]
    assert sent == []
    assert all(b - a >= 5 * MS for (a, _), (b, _) in pairwise(times))
    assert rig.feed((0x7E0, bytes.fromhex("310000"))) == [], "wait"
    rest = rig.feed((0x7E0, bytes.fromhex("300000")))
    assert [data[0] for _, data in rest] == list(range(0x24, 0x2C))


@pytest.mark.evidence("ISO 15765-2: N_Bs")
def test_a_tester_that_falls_silent_blocks_the_server_for_a_second(uds):
    rig, ask = uds(messages=20)
    for k in range(20):
        rig.fail(k)
    rig.feed((0x7E0, bytes.fromhex("03190208")))
    assert rig.feed((0x7E0, bytes.fromhex("023e00"))) == [], "an answer is under way"
    assert rig.wait(1010) == [], "and what was asked meanwhile is not answered later"
    assert ask("3e00") == "7e00"


@pytest.mark.evidence("ISO 15765-2: consecutive frame")
def test_a_long_request_is_put_together(uds):
    rig, ask = uds()
    assert ask("22" + "f190" * 5).count(b"1HGCM".hex()) == 5
    # A gap in its frames ends it; the next request is served.
    (flow,) = rig.feed((0x7E0, bytes.fromhex("100b22f190f190f1")))
    assert flow[1][0] == 0x30
    assert rig.feed((0x7E0, bytes.fromhex("22f190f190f190"))) == []
    assert ask("3e00") == "7e00"
    rig.feed((0x7E0, bytes.fromhex("100b22f190f190f1")))
    rig.wait(1100)
    assert rig.feed((0x7E0, bytes.fromhex("21f190f190f190"))) == [], "too late"
    assert ask("3e00") == "7e00"
