"""The hybrid powertrain's monitor on FTP75, through frames, database and engine."""

import functools
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from amount import amount

from gateway.app import Gateway
from gateway.config import load_config
from gateway.engine.tables import table
from gateway.fdi.structure.file import load_model
from gateway.fdi.structure.generator.code import write
from gateway.fdi.structure.generator.realisation import realise
from gateway.jit import COMPILED
from gateway.monitors.hybrid_powertrain import excitation, gate, isolation
from gateway.monitors.hybrid_powertrain import generated as folder
from gateway.monitors.hybrid_powertrain.faults import FAULTS
from gateway.monitors.hybrid_powertrain.generated import GENERATED
from gateway.monitors.hybrid_powertrain.params import QUANTITIES
from gateway.resources import shipped
from gateway.vecu.truck_drive import drive
from gateway.vecu.truck_ecu import frames_of
from gateway.vecu.truck_params import TruckFault, TruckParams

compiled = pytest.mark.skipif(not COMPILED, reason="hundreds of thousands of frames")
TRUCK = TruckParams(type="hybrid_truck")
CONFIG = load_config(shipped("configs/hybrid.toml"))
PLACES = {name: k for k, (name, _, _) in enumerate(QUANTITIES)}

#: Fault, its DTC, the tests that it fires: T1, T2, T3, T4.
TABLE = [
    ("machine_efficiency", "P1A12-64", (0, 0, 1, 1)),
    ("machine_resistance", "P1A13-64", (0, 1, 1, 0)),
    ("inverter_voltage", "P1A11-64", (1, 0, 1, 0)),
    ("battery_short", "P1A10-01", (0, 1, 0, 1)),
    ("machine_voltage_sensor", "P1A14-64", (1, 0, 0, 1)),
]
UNISOLATED = "P1A1F-62"
EVIDENCE = FAULTS[0].evidence


@functools.lru_cache(maxsize=2)
def driven(fault=None, onset=0.0, seconds=1874.0, start=0.0):
    faults = () if fault is None else (TruckFault(kind=fault, from_s=onset),)
    return drive(TRUCK.model_copy(update={"start_s": start}), faults, seconds)


def run(driven, seed, config=CONFIG, change=lambda frames: frames):
    """Largest T_norm of each quantity, and the DTC events with seconds since the begin."""
    frames = change(frames_of(TRUCK, driven, bus=0, rng=np.random.default_rng(seed)))
    frames["t_ns"] += 10**9
    gateway = Gateway(config)
    events = []
    gateway.listen(lambda e: events.append(e) if e["event"] == "dtc" else None)
    gateway.start(10**9)
    for k in range(0, len(frames), 100_000):
        gateway.feed(frames[k : k + 100_000])
    state = gateway.engine.state_of(0)[0]
    found = dict(zip(PLACES, np.array(state["cusum"]["peak"]), strict=True)), int(state["sets"])
    gateway.close()
    return *found, [((e["t_ns"] - 10**9) / 1e9, e["dtc"], e["status"] & 1) for e in events]


def fired(peak):
    """Tests that have fired, of ICDS and of MCDS."""
    static = (peak["T1"] > 1, peak["T2"] > 1)
    integral = (max(peak[f"{t}_signed"], peak[f"{t}_absolute"]) > 1 for t in ("T3", "T4"))
    mixed = (peak[f"{t}_mixed"] > 1 for t in ("T3", "T4"))
    return tuple(map(int, (*static, *integral))), tuple(map(int, (*static, *mixed)))


@compiled
@pytest.mark.parametrize("onset", [0.0, 400.0, 840.0, 1200.0])
@pytest.mark.parametrize(("fault", "dtc", "tests"), TABLE)
def test_firing_table(fault, dtc, tests, onset):
    """Exactly the tests of the fault's signature fire, in ICDS and in MCDS, and the fault's DTC is set, no other's."""
    for seed in range(amount(20, 1)):
        peak, _, events = run(driven(fault, onset), 5000 + seed)
        assert fired(peak) == (tests, tests), (seed, peak)
        failed = {(code, t) for t, code, now in events if now}
        assert dtc in {code for code, _ in failed}
        assert {code for code, _ in failed} <= {dtc, UNISOLATED}
        assert min(t for _, t in failed) >= onset


