"""Mathematics over arrays: against NumPy, SciPy, or the same class value by value; seeds are printed."""

import itertools

import numpy as np
import pytest
from residual_runner import Runner
from scipy.signal import dlsim

import gateway_api as api
from gateway_fdi import (
    FAILED,
    Component,
    Cusum,
    Diagnoser,
    GatewayError,
    Link,
    Residual,
    StoppingRule,
    Test,
    load_model,
    residuals,
)
from gateway_plants.crank.arrays import CrankWheel
from gateway_plants.linear.arrays import Observer, PiBank
from gateway_plants.linear.study import example
from gateway_plants.linear.study.bank import bank_of, walk
from gateway_plants.pedal.arrays import Voter

SEED = 20261126
RULES = {
    "direct": (2.0, {}),
    "gma": (0.6, {"forget": 0.9}),
    "cusum": (4.0, {"drift": 0.5}),
    "sprt": (4.0, {}),
    "chi_square": (12.0, {"window": 7}),
}


@pytest.fixture
def rng():
    print("seed", SEED)
    return np.random.default_rng(SEED)


@pytest.mark.parametrize("rule", RULES)
def test_a_rule_over_an_array_is_the_rule_value_by_value(rule, rng):
    x = rng.normal(0.4, 1.0, 300)
    whole, single, halves = (StoppingRule(rule, RULES[rule][0], **RULES[rule][1]) for _ in range(3))
    alarms = whole.run(x)
    assert alarms.tolist() == [single.update(value) for value in x]
    assert alarms.tolist() == [*halves.run(x[:100]), *halves.run(x[100:])]
    assert 0 < alarms.sum() < len(x)
    assert whole.alarm == alarms[-1]
    whole.reset()
    assert whole.level == 0.0


def test_cusum_is_its_recursion_and_its_threshold_leaves_healthy_residuals_half(rng):
    healthy, r = rng.normal(0.0, 0.3, 5000), rng.normal(0.5, 0.3, 50)
    test = Cusum.learned(healthy)
    assert test.nu == pytest.approx(np.abs(healthy).mean() + np.abs(healthy).std())
    assert Cusum(test.nu, test.threshold).run(healthy).max() <= 0.5
    low = Cusum.learned(healthy, floor=1e-9)
    assert Cusum(low.nu, low.threshold).run(healthy).max() == pytest.approx(0.5)
    t, found = 0.0, []
    for value in r:
        t = min(max(0.0, t + abs(value) - test.nu), 5.0 * test.threshold)
        found.append(t / test.threshold)
    np.testing.assert_allclose(test.run(r), found, rtol=1e-12)


def tanks():
    return load_model(api.shipped("models/tanks.toml"))


def test_a_residual_over_an_array_is_its_generator_sample_by_sample(rng):
    model = tanks()
    t = np.cumsum(rng.uniform(0.05, 0.15, 200))
    known = {name: rng.uniform(0.5, 1.0, 200) for name in ("y1", "y2", "y3")} | {"u": 50.0}
    (first, *_) = found = residuals(model)
    assert {fault for one in found for fault in one.faults} == set(model.faults)
    runner = Runner(first._loaded)
    rows = [{name: np.broadcast_to(known[name], t.shape)[k] for name in first.knowns} for k in range(len(t))]
    runner.start(**rows[0])
    steps = np.diff(t, prepend=t[0])
    expected = [runner.step(dt, **row) for dt, row in zip(steps, rows, strict=True)]
    np.testing.assert_array_equal(first.run(t, known), expected)
    np.testing.assert_array_equal(first.run(t, known), expected)  # a record begins again


@pytest.mark.parametrize("since", [0, 120])
def test_the_gain_of_a_fault_is_what_it_leaves_in_the_residual(rng, since):
    """An offset of a sensor is in the records themselves, so what explains it needs no gain: not of ours."""
    t = np.arange(0.0, 30.0, 0.1)
    fine = {"u": 50.0} | {name: middle + rng.normal(0.0, 1e-3, 300) for name, middle in
            (("y1", 1.0), ("y2", 0.6), ("y3", 0.3))}  # fmt: skip
    faulty = fine | {"y2": fine["y2"] + 0.05 * (np.arange(300) >= since)}
    seen = [residual for residual in residuals(tanks()) if "f_2" in residual.faults]
    assert len(seen) == 3
    for residual in seen:
        left = residual.run(t, faulty) - residual.run(t, fine)
        gain = residual.gain("f_2", t, faulty, size=0.05, since=since)
        np.testing.assert_allclose(0.05 * gain, left, rtol=1e-9, atol=1e-12)
        assert np.abs(left[-1]) > 1e-6
        slope = residual.gain("f_2", t, fine, since=since)
        np.testing.assert_allclose(residual.gain("f_2", t, fine, size=2e-4, since=since), slope, rtol=1e-2, atol=1e-4)


