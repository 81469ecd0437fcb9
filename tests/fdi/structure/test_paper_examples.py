"""Residual generators of the small examples of paper 004 against residuals derived by hand."""

from itertools import pairwise
from math import sqrt

import numpy as np
import pytest
import truck_data
from residual_runner import Runner, close

from gateway_fdi.structure.generator.loading import residual_generator
from gateway_fdi.structure.generator.realisation import realise
from gateway_fdi.structure.generator.solver import NotSolvableError
from gateway_fdi.structure.model import Equation, Model, Solvable
from gateway_fdi.structure.relation import Relation


def test_example_1(load):
    model = load("example_1")
    rng = np.random.default_rng(1)
    rows = [{"u": float(a), "y": float(b)} for a, b in rng.normal(size=(50, 2))]
    expected = np.array([z["y"] - (1 + z["u"]) ** 2 for z in rows])
    for name in ("r_1", "r_2"):
        choice = model.residuals[name]
        found = Runner(residual_generator(model, choice.equations, choice.consistency)).run(rows, 0.1)
        close(found, expected)


def test_example_4(load):
    """Integral causality: r = y(0) + int u - y. With e1 no derivative is needed: r = alpha/(p + alpha) (y' - u)."""
    model = load("example_4")
    rng = np.random.default_rng(2)
    rows = [{"u": float(a), "y": float(b)} for a, b in rng.normal(size=(80, 2))]
    u, y = (np.array([z[k] for z in rows]) for k in "uy")
    held = np.concatenate([[0.0], np.cumsum(u[:-1]) * 0.1])
    choice = model.residuals["integral"]
    found = Runner(residual_generator(model, choice.equations, choice.consistency)).run(rows, 0.1)
    close(found, y[0] + held - y)
    choice = model.residuals["derivative"]
    found = Runner(residual_generator(model, choice.equations, choice.consistency), filter_bandwidth=2.0).run(rows, 0.1)
    left = np.diff(y, prepend=y[0]) / 0.1 - np.concatenate([[0.0], u[:-1]])
    close(found, truck_data.low_pass(left, 2.0, 0.1))


def machine_rows(series, count=400):
    """Data of (14) or (18): the current is chosen, and everything follows; dt 0.05 s."""
    rows, omega = [], 80.0
    for k in range(count):
        t = 0.05 * k
        current = 40 + 30 * np.sin(0.7 * t) if series else 60 * np.sin(0.7 * t) + 5
        k_i = 0.01 if series else 1.0
        voltage = current * (0.05 + omega * k_i) if series else current * 0.05 + omega * k_i
        power, u_oc = current * voltage, 250.0
        i_b = (u_oc - sqrt(u_oc**2 - 4 * 0.023 * power)) / (2 * 0.023)
        torque = k_i * 0.95 ** np.sign(current) * (current**2 if series else current)
        engine, losses = 20 * np.sin(0.2 * t), 30 + 0.1 * omega
        rows.append(
            {"T_e": engine, "T_l": losses, "U_oc": u_oc, "y_1": u_oc - 0.023 * i_b, "y_2": omega}
            | {"current": current, "voltage": voltage}
        )
        omega += 0.05 * (engine + torque - 0.02 * omega - losses) / 60.0
    return rows


def derivative(y, bandwidth, dt):
    """Of a signal behind a first-order low-pass: from its convolution with the filter's pulse response."""
    return truck_data.low_pass(np.diff(y, prepend=y[0]) / dt, bandwidth, dt)


def test_machine_without_loop(load):
    """(17): e2 is checked, the current comes from the torques."""
    model, rows = load("machine"), machine_rows(series=False)
    choice = model.residuals["unique"]
    with pytest.raises(NotSolvableError, match=r"differentiates omega.*\(20\)"):
        realise(model, choice.equations, choice.consistency)
    loaded = residual_generator(model, choice.equations, choice.consistency, differentiate=True)
    found = Runner(loaded, derivative_bandwidth=8.0).run(rows, 0.05)
    omega, y_1 = (np.array([z[k] for z in rows]) for k in ("y_2", "y_1"))
    torque = 60 * derivative(omega, 8.0, 0.05) + 0.02 * omega
    torque += np.array([z["T_l"] - z["T_e"] for z in rows])
    torque[0] = 0.02 * omega[0] + rows[0]["T_l"] - rows[0]["T_e"]
    current = np.where(torque > 0, torque / 0.95, torque * 0.95)
    voltage = (250.0 - y_1) / 0.023 * y_1 / current
    expected = (voltage - omega) / 0.05 - current
    good = np.abs(current) > 5  # e3 divides by the current
    assert good.sum() > 200
    assert (np.abs(found - expected)[good] / np.maximum(np.abs(expected[good]), 1)).max() < 1e-9


