"""Results of an ECU's own monitors, as classic OBD and OBD on UDS have them."""

import numpy as np
import pytest

from gateway.servers.tester_control import LatestResult
from gateway.signals.payloads import decode_columns
from gateway.signals.tables import compile_plan
from gateway_ask.answers.answer_frames import FrameEncoder
from gateway_ask.answers.j1979 import layouts_of_obd
from gateway_ask.answers.model import AnswerLayout, message_of, signal_of
from gateway_ask.answers.monitor_tests import results
from gateway_ask.answers.pages import answer_bus
from gateway_testers.obd.test_results import encode

#: Two results: 0.5 V of 0.3 to 0.7, and one whose scaling is in no public table.
FIRST, SECOND = bytes.fromhex("80 0B 01F4 012C 02BC"), bytes.fromhex("81 7F 0001 0000 0002")


@pytest.mark.parametrize("key", [(0x06, 0x01), (0x22, 0xF601)])
@pytest.mark.parametrize("answer", [b"\x46\x01" + FIRST + b"\x01" + SECOND, b"\x62\xf6\x01" + FIRST + SECOND])
def test_results_have_their_values_in_both_forms(key, answer):
    layout = next(one for one in layouts_of_obd([key], whole=False) if one.service == 0x06)
    bus = answer_bus([("", {(0x06, 0x01): layout})])
    weaver, plan = FrameEncoder(bus.pages[0], bus.lengths[0], 0), compile_plan([(0, bus.database)])
    frames = weaver.frames(answer, 0)
    found = decode_columns(frames[:1], plan, 0)
    at = {ref.signal: plan.position(*ref) for ref in plan.slot_names if ref.message == "A_0601"}
    values = {name: float(found.values[row, 0]) for name, row in at.items() if found.there[row, 0]}
    assert [values[name] for name in ("TEST1", "VALUE1", "LOW1", "HIGH1")] == pytest.approx([0x80, 0.5, 0.3, 0.7])
    assert values["TEST2"] == 0x81
    assert not np.isfinite(values.get("VALUE2", np.nan))
    assert "TEST3" not in values
    assert weaver.counts["decoded"] == 1


def test_a_files_own_layout_has_the_raw_bytes():
    raw = AnswerLayout(0x06, 0x01, message_of(0x06, 0x01, [signal_of("RAW", 23, 16, big=True)]))
    bus = answer_bus([("", {(0x06, 0x01): raw})])
    (frame,) = FrameEncoder(bus.pages[0], bus.lengths[0], 0).frames(b"\x46\x01" + FIRST, 0)
    assert bytes(frame["data"][1:5]) == FIRST[:4]


@pytest.mark.parametrize(("value", "failed"), [(-1.5, False), (3.25, True)])
def test_results_of_our_own_server_are_read_back(value, failed):
    """It chooses a scaling by itself, and the limit that the value must not exceed."""
    (read,) = results(b"\x80" + encode(LatestResult(value, 2.0, failed)))
    assert (read.value, read.high, read.passed) == (
        pytest.approx(value, abs=1e-3),
        pytest.approx(2.0, abs=1e-3),
        not failed,
    )
    assert [one.passed for one in results(b"\x80" + encode(None))] == [None]
