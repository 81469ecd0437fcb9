"""Plants that are hard on a step, from equations and healthy logs alone: modes are told, faults have their names."""

import math
from dataclasses import replace

import numpy as np
import pytest
from amount import FULL
from scipy.linalg import expm
from structural_config import named, notes

from gateway.config.load import load_config
from gateway_fdi.errors import InputErrors
from gateway_fdi.jit import COMPILED
from gateway_plants.structural.monitor.observer import gain_of
from gateway_plants.structural.study.drives import calibrated, configuration, frames_of, run, told_as
from gateway_plants.structural.study.foreign import BUCK, MOTOR, PLANTS, SPRING

#: In CI the first: each has a kernel of its own, which takes 4 to 8 s to compile.
NAMES = ("spring", "stiff_motor", "buck", "wind")

compiled = pytest.mark.skipif(not COMPILED, reason="tens of thousands of samples")


def test_modes_are_told_against_the_period(tmp_path):
    told, _ = notes(configuration(SPRING, tmp_path))
    assert sum("mode 10 rad/s, damping 0.001 (0.9999 left a sample)" in line for line in told) == 2
    told, _ = notes(configuration(MOTOR, tmp_path))
    h, (slow, fast) = 0.01, sorted(abs(np.linalg.eigvals([[-2500, -250], [25, -0.5]])))
    wanted = f"fastest mode {fast:.3g} rad/s ({math.exp(-h * fast):.4g} left a sample), slowest {slow:.3g} rad/s"
    assert any(wanted in line for line in told)


def test_a_residual_that_diverges_is_refused(tmp_path):
    """Negative damping of what was well damped in the model: no period helps, and none is promised."""
    damped = replace(SPRING, model=SPRING.model.replace("d = { value = 0.02 }", "d = { value = 10.0 }"))
    config = configuration(damped, tmp_path, "parameters = { d = -0.5 }\n")
    with pytest.raises(
        InputErrors, match=r"monitor\[0\].tests = 'e4': residual e4 .*mode of \+0.25 1/s.*period_ms = 10"
    ):
        load_config(config)


def test_what_hardly_is_damped_is_corrected_by_its_residual(tmp_path):
    """It forgets within settle_s, 1 s, as the check tells; a mode that grows is caught as well."""
    for line in ("", "parameters = { d = -0.5 }\n"):
        told, _ = notes(configuration(SPRING, tmp_path, line))
        left = [float(one.partition("so that ")[2].split()[0]) for one in told if "corrected by its residual" in one]
        assert left == pytest.approx([math.exp(-0.06)] * 2, abs=6e-3)


def test_the_gain_mirrors_what_was_too_slow_and_takes_nothing_else():
    """A spring, and a mode of 50 rad/s that forgets by itself; seen by the position alone."""
    jacobian, shows = np.array([[0.0, 1.0, 0.0], [-100.0, -0.02, 1.0], [0.0, 0.0, -50.0]]), np.array([1.0, 0.0, 0.0])
    h, alpha = 0.01, 3.0
    gain = gain_of(jacobian, shows, h, alpha)
    closed = np.abs(np.linalg.eigvals(expm(jacobian * h) @ (np.eye(3) - np.outer(gain, shows))))
    wanted = sorted([math.exp(-0.5), *[math.exp(-2 * alpha * h + 0.01 * h)] * 2])
    np.testing.assert_allclose(sorted(closed), wanted, rtol=1e-5)


def test_no_gain_corrects_what_the_residual_does_not_show():
    assert gain_of(np.array([[0.5, 0.0], [0.0, -1.0]]), np.array([0.0, 1.0]), 0.01, 1.0) is None


def test_a_mode_beyond_half_a_turn_a_sample_is_told(tmp_path):
    config = configuration(SPRING, tmp_path, "parameters = { k = 1e6 }\n")
    _, told = notes(config)
    assert any("turns with 1e+03 rad/s" in line and "period_ms = 1.6 would follow it" in line for line in told)


def test_what_is_seen_only_while_it_changes(tmp_path):
    """A constant offset of the position has no slope, a constant force no speed."""
    told, _ = notes(configuration(SPRING, tmp_path))
    faults = [line for line in told if line.startswith("fault")]
    assert [line.partition("fires ")[2].partition(";")[0] for line in faults] == [
        "e4 e5 (only while it changes: e5)", "e3 e4 (only while it changes: e3)", "e3 e5",
    ]  # fmt: skip


@compiled
@pytest.mark.long
@pytest.mark.parametrize("name", sorted(NAMES if FULL else ["spring"]))
def test_faults_have_their_names(tmp_path, name):
    plant = PLANTS[name]
    config = configuration(plant, tmp_path)
    calibrated(config, *(frames_of(plant, run(plant, plant.seconds, seed)) for seed in (1, 2)))
    assert named(config, frames_of(plant, run(plant, plant.seconds, 3))) == []
    for fault in plant.faults:
        rows = run(plant, plant.seconds, 10, fault, 0.4 * plant.seconds)
        assert named(config, frames_of(plant, rows))[:1] == [told_as(load_config(config), config, fault)], fault


def test_the_converter_groups_what_stands_together(tmp_path):
    told, _ = notes(configuration(BUCK, tmp_path))
    assert any(line.startswith("fault f_sw ") and "cannot be told from f_RL, f_vin" in line for line in told)
