"""The step of a generator's states against SciPy: exact where it is linear, stable wherever the plant is."""

import numpy as np
import pytest
import sympy
from residual_runner import Runner
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from gateway_fdi.structure.file import load_model
from gateway_fdi.structure.generator.loading import residual_generator
from gateway_fdi.structure.generator.propagation import components, sensors, slope
from gateway_fdi.structure.generator.realisation import realise
from gateway_fdi.structure.generator.runtime import advance, incline
from gateway_plants.structural.study.drives import run
from gateway_plants.structural.study.foreign import MOTOR, SPRING, TANKS


def model_of(plant, folder):
    (folder / f"{plant.name}.toml").write_text(plant.model)
    return load_model(folder / f"{plant.name}.toml")


def quiet(plant, seconds, seed):
    """Samples without noise."""
    rows = run(plant, seconds, seed)
    noise = np.random.default_rng(seed)
    plant.commands(noise, seconds)
    return rows - noise.normal(size=rows.shape) * np.array(plant.noise)


@pytest.mark.parametrize("seed", range(6))
def test_functions_of_a_matrix(seed):
    """phi1 and phi2 are blocks of the exponential of a larger matrix, which SciPy has."""
    rng = np.random.default_rng(seed)
    n = 1 + seed % 3
    a, dt = rng.normal(size=(n, n)) * 10.0 ** (seed - 2), 0.1
    a -= 10.0 ** (seed - 2) * 3.0 * np.eye(n)
    f, change = rng.normal(size=(2, n))
    big = np.zeros((n + 2, n + 2))
    big[:n, :n], big[:n, n], big[n, n + 1], big[:n, n + 1] = a, change / dt, 1.0, f
    slopes, hold = np.concatenate([f, change, np.zeros(n)]), np.zeros(6 * n * n)
    for _ in range(2):  # computed, and kept
        advance(a.ravel().copy(), slopes, hold, dt)
        assert slopes[2 * n :] == pytest.approx(expm(dt * big)[:n, n + 1], rel=1e-9, abs=1e-14)


def test_a_lightly_damped_plant_is_followed_exactly(tmp_path):
    """0.1 % damping at 10 ms, the command held: nothing but the solver's error is left behind 200 s."""
    everything = frozenset({"e1", "e2", "e3", "e4"})
    loaded = residual_generator(model_of(SPRING, tmp_path), everything, "e4", start={"x": 0.0, "v": 0.0})
    rows = [{"u": u, "y": y} for u, y, _ in quiet(SPRING, 200.0, 1)]
    found = Runner(loaded).run(rows, SPRING.period_s)
    assert np.abs(found).max() < 1e-4
    assert max(abs(row["y"]) for row in rows) > 0.2


def test_a_stiff_winding_settles(tmp_path):
    """L / R = 0.4 ms at 10 ms: Euler's 1 + h lambda is -24."""
    everything = frozenset({"e1", "e2", "e4"})
    loaded = residual_generator(model_of(MOTOR, tmp_path), everything, "e4", start={"I": 0.0, "omega": 0.0})
    found = Runner(loaded).run([{"u": u, "w": w} for u, _, w in quiet(MOTOR, 20.0, 1)], MOTOR.period_s)
    assert np.abs(found).max() < 1e-4


def test_a_nonlinear_plant_at_second_order(tmp_path):
    """Torricelli: a quarter of the error in half the step, and little of it."""
    model = model_of(TANKS, tmp_path)
    everything = frozenset({"b3", "o3", "p2", "s3"})
    worst = []
    for dt in (8.0, 4.0, 2.0):
        loaded = residual_generator(model, everything, "s3", start={"h3": 1.6})
        count = round(200 / dt)
        t = np.arange(count) * dt
        solved = solve_ivp(
            lambda _, h: [(0.4 * 3.35 * 3.3 - 0.071 * np.sqrt(1962 * h[0])) / 28.0], (0, 200), [1.6],
            t_eval=t, rtol=1e-10, atol=1e-12,
        )  # fmt: skip
        worst.append(np.abs(Runner(loaded).run([{"u2": 3.3, "y3": y} for y in solved.y[0]], dt)).max())
    assert worst[0] < 0.05
    assert worst[0] / worst[1] > 3.3
    assert worst[1] / worst[2] > 3.3


def test_sensors_lie_on_a_line_and_commands_are_held(tmp_path):
    model = model_of(SPRING, tmp_path)
    assert sensors(model) == {"y", "w"}
    loaded = residual_generator(model, frozenset({"e3", "e4", "e5"}), "e4", start={"x": 0.0})
    runner = Runner(loaded)
    found = runner.run([{"w": 0.3 * k, "y": 0.5 * 0.3 * 0.1 * k**2} for k in range(50)], 0.1)
    assert np.abs(found).max() < 1e-12


def test_states_apart_are_propagated_apart(tmp_path):
    model = model_of(TANKS, tmp_path)
    everything = frozenset({"b1", "o1", "b3", "o3", "p1", "p2", "s1"})
    assert len(components(realise(model, everything, "s1", start=dict.fromkeys(model.states, 1.0)))) == 1
    alone = residual_generator(model, frozenset({"b3", "o3", "p2", "s3"}), "s3", start={"h3": 1.0})
    assert [one.coupled for one in components(alone.generated.realisation)] == [True]


def test_slopes_as_code_can_compute_them():
    x, y = sympy.symbols("x y", real=True)
    table = sympy.Function("f")
    numbers = {x: 0.7, y: 1.3}
    for e in (
        sympy.sign(x - y) * sympy.sqrt(sympy.Abs(x - y)), sympy.Min(x * y, 2 * x), sympy.Max(x, y) * x,
        sympy.Piecewise((x**2, x < y), (x, True)), sympy.exp(-x) / y, sympy.Abs(sympy.sqrt(y - x)),
    ):  # fmt: skip
        up, down = (float(e.subs({**numbers, x: 0.7 + d})) for d in (1e-6, -1e-6))
        assert float(slope(e, x).subs(numbers)) == pytest.approx((up - down) / 2e-6, rel=1e-5), e
        assert slope(e, sympy.Symbol("z")) == 0
    assert str(slope(table(2 * x), x)) == "2*slope_of_f(2*x)"
    points = np.array([0.0, 1.0, 3.0]), np.array([1.0, 2.0, 0.0])
    assert [incline(*points, at) for at in (-1.0, 0.0, 0.5, 1.0, 2.9, 3.0, 9.0)] == [0, 1, 1, -1, -1, 0, 0]