@compiled
def test_no_alarm_without_a_fault():
    """FTP75, seeds that set no threshold."""
    worst = 0.0
    for seed in range(amount(20, 2)):
        peak, sets, events = run(driven(), 6000 + seed)
        assert events == []
        assert sets == 187_400
        worst = max(worst, *peak.values())
    assert worst < 0.9


@compiled
@pytest.mark.parametrize(("fault", "dtc", "tests"), TABLE[2:4])
def test_mixed_causality_can_decide(fault, dtc, tests):
    (entry,) = CONFIG.monitor
    mixed = entry.model_copy(update={"system": "MCDS"})
    config = CONFIG.model_copy(update={"monitor": (mixed,)})
    events = run(driven(fault, 400.0), 1, config)[2]
    assert dtc in {code for _, code, now in events if now}
    assert {code for _, code, now in events if now} <= {dtc, UNISOLATED}


@compiled
def test_one_test_alone_is_an_ambiguity_group_and_the_second_isolates():
    """The voltage sensor: T1 within a second, then only inverter and sensor explain it; T4 tells which."""
    frames = frames_of(
        TRUCK, driven("machine_voltage_sensor", 400.0), bus=0, rng=np.random.default_rng(3)
    )
    gateway, events = Gateway(CONFIG), []
    gateway.listen(lambda e: events.append(e) if e["event"] == "dtc" else None)
    gateway.start(0)
    gateway.feed(frames)
    first = next(e for e in events if e["dtc"] == UNISOLATED)
    tests, explained = EVIDENCE[4], EVIDENCE[5]
    assert 400.0 <= first["t_ns"] * 1e-9 < 401.0
    assert first["evidence"][tests] == 1  # T1
    assert first["evidence"][explained] == 0b10010  # inverter and sensor
    second = next(e for e in events if e["dtc"] == "P1A14-64")
    assert second["t_ns"] > first["t_ns"]
    assert second["evidence"][tests] == 0b1001
    gateway.close()


@compiled
def test_a_fault_that_goes_heals():
    """T does not grow beyond a limit, so that it comes down again."""
    truck = TruckFault(kind="machine_voltage_sensor", from_s=30.0, to_s=60.0)
    events = run(drive(TRUCK.model_copy(update={"start_s": 160.0}), (truck,), 400.0), 4)[2]
    last = {code: now for _, code, now in events}
    assert last.get("P1A14-64", 0) == 0
    assert last[UNISOLATED] == 0


@compiled
def test_missing_frames_are_stepped_over_and_gaps_begin_anew():
    """1 % of the frames lost: sets without one are skipped, and nothing fires. Ten seconds of silence change nothing."""
    rng = np.random.default_rng(8)

    def lossy(frames):
        kept = rng.random(len(frames)) > 0.01
        kept[4 * 30_000 : 4 * 31_000] = False
        return frames[kept].copy()

    peak, sets, events = run(driven(), 7, change=lossy)
    assert 0.94 * 187_400 < sets < 0.97 * 187_400
    assert max(peak.values()) < 1.0
    assert {code for _, code, now in events if now and code.startswith("P")} == set()


