"""Strangers' plants: their equations against the models' own writing, faults by their sizes, the official indexes."""

import math
from dataclasses import replace

import numpy as np
import pytest

from gateway_arena.contract import SAMPLES, Found
from gateway_arena.indexes import FROM_S, ON_S, decided, indexes
from gateway_arena.plants import plant, turbo, valve
from gateway_arena.scenarios import judged_scenarios
from gateway_arena.score import diagnoses
from gateway_fdi import Residual
from gateway_fdi.jit import zeros
from gateway_fdi.structure.model import ResidualChoice

SEED = 11


def errors(model, values):
    """Return right less left side of each equation, unknowns that it gives alone filled in; they are given in order."""
    tables = {name: lambda r, t=t: float(np.interp(r, t.x, t.y)) for name, t in model.tables.items()}
    values |= {p: model.quantities[p].value for p in model.parameters} | dict.fromkeys(model.faults, 0.0)
    left = {}
    for equation in model.equations:
        if equation.relation is None or "der(" in equation.relation.text:
            continue
        one, other = equation.relation.text.split(" = ", 1)
        known = {**vars(math), "min": min, "max": max, "abs": abs, **tables, **values}
        right = eval(other, {"__builtins__": {}}, known)
        left[equation.name] = right - values.setdefault(one, right) if one.isidentifier() else 0.0
    return left


def test_the_turbo_engine_at_rest_fulfils_the_equations_of_its_model():
    made = plant("turbo")
    c = zeros(1, turbo.Parameters)[0]
    for name, value in turbo.VALUES.items():
        c[name] = value
    rows, work = np.zeros((600, len(turbo.KNOWNS))), np.zeros((10, 13))
    turbo.simulate(rows, c, np.tile([280.0, 85e3], (601, 1)), np.zeros((600, 11)), work)
    assert np.ptp(rows[-50:], 0)[2:].max() < 0.05
    shown = dict(zip(turbo.KNOWNS, rows[-1].tolist(), strict=True))
    sensed = {name[1:]: value for name, value in shown.items() if name.startswith("y") and name != "yTq"}
    flows = dict.fromkeys(("W_c", "W_ic", "W_th", "W_cyl"), shown["yW_af"])
    off = errors(made.model, {**shown, **sensed, **flows, "w_t": work[0, 12] / 1e3})
    allowed = {"T": 0.02 * 298.0, "p": 0.2, "W": 0.02 * shown["yW_af"], "y": 0.5, "w": 0.01 * work[0, 12] / 1e3}
    for equation in made.model.equations:
        assert abs(off[equation.name]) < allowed[equation.relation.text[0] if equation.name != "e16" else "W"], (
            equation.name
        )
    turbine = made.model.equations[15].relation.text.split(" = ", 1)
    assert turbine[0].startswith("1.0662")


def test_the_valve_lets_through_what_its_law_says_and_follows_its_lever():
    made = plant("valve")
    fine = made.run(SEED, 300, "", 300, 0, 0.0, 0.0, np.array([0.0, 0.5, 1.0]))
    cv, p1, p2, _, x, flow = fine.values[200:].T
    there = flow < 38.0
    by_hand = 0.1 * 120.0 * np.exp(-5.0 * x) * np.sqrt((p1 - p2) * 991.0)
    assert np.abs(flow - by_hand)[there].max() < 0.05 * by_hand[there].max()
    lever = 0.5 + np.arcsin(x - 0.5) * 3.0 / np.pi
    assert np.abs(np.median(lever - cv)) < 0.02
    assert fine.values[200:, 5].max() > 39.0  # as figure 31 of the library's manual: the sensor is at its end


@pytest.mark.parametrize(
    ("name", "equations", "checked", "fault", "size"),
    [
        ("turbo", ("e8", "e9", "e10", "e19", "e20", "e21", "e22", "e24"), "e10", "fC_vol", 0.08),
        ("valve", ("e7", "e8", "e9", "e10", "e11", "e12", "e13"), "e10", "f19", -0.75),
    ],
)
def test_a_fault_has_its_size_in_a_residual_of_the_model(name, equations, checked, fault, size):
    made = plant(name)
    record = made.record(SEED, fault)
    residual = Residual(made.model, ResidualChoice(equations, checked))
    values = dict(zip(made.knowns, record.values.T, strict=True))
    found = residual.run(record.t_s, values)
    gain = residual.gain(fault, record.t_s, values, size=size, since=record.onset)
    behind = slice(record.onset + 20, None)
    assert float(found[behind] @ gain[behind] / (gain[behind] @ gain[behind])) == pytest.approx(size, rel=0.1)
    assert np.abs(found[240 : record.onset].mean()) < 0.1 * np.abs(found[behind].mean())


def test_the_indexes_are_those_of_the_definition():
    seconds = np.arange(1500)
    detected = ((seconds >= 400) & (seconds < 460)) | ((seconds >= 1000) & (seconds < 1100)) | (seconds >= 1200)
    primary = seconds >= 1300
    others = (2 * ((seconds >= 1200) & (seconds < 1260))).astype(np.int64)
    strength = np.clip((seconds - 900) / 400.0, 0.0, 1.0)
    found = indexes(detected, primary, others, strength, np.full(1500, 4))
    assert (found.t_dt, found.t_it, found.dacc) == (300.0, 400.0, 0.25)
    assert (found.r_fd, found.r_td) == pytest.approx((60 / 600, 400 / 600))
    assert (found.r_fi, found.r_ti, found.r_mi) == pytest.approx((0.0, 200 / 600, 120 / 1200))
    assert (found.fs_d, found.fs_i) == pytest.approx((0.75, 1.0))


def test_a_diagnosis_is_pointed_at_by_half_of_the_probability():
    score, weights = np.zeros(1500), np.zeros((1500, 3))
    score[950:] = 2.0
    weights[1000:, :2] = 0.3
    weights[1200:] = (0.1, 0.0, 0.8)
    found = decided(Found(score, weights), 1.0, 0, [[0, 1], [0, 1], [2]], np.ones(1500))
    assert (found.t_dt, found.t_it, found.dacc) == (50.0, 100.0, 0.5)
    assert found.r_ti == pytest.approx(200 / 600)
    assert found.r_mi == pytest.approx(300 / (1500 - ON_S))


def test_the_valve_has_the_44_scenarios_and_one_of_them_is_found():
    assert len(valve.SCENARIOS) == 44
    assert {one.lasts_s for one in valve.SCENARIOS} == {1500, 2400, 5100, 85_500}
    made = plant("valve")
    groups = diagnoses(made.model, list(made.sizes))
    assert len({tuple(group) for group in groups}) == 5  # f14 alone: nothing shows the chamber's pressure

    class Cold:
        def run(self, record):
            weights = np.zeros((len(record.values), 19))
            weights[:, 6] = 1.0
            return Found(np.abs(record.values[:, 3] - 43.0), weights)

    (scenario,) = [one for one in valve.SCENARIOS if (one.fault, one.mode) == ("f7", "S")]
    (row,) = judged_scenarios(made, {"cold": (Cold(), 10.0)}, 1, SEED, 0.0, [scenario])
    assert (row.detected, row.isolated) == (1, 1)
    assert row.indexes.t_dt <= 1.0
    assert replace(row.indexes, t_dt=0.0, t_it=0.0).r_td > 0.99
    assert SAMPLES > FROM_S
