"""Windows of samples: which parts, one or two, explain what came; against a plant that is stepped here."""

import tomllib

import numpy as np
import pytest

from gateway_fdi.common.resources import shipped
from gateway_fdi.jit import zeros
from gateway_plants.linear.monitor.pi_bank.monitor import _behind
from gateway_plants.linear.monitor.pi_bank.params import Params
from gateway_plants.linear.monitor.pi_bank.window import LENGTH, State, keep

SEED = 47


@pytest.fixture(scope="module", params=["aircraft", "belt"])
def params(request):
    document = tomllib.loads(shipped(f"configs/linear_{request.param}.toml").read_text())
    found = next(m for m in document["monitor"] if m["type"] == "pi_bank")
    return Params(**{k: v for k, v in found.items() if k not in ("name", "type")})


def drive(p, rng, parts=(), lost=-1):
    """Return the state behind a window, with parts that are off; actuators come first."""
    plant, state = p.plant, zeros(1, State)[0]
    noise = np.array([one.noise for one in p.output])
    disturbed = np.array(p.disturbance) * np.sqrt(plant.period)
    x = rng.normal(size=plant.states)
    for k in range(LENGTH + 7):
        u, wrong = np.zeros(4), np.zeros(4)
        u[: plant.inputs] = rng.normal(size=plant.inputs)
        y = np.zeros(6)
        y[: plant.outputs] = plant.c @ x + noise * rng.normal(size=plant.outputs)
        for part in parts:
            if part >= plant.inputs:
                y[part - plant.inputs] += 100.0 * noise[part - plant.inputs] * np.sin(0.9 * k + part)
            else:
                wrong[part] = 3.0 + rng.normal()
        keep(state, y, u, k != lost)
        x = plant.phi @ x + plant.gamma @ (u + wrong)[: plant.inputs] + disturbed * rng.normal(size=plant.states)
    return state


def test_what_is_at_fault_is_left_out_by_each_test_that_passes(params):
    rng = np.random.default_rng(SEED)
    count = params.plant.inputs + params.plant.outputs
    for parts in ((0,), (count - 1,), (0, count - 1), (count - 2, count - 1), (0, count - 2)):
        levels = params.windows.levels(drive(params, rng, parts))
        passed = {apart for apart, level in zip(params.windows.apart, levels, strict=True) if level < 1.0}
        assert parts in passed, (SEED, parts, levels)
        assert all(set(parts) <= set(apart) for apart in passed), (SEED, parts, levels)


def test_of_a_healthy_window_and_one_with_a_lost_sample_nothing_is_said(params):
    rng = np.random.default_rng(SEED)
    for _ in range(20):
        assert np.isnan(params.windows.levels(drive(params, rng))).all(), SEED
    assert np.isnan(params.windows.levels(drive(params, rng, (0, 1), lost=30))).all()


def test_a_window_without_a_fault_has_its_chi_square(params):
    rng = np.random.default_rng(SEED)
    check = params.windows.checks[0]
    degrees = len(check.left)
    values = []
    for _ in range(60):
        state = drive(params, rng)
        order = (int(state["at"]) + np.arange(LENGTH)) % LENGTH
        y = state["y"][order, : params.plant.outputs].ravel()
        u = state["u"][order, : params.plant.inputs].ravel()
        values.append(np.sum((check.left @ (y - params.windows.forced @ u)) ** 2) / degrees)
    assert np.mean(values) == pytest.approx(1.0, abs=5.0 * np.sqrt(2.0 / degrees / 60)), SEED


def test_each_test_blames_all_that_it_does_not_leave_out(params):
    blamed = _behind(params)
    assert len(blamed) == len(params.windows.apart)
    for apart, parts in zip(params.windows.apart, blamed.values(), strict=True):
        assert len(parts) == params.plant.inputs + params.plant.outputs - len(apart) + 1  # and the model


def test_matrices_that_are_not_exact_have_no_windows(params):
    loose = Params(**{**params.model_dump(exclude_unset=True), "model_error": 0.05})
    assert loose.windows is None
    assert _behind(loose) == {}