@compiled
def test_sensor_noise_five_times_over_isolates_by_its_thresholds():
    """The sets are the same, nu is five times as large: no false alarm, and the battery is still named."""
    noisy = TRUCK.model_copy(update={"noise_factor": 5.0})
    (entry,) = CONFIG.monitor
    five = {
        "T1": 7.0,
        "T2": 9.6,
        "T3_ICDS": 1.42,
        "T4_ICDS": 1.42,
        "T3_MCDS": 0.24,
        "T4_MCDS": 0.24,
    }
    config = CONFIG.model_copy(update={"monitor": (entry.model_copy(update={"nu": five}),)})
    for fault, wanted in ((None, set()), ("battery_short", {"P1A10-01", UNISOLATED})):
        frames = frames_of(noisy, driven(fault), bus=0, rng=np.random.default_rng(9))
        gateway, events = Gateway(config), []
        gateway.listen(lambda e, found=events: found.append(e) if e["event"] == "dtc" else None)
        gateway.start(0)
        gateway.feed(frames)
        gateway.close()
        assert {e["dtc"] for e in events} == wanted


def test_the_generated_modules_are_what_the_model_gives():
    model = load_model(shipped("models/hybrid_truck.toml"))
    for module, (name, outputs) in GENERATED.items():
        choice = model.residuals[name]
        realised = realise(model, choice.equations, choice.consistency, outputs=outputs)
        path = Path(import_module(f"{folder.__name__}.{module}").__file__)
        assert path.read_text() == write(name, realised).source, "run scripts/generate-residuals"


def test_signatures_are_those_of_the_structure():
    c = table(1, isolation.CONST)
    isolation.prepare(c[0], load_model(shipped("models/hybrid_truck.toml")))
    assert list(c[0]["signature"]) == [0b1010, 0b0101, 0b1100, 0b0110, 0b1001]
    assert isolation.candidates(c[0], 0) == 0
    assert isolation.candidates(c[0], 0b0001) == 0b10010
    assert isolation.candidates(c[0], 0b1000) == 0b10101
    assert isolation.candidates(c[0], 0b1010) == 0b00001
    assert isolation.candidates(c[0], 0b0111) == 0
    assert [isolation.isolated(c[0], f) for f in (0b1010, 0b0101, 0b0001, 0b1111, 0)] == [
        0,
        1,
        -1,
        -1,
        -1,
    ]


def test_the_start_s_speed_has_no_lag_of_a_ramp():
    s = table(1, gate.STATE)
    for k in range(200):
        gate.update(s[0], 1.0, 12, 1.0, 150.0, 0.02 * k, 0.01)
    assert gate.speed(s[0]) == pytest.approx(0.02 * 199, abs=1e-3)
    assert s[0]["low"] < 0.02 * 199 - 0.1


def test_the_gate_opens_when_the_clutch_has_held():
    s = table(1, gate.STATE)

    def feed(count, clutch=1.0, gear=10, engine=150.0, gearbox=100.0):
        for _ in range(count):
            gate.update(s[0], clutch, gear, 1.5, engine, gearbox, 0.01)
        return gate.valid(s[0])

    assert not feed(29)
    assert feed(3)
    assert not feed(1, clutch=0.99)
    assert not feed(29)
    assert feed(3)
    assert not feed(20, engine=160.0)  # slips
    assert feed(100)
    assert not feed(100, engine=60.0, gearbox=40.0)  # below idle
    assert not feed(100, gear=0)


def test_conditions_of_excitation():
    s, c = table(1, excitation.STATE), table(1, excitation.CONST)
    c[0]["after"], c[0]["signed"], c[0]["absolute"], c[0]["efficiency"] = 1.0, 100.0, 100.0, 0.5
    for current in (100.0, -25.0) * 40:
        excitation.update(s[0], c[0], current, 2.0, 0.01)
    # Each step as motor 2 * 100 * 0.5, as generator 2 * 25 / 0.5: the same size, of two signs.
    assert s[0]["signed"] == pytest.approx(0.0)
    assert s[0]["absolute"] == pytest.approx(80.0)
    assert [excitation.excited(s[0], c[0], k) for k in range(3)] == [False, False, False]
    for _ in range(30):
        excitation.update(s[0], c[0], 100.0, 2.0, 0.01)
    assert [excitation.excited(s[0], c[0], k) for k in range(3)] == [True, False, True]
