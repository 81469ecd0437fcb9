"""Models simulated from their equations, against solutions by hand."""

import numpy as np
import pytest

from gateway_fdi.structure.file import load_model
from gateway_fdi.structure.simulation.plant import Course, Plant, constant
from gateway_fdi.structure.simulation.reduction import NotSimulatedError

TIMES = np.linspace(0.0, 4.0, 401)


def model(tmp_path, equations, unknown, known="", fault="", parameter="", more=""):
    """A model from lines."""
    tables = [f"[{kind}]\n" + "\n".join(f"{n} = {{}}" for n in names.split()) for kind, names in
              (("unknown", unknown), ("known", known), ("fault", fault))]  # fmt: skip
    tables.append(
        "[parameter]\n" + "\n".join(f"{p.split('=')[0]} = {{ value = {p.split('=')[1]} }}" for p in parameter.split())
    )
    rows = "\n".join(f'[equation.e{k + 1}]\nrelation = "{e}"' for k, e in enumerate(equations))
    path = tmp_path / "plant.toml"
    path.write_text("\n".join([*tables, rows, more]), encoding="utf-8")
    return load_model(path)


def test_the_motor(load):
    """A resistance that grows: the speed goes from one steady state to the other as an exponential."""
    plant = Plant(load("motor"), {"u": constant(9.0)}, rest=True)
    found = plant.run(TIMES, {"f_R": Course((0.0, 1.0, 1.0), (0.0, 0.0, 0.5))})
    assert found["w"][:100] == pytest.approx(150.0, rel=1e-6)
    r, k, b, j = 0.75, 0.05, 1e-3, 2e-3
    speed = k * 9.0 / (r * b + k * k)
    expected = speed + (150.0 - speed) * np.exp(-(b + k * k / r) / j * (TIMES[100:] - 1.0))
    assert np.abs(found["w"][100:] - expected).max() < 1e-4
    assert np.abs(found["i"][100:] - (9.0 - k * expected) / r).max() < 1e-5


def test_two_inertias_on_one_shaft(tmp_path):
    """A gear makes of two states one: index 2. M = (J1 + J2 / n^2) der(w1) with w2 = w1 / n."""
    plant = Plant(
        model(
            tmp_path,
            ["J1 * der(w1) = M - F", "J2 * der(w2) = n * F", "w1 = n * w2", "y = w2"],
            "w1 w2 F", "M y", "", "J1=0.5 J2=3.0 n=4.0",
        ),
        {"M": Course((0.0, 2.0, 2.0), (1.0, 1.0, -1.0))},
        start={"w2": 0.25},
    )  # fmt: skip
    found = plant.run(TIMES)
    slope = 1.0 / (0.5 + 3.0 / 16.0)
    w1 = 1.0 + slope * (2.0 - np.abs(TIMES - 2.0))
    assert np.abs(found["w1"] - w1).max() < 1e-5
    assert np.abs(found["y"] - w1 / 4.0).max() < 1e-5
    assert np.abs(found["F"][10] - 3.0 / 16.0 * slope) < 1e-9


def test_a_pendulum_by_its_rod(tmp_path):
    """Index 3: x^2 + y^2 = L^2 is differentiated twice, and the energy stays what it is."""
    plant = Plant(
        model(
            tmp_path,
            ["der(x) = u", "der(y) = v", "der(u) = -T * x", "der(v) = -T * y - g", "x * x + y * y = L * L"],
            "x y u v T", "", "", "g=9.81 L=1.0",
        ),
        {},
        start={"x": 0.3, "u": 0.0},
    )  # fmt: skip
    plant.system.guesses[:] = [np.full(len(g), -1.0) if len(g) == 1 else g for g in plant.system.guesses]
    found = plant.run(TIMES)
    assert np.abs(found["x"] ** 2 + found["y"] ** 2 - 1.0).max() < 1e-8
    energy = 0.5 * (found["u"] ** 2 + found["v"] ** 2) + 9.81 * found["y"]
    assert np.abs(energy - energy[0]).max() < 1e-4
    assert found["x"].min() == pytest.approx(-0.3, abs=1e-3)


