"""The same questions to Fault Diagnosis Toolbox (Frisk, Krysander, Jung), which nobody here wrote."""

import warnings

import numpy as np
import pytest
from random_models import random_model

from gateway_fdi.jit import COMPILED
from gateway_fdi.structure.decomposition import decompose
from gateway_fdi.structure.incidence import counted
from gateway_fdi.structure.isolability import (
    isolability_of_model,
    isolability_of_tests,
    signatures,
)
from gateway_fdi.structure.mso import find_msos
from gateway_fdi.structure.mtes import find_mtes
from gateway_fdi.structure.selection import fewest_tests
from gateway_fdi.structure.sensors import place_sensors

with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    fdt = pytest.importorskip("faultdiagnosistoolbox")

#: Sensors beyond the truck's five, in the order in which they are added.
SENSORS = ["U_b", "omega_w", "omega_em", "omega_mj", "T_mj"]


def toolbox(model):
    rows = []
    for e in model.equations:
        if e.differential:
            rows.append(fdt.DiffConstraint(f"der({e.differential})", e.differential))
        else:
            known = [v if v in model.variables else v[4:-1] for v in e.variables]
            rows.append([*dict.fromkeys(known), *e.knowns, *e.faults])
    return fdt.DiagnosisModel(
        {
            "type": "VarStruc",
            "x": list(model.variables),
            "f": list(model.faults),
            "z": list(model.knowns),
            "rels": rows,
        },
        name=model.name,
    )


def sets(rows):
    return {frozenset(np.flatnonzero(row).tolist()) for row in rows}


def theirs(rows):
    return {frozenset(int(i) for i in row) for row in rows}


@pytest.mark.long
@pytest.mark.parametrize("count", range(6))
@pytest.mark.parametrize("explicit", [False, True])
def test_msos_of_the_truck(truck, count, explicit):
    model = truck.with_sensors(SENSORS[:count])
    model = model.explicit() if explicit else model
    found = find_msos(counted(model))
    assert len(found) == [99, 212, 452, 754, 1189, 2291][count]
    assert len(found) == len(sets(found))
    assert sets(found) == theirs(toolbox(model).MSO())


@pytest.mark.long
@pytest.mark.parametrize("paired", [False, True])
@pytest.mark.parametrize("seed", range(20))
def test_random_models(seed, paired):
    """``paired``: several derivatives in an equation, which counts as lumped and as explicit alike."""
    model = random_model(seed, 8 + seed, 2 + seed % 4, states=2 + seed % 5 if paired else seed % 3, paired=paired)
    if paired and seed % 2:
        model = model.explicit()
    other = toolbox(model)
    found = find_msos(counted(model))
    assert sets(found) == theirs(other.MSO())
    rows = other.MSO()
    ours = np.zeros((len(rows), len(model.equations)), bool)
    for k, row in enumerate(rows):
        ours[k, row] = True
    assert (signatures(model, ours) == (other.FSM(rows) > 0)).all()
    structural = isolability_of_model(model)
    seen = structural.detectable
    assert (structural.confused[np.ix_(seen, seen)] == other.IsolabilityAnalysis()[np.ix_(seen, seen)]).all()
    detectable, _ = other.DetectabilityAnalysis()
    assert {f for f, d in zip(model.faults, seen, strict=True) if d} == set(detectable)
    if seen.any():
        assert sets(find_mtes(model)) == theirs(other.MTES())


def test_signatures_and_mtes_of_the_truck(truck):
    other = toolbox(truck)
    rows = other.MSO()
    ours = np.zeros((len(rows), len(truck.equations)), bool)
    for k, row in enumerate(rows):
        ours[k, row] = True
    assert (signatures(truck, ours) == (other.FSM(rows) > 0)).all()
    assert sets(find_mtes(truck)) == theirs(other.MTES())
    assert isolability_of_model(truck).full


def test_fewer_tests_than_theirs(truck):
    """Both isolate all five faults: ours with four tests, the least there can be, theirs with five."""
    found = find_msos(counted(truck))
    signature = signatures(truck, found)
    chosen = fewest_tests(signature, found.sum(1).astype(float))
    assert isolability_of_tests(truck.faults, signature[chosen]).full
    other = toolbox(truck)
    rows = other.MSO()
    assert len(chosen) == 4 < len(other.TestSelection(rows, method="aminc"))


@pytest.mark.long
@pytest.mark.skipif(not COMPILED, reason="thousands of decompositions")
def test_sensor_placement(truck):
    bare = truck.without(["e33", "e34", "e35", "e36", "e37"])
    assert bare.faults == ("f_b_sc", "f_pe", "f_em_eta", "f_em_R")
    places = ["I_b", "U_em", "I_em", "omega_e", "omega_gb", "U_b", "omega_w"]
    other = toolbox(bare)
    other.PossibleSensorLocations(places)
    for isolate, answer in (
        (False, other.SensorPlacementDetectability()[0]),
        (True, other.SensorPlacementIsolability()[0]),
    ):
        wanted = {tuple(sorted(str(x) for x in one)) for one in answer}
        found = set(place_sensors(bare, places, isolate=isolate))
        assert found == wanted, isolate


@pytest.mark.parametrize("seed", range(20))
def test_parts_of_random_models(seed):
    """M-, M0 and M+ of models with too few and with too many equations."""
    rng = np.random.default_rng(seed)
    full = random_model(seed, 12, 3, each=2)
    gone = [e.name for e in full.equations if rng.random() < 0.35]
    model = full.without(gone)
    structure = counted(model)
    ours = decompose(structure)
    dm = toolbox(model).GetDMParts()
    row = [structure.equations.index(x) for x in ours.over.equations]
    assert sorted(row) == sorted(int(i) for i in dm.Mp.row)
    assert {structure.equations.index(x) for x in ours.under.equations} == {int(i) for i in dm.Mm.row}
    blocks = {frozenset(structure.equations.index(x) for x in b.equations) for b in ours.just}
    assert blocks == {frozenset(int(i) for i in b.row) for b in dm.M0}
