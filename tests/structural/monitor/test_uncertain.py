"""Plants whose parameters and sensors are off within what the configuration says: no code, faults by name."""

from dataclasses import replace

import numpy as np
import pytest
from structural_config import named, notes

from gateway.config.load import load_config
from gateway.runtime.app import Gateway
from gateway_fdi.errors import InputErrors
from gateway_fdi.jit import COMPILED
from gateway_plants.structural.study.drives import as_bought, calibrated, configuration, frames_of, off, run, told_as
from gateway_plants.structural.study.foreign import BUCK, MOTOR, SPRING

compiled = pytest.mark.skipif(not COMPILED, reason="tens of thousands of samples")


@compiled
@pytest.mark.long
@pytest.mark.parametrize(
    ("plant", "share"),
    [
        (MOTOR, 0.05),
        (MOTOR, 0.1),
        pytest.param(BUCK, 0.05, marks=pytest.mark.full("another kernel")),
    ],
    ids=["motor", "motor far off", "buck"],
)
def test_a_plant_that_is_off_has_no_code_and_its_faults_their_names(tmp_path, plant, share):
    """Calibrated on a plant as the model says; without `uncertain` each of these drives has a code."""
    config = configuration(plant, tmp_path, plant.told)
    calibrated(config, *(frames_of(plant, run(plant, plant.seconds, seed)) for seed in (1, 2)))
    for seed in (20261125, 20261126):
        print("seed", seed)
        p = off(plant, share, seed)
        healthy = as_bought(plant, run(plant, plant.seconds, seed, p=p), seed)
        assert named(config, frames_of(plant, healthy)) == []
        for fault in plant.faults:
            rows = as_bought(plant, run(plant, plant.seconds, seed + 1, fault, 0.5 * plant.seconds, p), seed)
            assert named(config, frames_of(plant, rows))[-1:] == [told_as(load_config(config), config, fault)], fault


def read_early(plant, seconds, seed, known, parts, fault="", onset=0.0):
    """What the signals are where one of them is read so many tenths of a period before the others."""
    fine = replace(plant, period_s=plant.period_s / 10, noise=(0.0,) * len(plant.knowns))
    rows, at = run(fine, seconds, seed, fault, onset), np.arange(0, round(seconds / fine.period_s), 10)
    found, column = rows[at].copy(), plant.knowns.index(known)
    found[:, column] = rows[np.maximum(at - parts, 0), column]
    return found + np.random.default_rng(seed).normal(size=found.shape) * np.array(plant.noise)


@compiled
def test_a_sensor_that_is_late_is_followed_and_nobody_is_at_fault(tmp_path):
    """By 7 of the 10 ms that it may be."""
    seed = 45_100
    print("seed", seed)
    config = configuration(MOTOR, tmp_path, MOTOR.told.replace("bias = 0.5", 'bias = 0.5, lag = "10 ms"'))
    calibrated(config, *(frames_of(MOTOR, run(MOTOR, 60.0, k)) for k in (1, 2)))
    assert named(config, frames_of(MOTOR, read_early(MOTOR, 60.0, seed, "w", 7))) == []
    faulty = read_early(MOTOR, 60.0, seed + 1, "w", 7, "f_w", 30.0)
    gateway = Gateway(load_config(config), None, file=config)
    gateway.start(int(frames_of(MOTOR, faulty)[0]["t_ns"]))
    gateway.feed(frames_of(MOTOR, faulty))
    state = gateway.engine.state_of(gateway.engine.place_of("own"))[0]
    assert state["off_w_lag"] == pytest.approx(7.0, abs=2.5)  # the moment of inertia may be off as well
    gateway.close()
    assert named(config, frames_of(MOTOR, faulty)) == ["f_w"]