def test_a_loop_without_a_formula(tmp_path):
    """A diode behind a resistor charges a capacitor: solved by Newton's method at each time."""
    plant = Plant(
        model(
            tmp_path,
            ["i = Is * (exp(ud / Ut) - 1)", "U = R * i + ud + uc", "C * der(uc) = i", "y = uc"],
            "i ud uc", "U y", "", "Is=1e-9 Ut=0.05 R=10.0 C=0.02",
        ),
        {"U": constant(5.0)},
    )  # fmt: skip
    found = plant.run(TIMES)
    left = found["U"] - 10.0 * found["i"] - found["ud"] - found["uc"]
    assert np.abs(left).max() < 1e-9
    assert np.abs(found["i"] - 1e-9 * (np.exp(found["ud"] / 0.05) - 1.0)).max() < 1e-9
    charge = np.concatenate([[0.0], np.cumsum(0.5 * np.diff(TIMES) * (found["i"][1:] + found["i"][:-1]))])
    assert np.abs(found["y"] - charge / 0.02).max() < 1e-3
    assert 3.9 < found["y"][-1] < 5.0


def test_tables_cases_and_repeated_inputs(tmp_path):
    plant = Plant(
        model(
            tmp_path, ["der(x) = f(u) if u > 0 else -1", "y = max(x, 0.5) + sign(u)"], "x", "u y",
            more="[table.f]\nx = [0, 2]\ny = [0.0, 4.0]",
        ),
        {"u": Course((0.0, 1.0, 1.0, 2.0), (1.0, 1.0, -3.0, -3.0), repeat_s=2.0)},
    )  # fmt: skip
    found = plant.run(TIMES)
    inside = TIMES % 2.0
    x = np.where(inside < 1.0, 2.0 * inside, 3.0 - inside) + np.floor(TIMES / 2.0)
    assert np.abs(found["x"] - x).max() < 1e-5
    edge = np.isclose(inside % 1.0, 0.0) | np.isclose(inside % 1.0, 1.0)
    assert np.abs(found["y"] - np.maximum(x, 0.5) - np.where(inside < 1.0, 1.0, -1.0))[~edge].max() < 1e-5


@pytest.mark.parametrize(
    ("equations", "unknown", "known", "inputs", "said"),
    [
        (
            ["der(x) = u", "y = x"],
            "x",
            "u y",
            {},
            "1 equations too few .*; of u, y those that the plant is given are inputs",
        ),
        (["der(x) = u", "y = x"], "x", "u y", {"u": 1.0, "y": 2.0}, "e2: more equations than variables"),
        (["der(x) = 1 / x"], "x", "", {}, r"no number at t = 0 s \(a division by zero, or a root\)"),
        (["der(x) = x * x"], "x", "", {}, "no further than t = 0.99|no number at t"),
        (["a + b = 1", "2 * a + 2 * b = 3", "der(x) = a"], "a b x", "", {}, "no number at t = 0 s"),
        (["der(x) = z", "der(y) = z", "x = 2 * y"], "x y z", "", {}, None),
    ],
)
def test_what_cannot_be_simulated(tmp_path, equations, unknown, known, inputs, said):
    made = model(tmp_path, equations, unknown, known)
    courses = {z: constant(v) for z, v in inputs.items()}

    def run():
        return Plant(made, courses, start={"x": 1.0} if said and "0.99" in said else {}).run(TIMES)

    if said is None:
        assert np.abs(run()["z"]).max() == 0.0
        return
    with pytest.raises(NotSimulatedError, match=said):
        run()


def test_a_load_is_told(load):
    """The induction motor of the toolbox has a load torque that no equation determines."""
    motor = load("induction_motor")
    voltages = {u: constant(1.0) for u in motor.knowns if u.startswith("u")}
    with pytest.raises(NotSimulatedError, match="1 equations too few"):
        Plant(motor, voltages)
    found = Plant(motor, voltages | {"Tl": Course((0.0, 4.0), (0.0, 0.1))}).run(TIMES)
    assert np.abs(found["Tl"] - 0.025 * TIMES).max() < 1e-9
    assert np.abs(found["y3"] - found["w"]).max() == 0.0


def test_rest_and_starts(load, tmp_path):
    tanks = Plant(load("three_tanks"), {"y3": constant(0.5)}, rest=True)
    found = tanks.run(TIMES)
    assert found["p1"] == pytest.approx(1.5, rel=1e-6)
    with pytest.raises(NotSimulatedError, match="no state of rest of x is found"):
        Plant(model(tmp_path, ["der(x) = 1 + x * x"], "x"), {}, rest=True)
    bound = model(tmp_path, ["der(x) = z", "der(y) = z + 1 - w", "x = y", "w = x"], "x y z w")
    with pytest.raises(NotSimulatedError, match="follows from other states"):
        Plant(bound, {}, start={"x": 1.0, "y": 1.0})
