"""Parts of the hybrid powertrain's monitor: generated code, signatures, gate, excitation, blanking."""

from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

from gateway_fdi.common.resources import shipped
from gateway_fdi.isolation import machine, table
from gateway_fdi.jit import zeros
from gateway_fdi.structure.file import load_model
from gateway_plants.truck import residual_generators
from gateway_plants.truck.monitor import blanking, gate, isolation
from gateway_plants.truck.monitor import generated as folder
from gateway_plants.truck.study import dynamic, excitation
from gateway_plants.truck.study.paper import TESTS


def test_the_generated_modules_are_what_the_model_gives(tmp_path, monkeypatch):
    monkeypatch.setattr(residual_generators, "FOLDER", tmp_path)
    residual_generators.make()
    for module in residual_generators.MODULES:
        found = Path(import_module(f"{folder.__name__}.{module}").__file__)
        assert found.read_text() == (tmp_path / f"{module}.py").read_text(), f"of an older model: delete {found}"
    assert {path.suffix for path in tmp_path.iterdir()} == {".py"}


def test_what_is_there_is_not_written_again(tmp_path, monkeypatch):
    monkeypatch.setattr(residual_generators, "FOLDER", tmp_path)
    for module in residual_generators.MODULES:
        (tmp_path / f"{module}.py").write_text("own")
    (tmp_path / "t2.py").unlink()
    residual_generators.make()
    written = {path.name for path in tmp_path.iterdir() if path.read_text() != "own"}
    assert written == {"t2.py"}


MODEL = load_model(shipped("models/truck.toml"))


def isolated(system="RDS"):
    """State and constants of the isolation, of a system of the paper's or of the monitor."""
    s, c = zeros(1, isolation.State)[0], zeros(1, isolation.Const)[0]
    if system in TESTS:
        isolation.prepare_table(s, c, MODEL, TESTS[system], 0.5)
    else:
        isolation.prepare(s, c, MODEL, 0.5)
    return s, c


@pytest.mark.parametrize(
    ("system", "test", "named"), [("RDS", "T5", 3), ("RDS", "T2", 5), ("RDS", "T1", 5), ("ICDS", "T3_ICDS", 5)]
)
def test_a_test_that_fires_alone_names_the_resistance_if_it_is_t5(system, test, named):
    """T2 sees a resistance above 100 A only; T1 would have told of an inverter."""
    s, c = isolated(system)
    tests = TESTS.get(system, isolation.TESTS)
    s.up[0], level = 1 << tests.index(test), np.zeros(len(isolation.TESTS))
    told = []
    for _ in range(200):
        machine.stand(s, c, 1_000_000_000, 1_000_000_000)
        machine.decide(s, c, level, table.answer(s, c), machine.contradicted(s))
        told.append(int(s.found))
    assert told == [table.NOTHING] * 60 + [named] * 140


def test_signatures_are_those_of_the_structure():
    for system in ("ICDS", "MCDS"):
        assert isolated(system)[1]["may"][:, 0].tolist() == [0b1010, 0b0101, 0b1100, 0b0110, 0b1001]
    robust = [0b01010, 0b00101, 0b10000, 0b00110, 0b01001]
    assert isolated()[1]["may"][:, 0].tolist() == robust


def test_candidates_explain_all_that_has_fired():
    s, c = isolated("ICDS")
    found = {}
    for fired in (0, 0b0001, 0b1000, 0b1010, 0b0111, 0b0101, 0b1111):
        s["fired"][0] = fired
        found[fired] = (table.answer(s, c), int(s["explained"][0]))
    assert found == {
        0: (table.NOTHING, 0),
        0b0001: (table.OPEN, 0b10010),
        0b1000: (table.OPEN, 0b10101),
        0b1010: (0, 0b00001),
        0b0111: (table.OPEN, 0),
        0b0101: (1, 0b00010),
        0b1111: (table.OPEN, 0),
    }


