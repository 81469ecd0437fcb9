"""Models of Fault Diagnosis Toolbox (Frisk, Krysander, Jung) entered as TOML: the same sets, isolability, residuals."""

import contextlib
import io
import warnings
from itertools import pairwise

import numpy as np
import pytest
from residual_runner import Runner

from gateway_fdi.structure.analysis import analyse
from gateway_fdi.structure.generator.loading import residual_generator
from gateway_fdi.structure.generator.propagation import sensors
from gateway_fdi.structure.isolability import isolability_of_tests, signatures

with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    pytest.importorskip("faultdiagnosistoolbox")
    from faultdiagnosistoolbox.models._induction_motor_model import model as induction_motor
    from faultdiagnosistoolbox.models._three_tank_model import model as three_tanks

MODELS = {"three_tanks": three_tanks, "induction_motor": induction_motor}
DT, SAMPLES, FINE = 1e-3, 400, 40
#: Where all states begin, here and there.
BEGIN = 0.3


def sets(rows):
    return {frozenset(int(e) for e in row) for row in rows}


@pytest.mark.parametrize("name", MODELS)
def test_sets_and_isolability(load, name):
    model, other = load(name), MODELS[name]
    found = analyse(model)
    rows = other.MSO()
    assert len(rows) == {"three_tanks": 6, "induction_motor": 9}[name]
    assert {frozenset(np.flatnonzero(row).tolist()) for row in found.msos} == sets(rows)
    assert (found.best.confused == other.IsolabilityAnalysis()).all()
    tests = [np.array(sorted(row)) for row in rows]
    ours = np.array([[e in row for e in range(len(model.equations))] for row in tests])
    told = isolability_of_tests(model.faults, signatures(model, ours))
    assert (told.confused == other.IsolabilityAnalysisArrs(tests)).all()


def generated(other, members, check, folder, monkeypatch):
    """The toolbox's residual generator: a function of sample, states, parameters and time, and the states' names."""
    monkeypatch.chdir(folder)
    matching = other.Matching(np.array([e for e in members if e != check]))
    with contextlib.redirect_stdout(io.StringIO()):
        other.SeqResGen(matching, check, "residual")
    source = (folder / "residual.py").read_text()
    scope = {}
    exec(compile(source, "residual", "exec"), scope)
    states = source.split("state = {")[1].split("}")[0].split("'")[1::2]
    return scope["residual"], states


def integral(other):
    """Sets and equations that the toolbox has integral causality for, without those that are a state's relation."""
    for row in other.MSO():
        members = sorted(int(e) for e in row)
        for check, kind in zip(members, other.MSOCausalitySweep(np.array(members)), strict=True):
            yield members, check, kind


@pytest.mark.long
@pytest.mark.parametrize("name", MODELS)
def test_residuals_of_integral_causality(load, name, tmp_path, monkeypatch):
    """Each equation that the toolbox checks in integral causality: the same residual, but for its sign.

    It steps by Euler's method: in fine steps, with sensors on a line between two samples, commands held.
    """
    model, other = load(name), MODELS[name]
    names = [e.name for e in model.equations]
    parameters = {p: model.quantities[p].value for p in model.parameters}
    rng = np.random.default_rng(1)
    samples = np.linspace(1, 2, len(model.knowns)) + 0.1 * np.cumsum(rng.normal(size=(SAMPLES, len(model.knowns))), 0)
    lines = np.array([z in sensors(model) for z in model.knowns])
    compared = 0
    for members, check, kind in integral(other):
        if kind != "int" or model.equations[check].differential:
            continue
        theirs, states = generated(other, members, check, tmp_path, monkeypatch)
        begin = dict.fromkeys(states, BEGIN)
        equations = frozenset(names[e] for e in members)
        loaded = residual_generator(model, equations, names[check], start=begin)
        assert set(loaded.generated.states) == set(states)
        ours = Runner(loaded).run([dict(zip(model.knowns, row, strict=True)) for row in samples], DT)
        expected = [-theirs(samples[0], dict(begin), parameters, DT)[0]]
        for here, after in pairwise(samples):
            for k in range(FINE):
                row = here + np.where(lines, k / FINE, 0.0) * (after - here)
                _, begin = theirs(row, begin, parameters, DT / FINE)
            expected.append(-theirs(after, dict(begin), parameters, DT)[0])
        assert np.abs(ours - np.array(expected)).max() < 2e-3
        assert np.abs(ours).max() > 0.1
        compared += 1
    assert compared == {"three_tanks": 7, "induction_motor": 4}[name]
