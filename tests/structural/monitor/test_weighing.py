"""Faults that fire the same tests are told apart by sign and size of all residuals; what is not is told as it is."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from structural_config import named

from gateway.config.load import load_config
from gateway.runtime.app import Gateway
from gateway_fdi.jit import COMPILED
from gateway_fdi.masks import pack, unpack
from gateway_plants.structural.monitor.faults import levels
from gateway_plants.structural.study.drives import calibrated, configuration, frames_of
from gateway_plants.structural.study.foreign import Plant

pytestmark = pytest.mark.skipif(not COMPILED, reason="tens of thousands of samples")

SEED = 67_200
#: Three sensors of one speed, the third one noisy: of a small fault of one of the others one test fires alone.
SPEEDS = Plant(
    "speeds",
    """
[unknown]
v = { unit = "m/s" }
[known]
a = { unit = "km/h" }
b = { unit = "m/s" }
c = { unit = "m/s" }
[fault]
f_a = {}
f_b = {}
f_c = {}
[equation.e1]
relation = "a = 3.6 * v * (1 + f_a)"
unique = ["v"]
[equation.e2]
relation = "b = 1.0 * v + f_b"
unique = ["v"]
[equation.e3]
relation = "c = v + f_c"
unique = ["v"]
""",
    0.01, {}, lambda _: (), lambda x, u, p: (), lambda rng, seconds: (np.zeros(1), np.zeros((1, 1))),
    lambda x, u, p: (), ("a", "b", "c"), (0.036, 0.01, 0.3), {}, (), (), "",
)  # fmt: skip


def drive(seed, gain=0.0, bias=0.0, until=40.0, second=20.0, burst=0.0):
    """Readings of a speed that goes up and down; from the middle on one has another gain, or one a bias.

    At 34 s two of them swing for half a second, one against the other.
    """
    rng, t = np.random.default_rng(seed), np.arange(4000) * 0.01
    v, late = 10.0 + 10.0 * np.sin(0.5 * t), (t >= 20.0) & (t < until)
    swing = burst * np.sin(40.0 * t) * ((t >= 34.0) & (t < 34.5))
    rows = np.stack([3.6 * (v * (1.0 + gain * late) + swing), v + bias * late * (t >= second) - swing, v], 1)
    return frames_of(SPEEDS, rows + rng.normal(size=rows.shape) * np.array(SPEEDS.noise))


@pytest.fixture(scope="module")
def config(tmp_path_factory):
    found = configuration(SPEEDS, tmp_path_factory.mktemp("speeds"))
    calibrated(found, drive(1), drive(2))
    return found


@pytest.mark.parametrize("fault", [{"gain": 0.02}, {"gain": -0.02}, {"bias": 0.2}, {"bias": -0.2}])
def test_a_fault_of_which_one_test_fires_has_its_name(config, fault):
    print("seed", SEED)
    assert named(config, drive(SEED, **fault)) == ["f_a" if "gain" in fault else "f_b"]


def test_the_only_fault_of_a_model_has_its_name(tmp_path):
    """There is no pair that could fit better."""
    model = SPEEDS.model.replace("f_b = {}\nf_c = {}\n", "").replace(" + f_b", "").replace(" + f_c", "")
    config = configuration(replace(SPEEDS, model=model), tmp_path, 'sensors = { c = { gain = "0.1 %" } }\n')
    calibrated(config, drive(1), drive(2))
    _, state = events_of(config, drive(SEED, gain=0.5))
    assert (state["own"]["found"], state["own"]["weighed"]) == (0, 1)


def weighed(config, frames, until=40.0):
    """Return what the monitor's state says after so many seconds: likely faults, whether it waits behind a fault."""
    gateway = Gateway(load_config(config), None, file=config)
    start = int(frames[0]["t_ns"])
    gateway.start(start)
    gateway.feed(frames[frames["t_ns"] < start + until * 1e9])
    state = gateway.engine.state_of(0)[0]
    likely = unpack(np.asarray(state["own"]["likely"])[None, :], 3)[0]
    found = [f for f, one in zip(("f_a", "f_b", "f_c"), likely, strict=True) if one and state["own"]["weighed"] == 1]
    held = bool(state["fit"]["held"])
    gateway.close()
    return found, held


def test_behind_a_fault_nothing_is_weighed_until_the_residuals_have_settled(config):
    frames = drive(SEED, bias=0.2, until=26.0)
    assert weighed(config, frames, 25.9) == (["f_b"], False)
    assert weighed(config, frames, 28.0) == (["f_b"], True), "its name stands while its tests come down"
    assert weighed(config, frames) == ([], False)
    assert named(config, frames) == ["f_b"]


