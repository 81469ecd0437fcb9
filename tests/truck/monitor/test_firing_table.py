"""Which tests fire, and which DTC is set: the paper's five faults on FTP75, through frames, database and engine."""

import numpy as np
import pytest
from amount import FULL, amount
from truck_runs import CONFIG, TABLE, TRUCK, driven, fired, fired_of_paper, run
from truck_runs import UNISOLATED as UNISOLATED_DTC

from gateway.runtime.app import Gateway
from gateway.signals.database import load_database
from gateway_fdi.jit import COMPILED
from gateway_plants.truck.ecu.drive import drive
from gateway_plants.truck.ecu.ecu import frames_of
from gateway_plants.truck.ecu.params import TruckFault
from gateway_plants.truck.monitor.faults import UNISOLATED, faults_of
from gateway_plants.truck.monitor.isolation import TESTS
from gateway_plants.truck.study import paper
from gateway_plants.truck.study.follow import inputs
from gateway_plants.truck.study.table import FAULTS

pytestmark = pytest.mark.skipif(not COMPILED, reason="hundreds of thousands of frames")


def right(events, dtc, onset, others=()):
    """Whether the fault's DTC was set, alone but for these others, and nothing before the onset."""
    failed = {(code, t) for t, code, now in events if now}
    return {dtc} <= {code for code, _ in failed} <= {dtc, *others} and min(t for _, t in failed) >= onset


ONSETS = (0.0, 400.0, 840.0, 1200.0)
#: Each fault with each onset; in CI each with one of them, and each onset comes.
CASES = [
    (*row, onset) for k, row in enumerate(TABLE) for j, onset in enumerate(ONSETS) if FULL or (j - k) % len(ONSETS) < 1
]


@pytest.mark.long
@pytest.mark.parametrize(("fault", "dtc", "papers", "robust", "onset"), CASES)
def test_exactly_the_tests_of_the_signature_fire(fault, dtc, papers, robust, onset):
    for seed in range(5000, 5000 + amount(20, 1)):
        peak, _, events = run(driven(fault, onset), seed)
        assert fired(peak) == robust, (seed, peak)
        assert right(events, dtc, onset), (seed, events)
        found = paper.follow(inputs(TRUCK, TruckFault(kind=fault, from_s=onset), seed), paper.Paper())
        assert fired_of_paper(dict(zip(paper.NAMES, found.peak, strict=True))) == (papers, papers), (seed, found.peak)
        own = FAULTS.index(fault)
        for system, first in found.first.items():
            # MCDS waits for the voltage sensor for a quarter of an hour, or to the end of the drive.
            assert onset <= first[:UNISOLATED].min() == first[own], (seed, system, first)


@pytest.mark.long
def test_no_alarm_without_a_fault():
    """FTP75, seeds that set no threshold; the largest T_norm of all quantities, of the paper's systems too."""
    worst = 0.0
    for seed in range(6000, 6000 + amount(20, 2)):
        peak, sets, events = run(driven(), seed)
        assert events == []
        assert sets == 187_400
        worst = max(worst, *peak.values(), *paper.follow(inputs(TRUCK, None, seed), paper.Paper()).peak)
    assert worst < 0.9


def test_one_test_alone_is_an_ambiguity_group_and_the_second_isolates():
    """The voltage sensor: T1 within a second, then only sensor and inverter explain it; T6 tells which.

    Meanwhile nothing is told: a fault has one code, its name.
    """
    frames = frames_of(TRUCK, driven("machine_voltage_sensor", 400.0), bus=0, rng=np.random.default_rng(3))
    names = faults_of(TESTS)[0].evidence
    tests, explained = names[len(TESTS)], names[len(TESTS) + 1]
    gateway, events = Gateway(CONFIG), []
    gateway.listen(lambda e: events.append(e) if e["event"] == "dtc" else None)
    gateway.start(0)
    gateway.feed(frames[: 4 * 40_020])
    state = gateway.engine.state_of(0)[0]
    assert state["fired"] == 1  # T1
    assert state["explained"] == sum(1 << int(digit) - 1 for digit in "52")
    assert events == []
    gateway.feed(frames[4 * 40_020 : 4 * 60_000])
    assert [(e["dtc"], e["status"] & 1) for e in events] == [("P1A14-64", 1)]
    assert events[0]["evidence"][tests] == 0b01001
    assert events[0]["evidence"][explained] == 5
    gateway.close()


@pytest.mark.long
def test_a_fault_that_goes_heals():
    """T does not grow beyond a limit, so that it comes down again; T7 follows the truth."""
    # T7 is not tested behind gear changes for as long as a clutch may creep: it takes two minutes of this drive.
    for kind, dtc, to_s in (("machine_voltage_sensor", "P1A14-64", 520.0), ("machine_efficiency", "P1A12-64", 620.0)):
        fault = TruckFault(kind=kind, from_s=430.0, to_s=to_s)
        events = run(drive(TRUCK, (fault,), 1100.0), 4)[2]
        last = {code: now for _, code, now in events}
        assert dtc in {code for _, code, now in events if now}
        assert last[dtc] == 0
        assert last.get(UNISOLATED_DTC, 0) == 0


@pytest.mark.long
def test_missing_frames_are_stepped_over_and_gaps_begin_anew():
    """1 % of the frames lost: sets without one are skipped, and nothing fires. Ten seconds of silence change
    nothing.
    """
    rng = np.random.default_rng(8)

    def lossy(frames):
        kept = rng.random(len(frames)) > 0.01
        kept[4 * 30_000 : 4 * 31_000] = False
        return frames[kept].copy()

    peak, sets, events = run(driven(), 7, change=lossy)
    assert 0.94 * 187_400 < sets < 0.97 * 187_400
    assert max(peak.values()) < 1.0
    assert {code for _, code, now in events if now and code.startswith("P")} == set()


def test_the_status_message_says_how_far_the_tests_are():
    """FDI_STATUS each 100 ms, decoded by cantools."""
    message = load_database(CONFIG.bus[0].database).message("FDI_STATUS")
    frames = frames_of(TRUCK, driven("battery_short", 400.0, 420.0), bus=0, rng=np.random.default_rng(1))
    gateway, sent = Gateway(CONFIG), []
    gateway.start(0)
    for k in range(0, len(frames), 4000):
        out = gateway.feed(frames[k : k + 4000])
        sent += [f for f in out if f["can_id"] == message.frame_id]
    gateway.close()
    rows = [message.decode(bytes(f["data"][:8]), decode_choices=False) for f in sent]
    assert len(rows) == 4200
    before, after = rows[3900:3999], rows[-1]
    assert {row["Diagnosis"] for row in before} == {0}
    assert max(row["Tn_2"] for row in before) < 1.0
    assert after["Diagnosis"] == 1
    assert after["Fired"] == 0b01010
    assert after["Tn_4"] > 1.0 > after["Tn_5"]
    assert [row["FrameCnt"] for row in rows[:20]] == [k % 16 for k in range(20)]
