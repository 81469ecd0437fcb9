"""Plants whose parameters and sensors are off within what the configuration says: no code, faults by name."""

from dataclasses import replace

import numpy as np
import pytest
from amount import FULL
from foreign_plants import BUCK, MOTOR, SPRING, calibrated, configuration, frames_of, notes, run
from structural_config import named

from gateway.config.load import load_config
from gateway.errors import InputErrors
from gateway.fdi.slow import shares as slow
from gateway.jit import COMPILED, zeros
from gateway.runtime.app import Gateway

compiled = pytest.mark.skipif(not COMPILED, reason="tens of thousands of samples")

TOLD = {
    "stiff_motor": """\
uncertain = { R = "20 %", k = "15 %", b = "30 %", J = "15 %" }
sensors = { i = { gain = "1 %", bias = 0.05 }, w = { gain = "1 %", bias = 0.5 } }
""",
    "buck": """\
uncertain = { L = "20 %", C = "20 %", R_L = "40 %", R = "15 %" }
sensors = { i = { gain = "1 %", bias = 0.05 }, v = { gain = "1 %", bias = 0.1 }, vin = { gain = "1 %", bias = 0.1 } }
""",
}
BIAS = {"stiff_motor": (0.0, 0.025, 0.25), "buck": (0.0, 0.025, 0.05, 0.05)}


def off(plant, share, seed):
    """The plant with each parameter ``share`` more or less than the model says, and its faults from there on."""
    rng = np.random.default_rng(seed)
    values = load_names(plant)
    p = plant.p | {name: plant.p[name] * (1 + share * rng.choice([-1, 1])) for name in values}
    faults = {
        fault: {key: value / plant.p[key] * p[key] if plant.p[key] else value for key, value in change.items()}
        for fault, change in plant.faults.items()
    }
    return replace(plant, p=p, faults=faults)


def load_names(plant):
    return {"stiff_motor": ("R", "k", "b", "J"), "buck": ("L", "C", "R_L", "R")}[plant.name]


def as_bought(plant, rows, seed):
    """Readings of sensors with gains off by 0.5 %, and half the bias that their data sheet allows."""
    rng = np.random.default_rng(seed)
    sign = rng.choice([-1, 1], (2, len(plant.knowns)))
    sign[0, 0] = 0  # the command is as it is sent
    return rows * (1 + 0.005 * sign[0]) + np.array(BIAS[plant.name]) * sign[1]


@compiled
@pytest.mark.long
@pytest.mark.parametrize(
    ("plant", "share"),
    [
        (MOTOR, 0.05),
        (MOTOR, 0.1),
        pytest.param(BUCK, 0.05, marks=pytest.mark.skipif(not FULL, reason="another kernel")),
    ],
    ids=["motor", "motor far off", "buck"],
)
def test_a_plant_that_is_off_has_no_code_and_its_faults_their_names(tmp_path, plant, share):
    """Calibrated on a plant as the model says; without `uncertain` each of these drives has a code."""
    config = configuration(plant, tmp_path, TOLD[plant.name])
    calibrated(config, *(frames_of(plant, run(plant, plant.seconds, seed)) for seed in (1, 2)))
    for seed in (20261125, 20261126):
        print("seed", seed)
        mine = off(plant, share, seed)
        healthy = as_bought(plant, run(mine, plant.seconds, seed), seed)
        assert named(config, frames_of(plant, healthy)) == []
        for fault in plant.faults:
            rows = as_bought(plant, run(mine, plant.seconds, seed + 1, fault, 0.5 * plant.seconds), seed)
            assert named(config, frames_of(plant, rows))[-1:] == [plant.groups.get(fault, fault)], fault


@compiled
def test_what_is_off_is_learned_and_shown(tmp_path):
    config = configuration(MOTOR, tmp_path, TOLD["stiff_motor"])
    calibrated(config, *(frames_of(MOTOR, run(MOTOR, 60.0, seed)) for seed in (1, 2)))
    plant = replace(MOTOR, p=MOTOR.p | {"R": 0.55, "k": 0.046, "J": 2.2e-3})
    drive = frames_of(plant, run(plant, 120.0, 7))
    gateway = Gateway(load_config(config), None, file=config)
    gateway.start(int(drive[0]["t_ns"]))
    gateway.feed(drive)
    state = gateway.engine.state_of(gateway.engine.place_of("own"))[0]
    for name, share in (("R", 0.1), ("k", -0.08), ("J", 0.1)):
        assert state[f"off_{name}"] == pytest.approx(share, abs=0.02), name
    gateway.close()


