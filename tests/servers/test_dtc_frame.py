"""DTC frames, decoded by cantools as a tester would."""

from pathlib import Path

import cantools
import pytest
from fault_examples import AtOnce, catalogue, event, nothing

from gateway.bus.frames import payload
from gateway.faults.store import Store
from gateway.servers.dtc_frame import DtcFrameParams, DtcFrameSender, read_dtc_frame

DBC = Path(__file__).parents[2] / "dbc" / "gateway.dbc"
MESSAGE = cantools.database.load_file(DBC).get_message_by_name("GW_DTC")
MS = 1_000_000


@pytest.fixture
def memory():
    made = AtOnce(catalogue(), Store(None))
    made.start_cycle(0)
    return made


def sender(memory, **params):
    return DtcFrameSender(DtcFrameParams(**params), DBC, 4, memory, lambda fault: -5)


def decoded(frames):
    assert all(int(f["can_id"]) == 0x6F0 and int(f["bus"]) == 4 for f in frames)
    return [MESSAGE.decode(payload(f)) for f in frames]


def test_a_change_is_sent_with_all_its_facts(memory):
    made = sender(memory)
    changes = memory.apply(event(1, True, 3 * MS), nothing)
    (values,) = decoded(made.on_changes(changes, 3 * MS))
    assert values == {
        "Dtc": 0x030111,
        "Status": 0x27,
        "FaultDetectionCounter": 127,
        "Index": 0,
        "Count": 1,
        "Occurrence": 1,
    }


def test_the_cyclic_list_and_its_all_clear_form(memory):
    made = sender(memory, cycle_ms=100.0)
    (values,) = decoded(made.on_time(0))
    assert (values["Dtc"], values["Count"], values["Index"]) == (0, 0, 0)
    assert len(made.on_time(99 * MS)) == 0
    for k in (2, 0):
        memory.apply(event(k, True), nothing)
    listed = decoded(made.on_time(100 * MS))
    assert [(v["Dtc"], v["Index"], v["Count"]) for v in listed] == [
        (0x030011, 1, 2),
        (0x030211, 2, 2),
    ]
    assert [v["FaultDetectionCounter"] for v in listed] == [-5, -5]


def test_the_cycle_neither_drifts_nor_bursts(memory):
    made = sender(memory, cycle_ms=100.0)
    sent = [t for t in range(0, 1000, 7) if len(made.on_time(t * MS))]
    assert len(sent) == 10
    assert all(abs(t - 100 * k) < 7 for k, t in enumerate(sent))
    assert len(made.on_time(60_000 * MS)) == 1
    assert len(made.on_time(60_001 * MS)) == 0, "no burst after a pause"


def test_a_chattering_dtc_is_limited_and_its_last_state_is_sent(memory):
    made = sender(memory, min_interval_ms=10.0)
    sent = []
    for t in range(40):
        changes = memory.apply(event(0, t % 2 == 0, t * MS), nothing)
        sent += decoded(made.on_changes(changes, t * MS))
    sent += decoded(made.on_changes([], 60 * MS))
    assert len(sent) == 5
    assert sent[-1]["Status"] == int(memory.status("m.f0")) == 0x2E
    assert sent[-1]["Occurrence"] == 20
    assert len(made.on_changes([], 90 * MS)) == 0


def test_what_we_read_back_is_what_was_sent(memory):
    made = sender(memory)
    changes = memory.apply(event(0, True, 3 * MS), nothing)
    frames = made.on_changes(changes, 3 * MS)
    report = read_dtc_frame(frames[0], DBC)
    assert (str(report.dtc), report.status, report.fdc, report.occurrence) == (
        "P0300-11",
        0x2F,
        127,
        1,
    )
    frames[0]["can_id"] = 0x6F1
    assert read_dtc_frame(frames[0], DBC) is None


def test_a_change_that_waited_tells_what_is_true_when_it_is_sent(memory):
    made = sender(memory, min_interval_ms=10.0)
    for t, failed in ((0, True), (1, False), (2, True)):
        made.on_changes(memory.apply(event(0, failed, t * MS), nothing), t * MS)
    memory.clear()
    (values,) = decoded(made.on_changes([], 20 * MS))
    assert (values["Status"], values["Occurrence"], values["FaultDetectionCounter"]) == (
        int(memory.status("m.f0")),
        0,
        -5,
    )