def test_candidates_are_ranked_by_how_near_their_tests_are():
    """T4 has fired: battery (with T2), efficiency (with T3) and sensor (with T1) explain it."""
    s, c = isolated("ICDS")
    s["explained"][0] = 0b10101
    assert table.ranked(s, c, np.array([0.9, 0.2, 0.5, 3.0, 0.0]), 10.0, 5) == 531
    assert table.ranked(s, c, np.array([0.1, 0.8, 0.5, 3.0, 0.0]), 10.0, 5) == 135
    s["explained"][0] = 0
    assert table.ranked(s, c, np.zeros(5), 10.0, 5) == 0


def test_a_gear_change_takes_away_what_is_before_and_behind_it():
    s = zeros(1, blanking.State)
    s[0]["gear"] = 5
    released = []
    for k in range(100):
        place = blanking.put(s[0], 10, 5 if k < 50 else 6, True, float(k), -float(k))
        if place >= 0:
            released.append((s[0]["held"][place, 0], s[0]["held"][place, 1]))
    kept = [k for k in range(90) if not 40 <= k < 60]
    assert released == [(k, -k) for k in kept]


def test_nothing_is_released_that_was_not_to_count():
    s = zeros(1, blanking.State)
    found = [blanking.put(s[0], 5, 0, k % 3 == 0, float(k), 0.0) for k in range(40)]
    values = [s[0]["held"][place, 0] for place in found if place >= 0]
    assert sum(place >= 0 for place in found) == 12  # of 0, 3, ... 33; 36 and 39 still wait
    assert all(value % 3 == 0 for value in values)


def test_the_speed_at_the_start_is_corrected_once():
    s = zeros(1, dynamic.State)
    dynamic.begin(s[0])
    corrections = []
    for k in range(300):
        s[0]["excitation"]["time"] = 0.01 * k
        settled = dynamic.settled(s[0])
        corrections.append((settled, dynamic.correction(s[0], 0.3 if k % 2 else 0.1)))
    assert [c for _, c in corrections if c] == [pytest.approx(0.2, abs=2e-3)]
    (at,) = (k for k, (_, c) in enumerate(corrections) if c)
    assert at == 101
    assert [settled for settled, _ in corrections] == [k > at for k in range(300)]


def test_the_start_s_speed_has_no_lag_of_a_ramp():
    s = zeros(1, gate.State)
    for k in range(200):
        gate.update(s[0], 1.0, 12, 1.0, 150.0, 0.02 * k, 0.01)
    assert gate.speed(s[0]) == pytest.approx(0.02 * 199, abs=1e-3)
    assert s[0]["low"] < 0.02 * 199 - 0.1


def test_the_gate_opens_when_the_clutch_has_held():
    s = zeros(1, gate.State)

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


def test_noise_does_not_close_a_gate_that_is_open():
    """Slip and engine speed have two levels each: one to open, one to close."""

    def opened():
        s = zeros(1, gate.State)
        for _ in range(40):
            gate.update(s[0], 1.0, 10, 1.5, 150.0, 100.0, 0.01)
        assert gate.valid(s[0])
        return s[0]

    def held(s, engine, gearbox):
        for _ in range(100):
            gate.update(s, 1.0, 10, 1.5, engine, gearbox, 0.01)
        return gate.valid(s)

    assert held(opened(), 158.0, 100.0)  # 8 rad/s of slip
    assert not held(opened(), 160.0, 100.0)  # 10
    assert held(opened(), 65.0, 65.0 / 1.5)
    assert not held(opened(), 63.0, 63.0 / 1.5)
    fresh = zeros(1, gate.State)[0]
    assert not held(fresh, 158.0, 100.0)
    assert not held(zeros(1, gate.State)[0], 65.0, 65.0 / 1.5)


def test_conditions_of_excitation():
    s, c = zeros(1, excitation.State), zeros(1, excitation.Const)
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