@compiled
def test_what_is_off_is_learned_and_shown(tmp_path):
    config = configuration(MOTOR, tmp_path, MOTOR.told)
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
    config = configuration(MOTOR, tmp_path, MOTOR.told.replace("20 %", "60 %") + "drift_s = 150\n")
    calibrated(config, *(frames_of(MOTOR, run(MOTOR, 60.0, seed)) for seed in (1, 2)))

    def warming(x, u, p):
        return [*MOTOR.slopes(x, u, p | {"R": p["R"] * (1 + 0.39 * x[2])}), (1.0 - x[2]) / 40.0]

    plant = replace(MOTOR, slopes=warming, begin=lambda _: (0.0, 0.0, 0.0), linear=False)
    assert named(config, frames_of(plant, run(plant, 120.0, 11))) == []
    plant = replace(MOTOR, faults={"f_R": {"R": 0.65}})
    assert named(config, frames_of(plant, run(plant, 120.0, 12, "f_R", 80.0)))[-1:] == ["f_R"]


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("uncertain = { q = 0.1 }", r"uncertain.q = 'q': the parameters are L, R, k, b, J"),
        ('uncertain = { R = "much" }', r'uncertain.R = .*write a share as "5 %"'),
        ("uncertain = { R = 2.0 }", r"uncertain.R = .*a number below 1"),
        ("sensors = { x = { gain = 0.1 } }", r"sensors.x = 'x': the known variables are u, i, w"),
        ('sensors = { i = { bias = "-1 A" } }', r"sensors.i.bias = .*write a size above 0 with its unit"),
        ('sensors = { i = { lag = "80 ms" } }', r"sensors.i.lag = .*period_ms = 10 a lag of at most 70 ms"),
        ('sensors = { i = { lag = "1 s" } }', r'sensors.i.lag = .*its unit is "ms"'),
        ("sensors = { i = { offset = 1.0 } }", r"sensors.i.offset"),
    ],
)
def test_mistakes_are_told_with_their_key(tmp_path, line, said):
    with pytest.raises(InputErrors, match=said):
        load_config(configuration(MOTOR, tmp_path, line + "\n"))


def test_check_tells_what_is_uncertain_and_which_tests_follow_it(tmp_path):
    told, _ = notes(configuration(MOTOR, tmp_path, MOTOR.told))
    lines = [line for line in told if line.startswith("uncertain")]
    assert lines[0] == "uncertain: R by up to 20 %; followed by e3 e4 e3_2"
    assert lines[5] == "uncertain: bias of i by up to 0.05; followed by e3 e3_2 e4_2"
    assert len(lines) == 8


def test_check_warns_of_an_oscillation_that_cannot_be_followed(tmp_path):
    """It is not linear, so that no residual corrects it."""
    harder = replace(SPRING, model=SPRING.model.replace("- k * x -", "- k * x * (1 + x**2) -"))
    _, told = notes(configuration(harder, tmp_path, 'uncertain = { k = "5 %" }\n'))
    assert any("oscillation runs" in line and "rad away" in line for line in told)


def test_each_mistake_is_told_at_once(tmp_path):
    lines = (
        'uncertain = { q = 0.1, R = 0.2, r = "5 %" }\nsensors = { x = { gain = 0.1 }, i = { bias = "1 V" } }\n'
        'parameters = { K = 1.0 }\nunseen = ["f_q"]\nnoise = { I = 0.1 }\nactive = "q > 1"\n'
    )
    plant = replace(MOTOR, options="start = { J = 1.0 }\n", model=MOTOR.model.replace("i = {}", 'i = { unit = "A" }'))
    with pytest.raises(InputErrors) as told:
        load_config(configuration(plant, tmp_path, lines))
    keys = [
        "active",
        "uncertain.q",
        "uncertain.r",
        "sensors.x",
        "sensors.i.bias",
        "parameters.K",
        "start.J",
        "unseen",
        "noise.I",
    ]
    assert [error.key for error in told.value.errors] == [f"monitor[0].{key}" for key in keys]
    lines = "nu = { e3 = 1.0, e77 = 1.0 }\nthresholds = { e78 = 2.0 }\n"
    with pytest.raises(InputErrors) as told:
        load_config(configuration(MOTOR, tmp_path, lines))
    assert [error.key for error in told.value.errors] == ["monitor[0].nu.e77", "monitor[0].thresholds.e78"]
    config = configuration(MOTOR, tmp_path, 'codes = { f_q = "P1234", f_r = "P1235" }\n')
    with pytest.raises(InputErrors) as told:
        Gateway(load_config(config), None, file=config)
    assert [error.key for error in told.value.errors] == ["monitor[0].codes.f_q", "monitor[0].codes.f_r"]