@pytest.mark.parametrize("gain", [0.007, 0.02])
def test_of_two_faults_none_is_likely(config, gain):
    """One leaves more than a single fault may; the smaller one is seen by its likelihood beside the other only."""
    assert weighed(config, drive(SEED, gain=gain, bias=-0.2)) == ([], False)
    assert weighed(config, drive(SEED, bias=-0.2)) == (["f_b"], False)


def test_a_fault_has_not_ended_where_another_one_begins(config):
    assert weighed(config, drive(SEED, gain=0.02, bias=0.3, second=30.0)) == ([], False)


@pytest.fixture(scope="module")
def uncertain(tmp_path_factory):
    found = configuration(SPEEDS, tmp_path_factory.mktemp("uncertain"), 'sensors = { c = { gain = "0.1 %" } }\n')
    calibrated(found, drive(1), drive(2))
    return found


@pytest.mark.parametrize("second", [20.0, 30.0])
def test_two_faults_are_both_the_cause(uncertain, second):
    """At once, and one ten seconds after the other."""
    events, state = events_of(uncertain, drive(SEED, gain=0.03, bias=0.3, second=second))
    assert unpack(np.asarray(state["own"]["sure"])[None, :], 3)[0].tolist() == [True, True, False]
    causes = [group["cause"] for e in events if e["event"] == "diagnosis" for group in e["groups"]]
    assert [cause for cause in causes if cause][-1] == ["plant own.f_a", "signal b.M1.b"]


def test_two_that_explain_little_more_than_one_are_no_cause(uncertain):
    """As much may be what the model lacks."""
    events, state = events_of(uncertain, drive(SEED, gain=0.02, bias=-0.4))
    assert unpack(np.asarray(state["own"]["sure"])[None, :], 3)[0].tolist() == [True, True, False]
    groups = [group for e in events if e["event"] == "diagnosis" for group in e["groups"]]
    assert groups
    assert not any(group["cause"] for group in groups)


def test_a_pair_stays_where_no_fault_explains_a_block(uncertain):
    events, state = events_of(uncertain, drive(SEED, gain=0.03, bias=0.3, burst=1.0))
    assert state["own"]["weighed"] == 2
    causes = [group["cause"] for e in events if e["event"] == "diagnosis" for group in e["groups"]]
    assert [cause for cause in causes if cause][-1] == causes[-1] == ["plant own.f_a", "signal b.M1.b"]


def test_what_the_blocks_have_said_stays_where_the_tests_begin_anew(uncertain):
    frames = drive(SEED, gain=0.02)
    t_s = (frames["t_ns"] - frames["t_ns"][0]) / 1e9
    _, before = events_of(uncertain, frames[t_s < 30.0])
    _, after = events_of(uncertain, frames[(t_s < 30.0) | (t_s > 33.0)])
    assert after["own"]["since_ns"] > before["own"]["since_ns"], "the tests have begun anew"
    assert after["fit"]["count"] > before["fit"]["count"] > 0


@pytest.mark.parametrize("bias", [0.0, 0.2])
def test_healthy_logs_say_from_which_likelihood_a_fault_speaks(tmp_path, bias):
    """Square root of twice its logarithm: no less than by theory, and twice the largest of the logs."""
    config = configuration(SPEEDS, tmp_path, 'sensors = { c = { gain = "0.1 %" } }\n')
    calibrated(config, drive(1, bias=bias), drive(2))
    thresholds = load_config(config).monitor[0].thresholds
    least = pytest.approx(40.0**0.5, rel=1e-3)
    assert [thresholds[f"likelihood_{one}"] for one in ("f_a", "f_c", "none")] == [least] * 3
    if bias:
        assert thresholds["likelihood_f_b"] > 9.0
        return
    assert thresholds["likelihood_f_b"] == least
    frames = drive(SEED, bias=0.2)
    assert named(config, frames) == ["f_b"]
    config.write_text(config.read_text().replace("likelihood_f_b = 6.325", "likelihood_f_b = 200.0"))
    assert named(config, frames) == []