@compiled
def test_what_ages_within_its_bound_has_no_code_and_a_jump_has(tmp_path):
    """A winding warms by 39 % of its resistance in two minutes; one that jumps by 30 % is a fault."""
    config = configuration(MOTOR, tmp_path, TOLD["stiff_motor"].replace("20 %", "60 %") + "drift_s = 150\n")
    calibrated(config, *(frames_of(MOTOR, run(MOTOR, 60.0, seed)) for seed in (1, 2)))

    def warming(t, x, u, p):
        return MOTOR.slopes(t, x, u, p | {"R": p["R"] * (1 + 0.39 * (1 - np.exp(-t / 40.0)))})

    plant = replace(MOTOR, slopes=warming)
    assert named(config, frames_of(plant, run(plant, 120.0, 11))) == []
    plant = replace(MOTOR, faults={"f_R": {"R": 0.65}})
    assert named(config, frames_of(plant, run(plant, 120.0, 12, "f_R", 80.0)))[-1:] == ["f_R"]


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("uncertain = { q = 0.1 }", r"uncertain.q = 'q': the parameters are L, R, k, b, J"),
        ('uncertain = { R = "much" }', r'uncertain.R = .*write a share as "5 %"'),
        ("uncertain = { R = 2.0 }", r"uncertain.R = .*less than 1"),
        ("sensors = { x = { gain = 0.1 } }", r"sensors.x = 'x': the known variables are u, i, w"),
        ('sensors = { i = { bias = "-1 A" } }', r"sensors.i.bias = .*write a size above 0 with its unit"),
        ("sensors = { i = { offset = 1.0 } }", r"sensors.i.offset"),
    ],
)
def test_mistakes_are_told_with_their_key(tmp_path, line, said):
    with pytest.raises(InputErrors, match=said):
        load_config(configuration(MOTOR, tmp_path, line + "\n"))


def test_check_tells_what_is_uncertain_and_which_tests_follow_it(tmp_path):
    told, _ = notes(configuration(MOTOR, tmp_path, TOLD["stiff_motor"]))
    lines = [line for line in told if line.startswith("uncertain")]
    assert lines[0] == "uncertain: R by up to 20 %; followed by e3 e4 e3_2"
    assert lines[5] == "uncertain: bias of i by up to 0.05; followed by e3 e3_2 e4_2"
    assert len(lines) == 8


def test_check_warns_of_an_oscillation_that_cannot_be_followed(tmp_path):
    """It is not linear, so that no residual corrects it."""
    harder = replace(SPRING, model=SPRING.model.replace("- k * x -", "- k * x * (1 + x**2) -"))
    _, told = notes(configuration(harder, tmp_path, 'uncertain = { k = "5 %" }\n'))
    assert any("oscillation runs" in line and "rad away" in line for line in told)


def test_the_filter_is_the_kalman_filter_of_its_equations():
    """Against the textbook's form with matrices, on random measurements; seed printed."""
    seed = 31
    print("seed", seed)
    rng = np.random.default_rng(seed)
    s, c = zeros(1, slow.State)[0], zeros(1, slow.Const)[0]
    slow.prepare(c, 3, 100.0)
    slow.begin(s, c)
    x, p = np.zeros(3), np.eye(3) / 3
    for _ in range(50):
        slow.grow(s, c, 0.1)
        p += np.diag(np.where(np.diag(p) < 1 / 3, np.minimum(0.1 / 300, 1 / 3 - np.diag(p)), 0))
        g, residual = rng.normal(size=3), rng.normal() * 0.1
        s["gain"][:3] = g
        corrected = slow.correct(s, c, residual)
        assert corrected == pytest.approx(residual + g @ x)
        assert s["fitted"] == pytest.approx(g @ p @ g)
        slow.take(s, c, corrected, 0.5, -1.0)
        gain = p @ g / (g @ p @ g + 0.5)
        x = np.clip(x - gain * (residual + g @ x), -1, 1)
        p = p - np.outer(gain, g @ p)
        np.testing.assert_allclose(s["share"][:3], x, atol=1e-12)
        np.testing.assert_allclose(s["covariance"][:3, :3], p, atol=1e-12)


def test_a_share_that_is_held_back_moves_no_faster_and_nothing_becomes_surer():
    s, c = zeros(1, slow.State)[0], zeros(1, slow.Const)[0]
    slow.prepare(c, 2, 100.0)
    slow.begin(s, c)
    s["gain"][:2] = (1.0, -2.0)
    slow.take(s, c, slow.correct(s, c, 5.0), 0.01, 1e-3)
    np.testing.assert_allclose(s["share"][:2], (-1e-3, 1e-3))
    np.testing.assert_allclose(np.diag(s["covariance"][:2, :2]), 1 / 3)
    for _ in range(1000):
        slow.take(s, c, slow.correct(s, c, 5.0), 0.01, -1.0)
    assert np.abs(s["share"][:2]).max() <= 1.0