def test_machine_with_loop(load):
    """(15) and (16): two solutions of e2, e3; the residual is the one nearest to zero, Remark 1."""
    model, rows = load("machine"), machine_rows(series=False)
    choice = model.residuals["loop"]
    loaded = residual_generator(model, choice.equations, choice.consistency)
    assert loaded.generated.realisation.branches == 2
    runner = Runner(loaded, filter_bandwidth=2.0)
    found = runner.run(rows, 0.05)
    branches = []

    def felt(z, sign):
        power = (z["U_oc"] - z["y_1"]) / 0.023 * z["y_1"]
        half = z["y_2"] * 1.0 / (2 * 0.05)
        current = -half + sign * sqrt(half**2 + power / 0.05)  # (16)
        torque = 0.95 ** np.sign(current) * current
        return (z["T_e"] + torque - 0.02 * z["y_2"] - z["T_l"]) / 60.0

    decay = np.exp(-2.0 * 0.05)
    for sign in (-1, 1):
        left = [0.0]
        for z, after in pairwise(rows):  # on a line up to the next speed; all else is held
            b, end = felt(z, sign), felt(after | {name: z[name] for name in ("T_e", "T_l", "U_oc", "y_1")}, sign)
            new = (1 - decay) * ((after["y_2"] - z["y_2"]) / 0.05 - b)
            left.append(decay * left[-1] + new - (1 - (1 - decay) / (2.0 * 0.05)) * (end - b))
        branches.append(left)
    both = np.array(branches)
    expected = both[np.abs(both).argmin(0), np.arange(len(rows))]
    # The wrong root (-1600 A and more) makes terms of 30 rad/s2 that cancel: a billionth of them is the bound.
    assert np.abs(found - expected).max() < 1e-9
    assert np.abs(found).max() < 0.02  # the right root fits the data, in which torques were held
    fit = np.abs(both).max(1)
    assert fit.min() < 0.02
    assert fit.max() > 1.0


def test_series_wound_machine_has_no_unique_generator(load):
    """(18): the roots of e1 for the current; the nearest to zero fits the data, by a filter of the derivative."""
    model, rows = load("series_machine"), machine_rows(series=True)
    choice = model.residuals["roots"]
    loaded = residual_generator(model, choice.equations, choice.consistency, differentiate=True)
    assert loaded.generated.realisation.branches == 2
    found = Runner(loaded, derivative_bandwidth=8.0).run(rows, 0.05)
    omega = np.array([z["y_2"] for z in rows])
    torque = 60 * derivative(omega, 8.0, 0.05) + 0.02 * omega
    torque += np.array([z["T_l"] - z["T_e"] for z in rows])
    power = np.array([(250.0 - z["y_1"]) / 0.023 * z["y_1"] for z in rows])
    with np.errstate(invalid="ignore"):
        plus, minus = np.sqrt(torque / 0.0095), -np.sqrt(torque * 0.95 / 0.01)
    both = np.array([power / i / (0.05 + 0.01 * omega) - i for i in (plus, minus)])
    real = np.isfinite(both).any(0)
    assert (np.isnan(found) == ~real).all()
    expected = both[np.nanargmin(np.abs(both[:, real]), axis=0), real]
    assert real.sum() > 300
    assert (np.abs(found[real] - expected) / np.maximum(np.abs(expected), 1)).max() < 1e-9


def test_22_needs_a_derivative_within(load):
    """(22): e3 is checked, x_1 is the derivative of x_2; integral causality is impossible."""
    model = Model(
        "(22)",
        (
            Equation("e1", ("x_2",), ("u_1",), solvable={"x_2": Solvable.UNIQUE},
                relation=Relation.parse("x_2 - u_1 = 0")),
            Equation("e2", ("der(x_2)", "x_1"), solvable={"x_1": Solvable.UNIQUE, "der(x_2)": Solvable.UNIQUE},
                     relation=Relation.parse("der(x_2) - x_1 = 0")),
            Equation("e3", ("x_1",), ("y_1",), relation=Relation.parse("sin(x_1) - y_1 = 0")),
        ),
        ("x_1", "x_2"),
        ("u_1", "y_1"),
    )  # fmt: skip
    everything = frozenset(["e1", "e2", "e3"])
    with pytest.raises(NotSolvableError, match="differentiates x_2"):
        realise(model, everything, "e3")
    loaded = residual_generator(model, everything, "e3", differentiate=True)
    rng = np.random.default_rng(4)
    rows = [{"u_1": float(a), "y_1": float(b)} for a, b in np.cumsum(rng.normal(size=(60, 2)), 0) * 0.02]
    found = Runner(loaded, derivative_bandwidth=5.0).run(rows, 0.1)
    slope = derivative(np.array([z["u_1"] for z in rows]), 5.0, 0.1)
    close(found, np.sin(slope) - np.array([z["y_1"] for z in rows]))