def still(seed, offset=0.0, since=20.0):
    """Readings of a speed that stands, noise apart; from a time on one sensor has an offset."""
    rng, t = np.random.default_rng(seed), np.arange(4000) * 0.01
    rows = np.stack([np.full(4000, 36.0), 10.0 + offset * (t >= since), np.full(4000, 10.0)], 1)
    return frames_of(SPEEDS, rows + rng.normal(size=rows.shape) * np.array(SPEEDS.noise))


def events_of(config, frames):
    """Return all events, and the end state of the monitor."""
    gateway, events = Gateway(load_config(config), None, file=config), []
    gateway.listen(events.append)
    gateway.start(int(frames[0]["t_ns"]))
    gateway.feed(frames)
    state = gateway.engine.state_of(0)[0].copy()
    gateway.close()
    return events, state


def test_one_of_two_that_nothing_tells_apart_is_told_soon(config):
    """A gain of one, an offset of the other: of a speed that stands the same, until the noisy third one says which."""
    frames = still(SEED, 0.2)
    events, _ = events_of(config, frames)
    told = [e for e in events if e["event"] == "dtc" and e["status"] & 1]
    assert told[0]["fault"].endswith(".unisolated")
    assert (told[0]["t_ns"] - int(frames[0]["t_ns"])) / 1e9 - 20.0 < 4.0, "not after 5 confirm_s"
    (ranked,) = (value for name, value in told[0]["evidence"].items() if name.startswith("faults that explain"))
    assert sorted(divmod(int(ranked), 100)) == [1, 2], "f_a and f_b"


def test_a_test_that_fires_without_sizes_that_are_sure_is_no_code(config):
    events, state = events_of(config, still(SEED, 0.02))
    assert state["own"]["norm"].max() > 1.0
    assert [e["fault"] for e in events if e["event"] == "dtc"] == []


def test_of_faults_that_sizes_leave_no_test_proves_one():
    """What only one of them makes fire is in their sizes already."""
    seen = {"f_a": [0, 1], "f_b": [0]}
    tests = [SimpleNamespace(faults=tuple(f for f, of in seen.items() if k in of), faulty="code") for k in (0, 1)]
    plan = SimpleNamespace(faults=tuple(seen), tests=tests, seen_by=seen.get, diagnoses=[("f_a", "f_b"), ("f_a",)])
    both, one = pack([[0, 1], [0]], 2)
    neither = np.zeros_like(both)
    own = {"weighed": 1, "likely": both, "fired": both, "norm": [5.0, 5.0], "found": -1, "by_size": 1}
    own |= {"paired": neither, "sure": neither, "beyond": neither}
    sure = {"pair": np.array([1, 0]), "doubt": 0}
    nan, never = np.nan, -np.inf

    def said(fit=sure, **more):
        return levels(plan, {"own": own | more, "fit": fit})

    no = [never] * 4  # neither more than one of the two, nor better
    np.testing.assert_equal(said(), [2.0, nan, nan, *no, 5.0, never])
    np.testing.assert_equal(said(likely=one), [2.0, nan, 0.0, *no, 5.0, 5.0])
    np.testing.assert_equal(said(likely=one, found=0), [2.0, nan, nan, *no, 5.0, 5.0])  # it has a group's name
    doubted = sure | {"doubt": 1}  # the other one may be there besides, or instead
    np.testing.assert_equal(said(doubted, likely=one), [2.0, nan, nan, *no, 5.0, never])
    silent = [never, never]
    np.testing.assert_equal(said(weighed=-1, likely=one), [never] * 9)
    pair = {"paired": both, "likely": one}
    np.testing.assert_equal(said(weighed=-1, **pair), [2.0, nan, nan, never, 2.0, 2.0, never, *silent])
    np.testing.assert_equal(said(weighed=2, **pair, sure=one), [2.0, 2.0, nan, 2.0, never, never, never, *silent])
    for best, better in ((900.0, 2.0), (1100.0, never)):  # where nothing may be off: a tenth of what one explains
        two = sure | {"second": 50.0, "excess": 2.0, "alone": np.array([best, 10.0])}
        np.testing.assert_equal(said(two, weighed=-1, by_size=0), [*([never] * 5), better, better, 5.0, 5.0])
    # A test that has passed since, having fired for sure, counts where nothing may be off.
    two = sure | {"second": 0.0, "excess": 1.0, "alone": np.ones(2)}
    past = {"norm": [5.0, 0.0], "fired": one, "weighed": -1, "beyond": both}
    np.testing.assert_equal(said(two, **past, by_size=0), [*([never] * 7), 5.0, 3.0])
    np.testing.assert_equal(said(two, **past, by_size=1), [never] * 9)