def test_the_gain_of_a_fault_within_an_equation_with_given_solutions():
    """Pump: q0 = k (1 - f_p) u, so a pump that gives f_p less leaves k f_p u / (10 A) in the first tank's slope."""
    t = np.arange(0.0, 400.0, 0.1)
    known = {"u": 50.0, "y1": 1.0, "y2": 0.6, "y3": 0.3}
    (first,) = (residual for residual in residuals(tanks()) if "f_p" in residual.faults)
    gain = first.gain("f_p", t, known, size=0.3)[-1]
    assert gain == pytest.approx(-0.02 * 50.0 / 200.0)
    (clogged,) = (residual for residual in residuals(tanks()) if residual.faults == ("f_c", "f_1", "f_2", "f_3"))
    assert clogged.gain("f_c", t, known)[-1] != 0.0  # e3 has given solutions, which leave the fault out


def test_a_model_of_tables_is_that_of_its_file():
    tables = {
        "unknown": {"x": {}},
        "known": {"u": {}, "y": {}},
        "fault": {"f": {}},
        "parameter": {"a": {"value": 2.0}},
        "equation": {
            "e1": {"relation": "x = a * u", "unique": ["x"]},
            "e2": {"relation": "y = x + f", "unique": ["x"]},
        },
    }
    (residual,) = residuals(load_model(tables), filter_bandwidth=5.0)
    assert residual.faults == ("f",)
    t = np.arange(0.0, 20.0, 0.1)
    assert abs(residual.run(t, {"u": 1.0, "y": 2.0 + 0.5 * (t > 1.0)})[-1]) == pytest.approx(0.5, rel=1e-6)
    assert residual.run(t, {"u": 1.0, "y": 2.0})[-1] == pytest.approx(0.0, abs=1e-9)


def test_a_wheel_piece_by_piece_is_the_whole_wheel(rng):
    pitches = np.tile(np.r_[np.ones(57), 3.0], 60)
    times = np.delete(np.cumsum(pitches * rng.normal(1.0, 0.003, len(pitches))) * 2e-4, [58 * 30 + 21, 58 * 40 + 5])
    whole, parts = CrankWheel("60-2"), CrankWheel("60-2")
    found = whole.run(times)
    cuts = [0, 1, 300, 301, 2000, len(times)]
    pieces = [parts.run(times[a:b]) for a, b in itertools.pairwise(cuts)]
    np.testing.assert_array_equal(np.concatenate([piece.tooth for piece in pieces]), found.tooth)
    np.testing.assert_array_equal(np.concatenate([piece.t_s for piece in pieces]), times[1:])
    assert [row["count"] for piece in pieces for row in piece.reports.records()] == [1, 1]
    assert list(found.reports["fault"]) == ["missed_pulse", "missed_pulse"]
    assert whole.synchronised
    proven = found.rpm[found.proven]
    assert np.nanmax(np.abs(proven / (60.0 / (60 * 2e-4)) - 1.0)) < 0.02  # also over the pulses that are missed


def test_voters_are_numpys(rng):
    three, two = rng.normal(2.0, 0.5, (200, 3)), rng.normal(2.0, 0.5, (200, 2))
    np.testing.assert_allclose(Voter("average", 3).run(three).value, three.mean(1))
    np.testing.assert_array_equal(Voter("median", 3).run(three).value, np.median(three, 1))
    np.testing.assert_allclose(Voter("median", 2).run(two).value, two.mean(1))
    stuck = 2.5 + 1.5 * np.sin(np.arange(2000) / 150)[:, None] + rng.normal(0.0, 0.002, (2000, 2))
    stuck[900:, 1] = stuck[900, 1]
    voted = Voter("tracking", 2, high=5.0, noise=0.002).run(stuck)
    assert set(voted.isolated[:900]) == {0}
    assert voted.isolated[-1] == 2
    assert np.abs(voted.value - stuck[:, 0]).max() < 0.05


