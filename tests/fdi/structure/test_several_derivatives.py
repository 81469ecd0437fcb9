"""Several derivatives in one equation: a cylinder behind a servo valve, as analysed and as residuals that run."""

import warnings
from itertools import pairwise

import numpy as np
import pytest
from residual_runner import Runner
from scipy.linalg import expm

from gateway_fdi.structure.analysis import analyse
from gateway_fdi.structure.generator.loading import residual_generator
from gateway_fdi.structure.generator.realisation import realise
from gateway_fdi.structure.generator.solver import NotSolvableError
from gateway_fdi.structure.isolability import isolability_of_model
from gateway_fdi.structure.mtes import find_mtes

with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    fdt = pytest.importorskip("faultdiagnosistoolbox")

DT = 1e-4


@pytest.fixture(scope="module")
def servo(load):
    return load("servo_valve")


def test_the_analysis_is_the_toolbox_s(servo):
    """The same model entered there by hand, with three relations between states and derivatives."""
    rows = [
        ["dxv", "xv", "u", "f_v"], ["q", "xv", "p"], ["dx", "dp", "q", "p", "f_l"], ["dv", "p", "v", "f_F"],
        ["v", "dx"], fdt.DiffConstraint("dx", "x"), ["y_s", "xv", "f_s"], ["y_p", "p", "f_p"], ["y_x", "x", "f_x"],
        fdt.DiffConstraint("dxv", "xv"), fdt.DiffConstraint("dp", "p"), fdt.DiffConstraint("dv", "v"),
    ]  # fmt: skip
    other = fdt.DiagnosisModel(
        {
            "type": "VarStruc",
            "x": ["xv", "q", "p", "x", "v", "dxv", "dp", "dx", "dv"],
            "f": list(servo.faults),
            "z": list(servo.knowns),
            "rels": rows,
        }
    )
    model = servo.explicit()
    assert [e.name for e in model.equations][9:] == ["d/dt xv", "d/dt p", "d/dt v"]
    found = analyse(model)
    theirs = {frozenset(map(int, row)) for row in other.MSO()}
    assert {frozenset(np.flatnonzero(row).tolist()) for row in found.msos} == theirs
    assert len(theirs) > 3
    assert {frozenset(np.flatnonzero(row).tolist()) for row in find_mtes(model)} == {
        frozenset(map(int, row)) for row in other.MTES()
    }
    assert (isolability_of_model(model).confused == other.IsolabilityAnalysis()).all()
    # Lumped, the relations belong to the equations: the same sets, without their names.
    shorter = {frozenset(k for k in row if k < 9) for row in theirs}
    assert {frozenset(np.flatnonzero(row).tolist()) for row in analyse(servo).msos} == shorter


def driven(servo, leak=1.0, samples=4000):
    """Samples of the valve, whose command is held: by the matrix exponential."""
    v = {p: servo.quantities[p].value for p in servo.parameters}
    slopes = np.zeros((5, 5))  # of spool, pressure, position, speed, command
    slopes[0, [0, 4]] = -1 / v["tau"], v["k_v"] / v["tau"]
    slopes[1, [0, 1, 3]] = np.array([v["k_q"], -v["k_c"] - leak * v["c_l"], -v["A"]]) / v["C"]
    slopes[2, 3] = 1.0
    slopes[3, [1, 3]] = v["A"] * 10.0 / v["m"], -v["b"] / v["m"]
    turn, x, rows = expm(DT * slopes), np.zeros(4), []
    for k in range(samples):
        u = 3.0 * np.sin(40.0 * k * DT)
        rows.append({"u": u, "y_s": x[0], "y_p": x[1], "y_x": x[2]})
        x = (turn @ [*x, u])[:4]
    return rows


@pytest.mark.costly
def test_residuals_that_run(servo):
    """Each generator that can be written is zero on healthy data, to rounding or the filter's step; and sees a leak."""
    healthy, leaking = driven(servo), driven(servo, leak=3.0)
    found = analyse(servo)
    usable = found.candidates.chosen("SDI", "unique")
    seen = integral = 0
    for k in np.flatnonzero(usable):
        names = frozenset(found.structure.names(found.msos[found.candidates.mso[k]]))
        check = found.structure.equations[found.candidates.equation[k]]
        try:
            loaded = residual_generator(servo, names, check, start=dict.fromkeys(servo.states, 0.0))
        except NotSolvableError as error:
            assert "differentiate" in str(error)
            continue
        filters = bool(loaded.generated.realisation.transformed)
        residual = Runner(loaded, filter_bandwidth=50.0).run(healthy, DT)
        faulty = Runner(loaded, filter_bandwidth=50.0).run(leaking, DT)
        assert np.abs(residual).max() < (1e-2 if filters else 1e-5), (names, check)
        if "e3" in names:
            assert np.abs(faulty).max() > 20 * np.abs(residual).max(), (names, check)
            seen += 1
        integral += not filters
    assert seen >= 4
    assert integral >= 2


def test_both_derivatives_are_avoided(servo):
    """Continuity checked by spool, pressure and position: r~ = der(x) + C/A der(p) + b, as the filter is by hand."""
    names = frozenset({"e2", "e3", "e6", "e7", "e8", "e9"})
    realised = realise(servo, names, "e3")
    assert set(realised.transformed) == {"x", "p"}
    rows = driven(servo, leak=2.0)
    loaded = residual_generator(servo, names, "e3")
    ours = Runner(loaded, filter_bandwidth=20.0).run(rows, DT)
    value = {p: servo.quantities[p].value for p in servo.parameters}
    keep, r, expected = np.exp(-20.0 * DT), 0.0, [0.0]

    def b(row):
        q = value["k_q"] * row["y_s"] - value["k_c"] * row["y_p"]
        return -(q - value["c_l"] * row["y_p"]) / value["A"]

    for before, row in pairwise(rows):
        slope = (row["y_x"] - before["y_x"] + value["C"] / value["A"] * (row["y_p"] - before["y_p"])) / DT
        line = 1 - (1 - keep) / (20.0 * DT)
        r = keep * r + (1 - keep) * (slope + b(before)) + line * (b(row) - b(before))
        expected.append(r)
    assert np.abs(ours).max() > 0.01
    assert np.abs(ours[1:] - expected[1:]).max() < 1e-9
