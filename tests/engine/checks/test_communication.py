"""Communication checks through the engine: each can fail, and guards the mailbox."""

import numpy as np
import pytest
from checked import frame, run
from pydantic import ValidationError

from gateway.engine.checks.kinds import COUNTER, CRC, KINDS, LENGTH, TIMEOUT, VALUE
from gateway.engine.checks.message import Params
from gateway_fdi.errors import InputError


def test_good_frames_pass_every_check():
    _, seen, value = run([frame(k * 10, k) for k in range(300)])
    assert {name for name, _ in seen} == {
        "timeout passed",
        "counter passed",
        "crc passed",
        "length passed",
        "rule passed",
    }
    assert value == 100


def test_corrupt_frames_fail_the_crc_and_never_reach_the_mailbox():
    right = [frame(10 * k, k, 50) for k in range(3)]  # as many as it takes until the rule is taken for the sender's
    engine, seen, value = run(right + [frame(10 * k, k, 60 + k, corrupt=True) for k in range(3, 6)])
    assert ("crc", 40) in seen
    assert value == 50
    assert engine.counters()["crc_failed"] == 3
    assert not any(name == "counter" for name, _ in seen)


@pytest.mark.parametrize("bit", range(64))
def test_every_bit_is_guarded_by_the_crc(bit):
    t_ns, data = frame(0, 0)
    broken = bytearray(data)
    broken[bit // 8] ^= 1 << (bit % 8)
    engine, _, value = run([(t_ns, bytes(broken))])
    assert engine.counters()["crc_failed"] == 1
    assert np.isnan(value)


def test_lost_frames_fail_the_counter_but_their_followers_are_used():
    engine, seen, value = run([frame(10 * k, 3 * k, 10 + k) for k in range(5)])
    assert ("counter", 30) in seen
    assert value == 14
    assert engine.counters()["repeated"] == 0


def test_repeated_frames_fail_the_counter_and_are_not_used():
    engine, seen, value = run([frame(10 * k, 7, 10 + k) for k in range(5)])
    assert ("counter", 30) in seen
    assert value == 10
    assert engine.counters()["repeated"] == 4


def test_counters_of_corrupt_frames_are_not_lost_frames():
    rows = [frame(10 * k, k, corrupt=k % 2 == 1) for k in range(40)]
    _, seen, _ = run(rows)
    assert not any(name == "counter" for name, _ in seen)


def test_the_counter_wraps():
    _, seen, _ = run([frame(10 * k, 250 + k) for k in range(100)])
    assert not any(name == "counter" for name, _ in seen)


def test_short_frames_fail_the_length():
    engine, seen, value = run([frame(0, 0)] + [frame(10 * k, k, 9, length=7) for k in (1, 2, 3)])
    assert ("length", 20) in seen
    assert value == 100
    assert engine.counters()["too_short"] == 3


def test_silence_fails_at_the_very_deadline():
    _, seen, _ = run([frame(0, 0), frame(10, 1), frame(500, 2)])
    assert ("timeout", 110) in seen


def test_a_crc_of_another_width_is_refused():
    with pytest.raises(InputError, match=r'check of "CTW_PT4".crc.signal.*the CRC has 8 bits, its signal 12'):
        run([], crc={"signal": "Pt0"})
    with pytest.raises(InputError, match="did you mean FrameCnt"):
        run([], counter={"signal": "FrameCount"})


def test_messages_have_dtcs_of_their_own():
    """U01xx lost communication, U04xx invalid data received; the failure type stays that of the check."""
    params = Params(message="SAS", timeout_ms=100.0, lost="U0126", invalid="U0428")
    codes = [KINDS[kind].fault_of(params).dtc for kind in (TIMEOUT, COUNTER, CRC, LENGTH, VALUE)]
    assert codes == ["U0126-87", "U0428-82", "U0428-83", "U0428-81", "U0428-29"]
    assert [k.fault_of(Params(message="SAS")).dtc for k in KINDS] == [k.fault.dtc for k in KINDS]
    with pytest.raises(ValidationError, match="lost"):
        Params(message="SAS", lost="P0126")