def test_the_bank_is_the_studys(rng):
    limits = {"actuator": example.ACTUATOR_LIMIT, "sensor": example.SENSOR_LIMIT}
    bank = PiBank(example.A, example.B, example.C, example.PERIOD, noise=example.NOISE, **limits)
    y, u = rng.normal(0.0, 0.01, (300, 3)), np.zeros((300, 2))
    y[150:, 1] += 0.5
    ours, theirs = bank.run(y, u), walk(*bank_of(5.0), y, u)
    for name in ("actuators", "sensors", "fault", "offset", "unexplained", "tested"):
        np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name))
    assert ours.sensors.any(0).tolist() == [False, True, False]
    assert ours.offset[-1, 1] == pytest.approx(0.5, abs=0.05)


def test_what_an_observer_leaves_of_a_healthy_plant_is_white(rng):
    phi, gamma, c = np.array([[0.95, 0.1], [0.0, 0.9]]), np.array([[0.0], [0.1]]), np.eye(2)
    u = rng.normal(0.0, 1.0, (4000, 1))
    _, y, _ = dlsim((phi, gamma, c, np.zeros((2, 1)), 0.1), u)
    observer = Observer(phi, gamma, c, 0.1, noise=0.05, disturbance=1e-3, discrete=True)
    squared = observer.squared(observer.run(y + rng.normal(0.0, 0.05, y.shape), u))[200:]
    assert squared.mean() == pytest.approx(2.0, rel=0.1)
    assert (squared > observer.threshold(0.01)).mean() == pytest.approx(0.01, abs=0.005)


def test_causes_have_names():
    diagnoser = Diagnoser([Component("pump")], [Test("flow", (Link("pump", 0.9),))])
    assert diagnoser.causes() == []
    diagnoser.update("flow", FAILED, 1)
    (first, _) = diagnoser.causes()
    assert first[0] == ("pump",)
    assert first[1] > 0.5


def _gain(**more):
    residual = residuals(tanks())[0]
    return residual.gain(residual.faults[0], [0.0, 1.0], {}, **more)


WRONG = {
    "rule": (lambda: StoppingRule("cusums", 1.0), "rule = 'cusums': .* did you mean cusum"),
    "parameter": (lambda: StoppingRule("cusum", 1.0, drif=0.5), "drif = 0.5: .* did you mean drift"),
    "window": (lambda: StoppingRule("chi_square", 1.0, window=99), "parameters: a window has 1 to 64"),
    "text": (lambda: Cusum(1.0, 1.0).run(["a"]), "residual: numbers"),
    "few": (lambda: Cusum.learned([1.0]), "healthy: 1 residuals"),
    "nan": (lambda: Cusum.learned([np.nan] * 200), "healthy: 200 residuals"),
    "drift": (lambda: Cusum(0.0, 1.0), "nu = 0.0: a number above 0"),
    "test": (lambda: Residual(tanks(), "1:e99"), "set 1 has"),
    "known": (lambda: residuals(tanks())[0].run([0.0, 1.0], {"u": 1.0}), "y1: "),
    "fault": (lambda: residuals(tanks())[0].gain("f_l", [0.0, 1.0], {}), "fault = 'f_l': the faults that e2 sees are"),
    "size": (lambda: _gain(size=0.0), "size = 0.0: a number that is not 0"),
    "since": (lambda: _gain(since=-1), "since = -1: a sample of the record: 0 to 1"),
    "times": (lambda: residuals(tanks())[0].run([1.0, 0.0], {}), "t_s: two times at least"),
    "value": (lambda: residuals(tanks(), values={"nix": 1.0}), 'values: "nix" is no parameter of tanks'),
    "wheel": (lambda: CrankWheel("60:2"), "wheel = '60:2'"),
    "backwards": (lambda: CrankWheel("60-2").run([1.0, 0.5]), "times_s: each pulse"),
    "channels": (lambda: Voter("median", 4), "channels = 4: 2 or 3"),
    "cause": (lambda: Diagnoser([], [Test("flow", (Link("pump", 0.9),))]), "there is no component 'pump'"),
    "verdict": (lambda: Diagnoser([], []).update("flow", FAILED, 1), "test = 'flow': the tests are"),
    "shape": (lambda: Voter("median", 3).run(np.zeros((4, 2))), r"readings: shape \(n, 3\), not \(4, 2\)"),
    "plant": (lambda: PiBank(np.eye(2), [[1.0]], np.eye(2), 0.1, noise=1, actuator=1, sensor=1), "plant: b has 1 rows"),
    "noise": (lambda: PiBank([[0.0]], [[1.0]], [[1.0]] * 2, 0.1, noise=0, actuator=1, sensor=1), "noise = 0: above 0"),
}


@pytest.mark.parametrize("name", WRONG)
def test_errors_name_the_argument(name):
    call, text = WRONG[name]
    with pytest.raises(GatewayError, match=text):
        call()
