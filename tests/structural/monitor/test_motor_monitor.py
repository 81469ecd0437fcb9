"""The motor of models/motor.toml as a monitor: samples, residuals and diagnosis beside the same by hand."""

from itertools import pairwise

import motor_data
import numpy as np
import pytest
from amount import amount
from motor_data import DT, B, J, K, R
from structural_config import NU, configuration

from gateway.bus.frames import empty, put
from gateway.config.load import load_config
from gateway.runtime.app import Gateway
from gateway_fdi.common.resources import shipped
from gateway_fdi.jit import COMPILED

BEGIN = 10**9
TESTS = ("e1", "e1_2", "e5", "e5_2")
#: Not while the motor runs up: the step of 10 ms is not small there.
TURNS = 'active = "omega > 20"\nsettle_s = 3\n'
SECONDS = amount(60, 40, 25 if COMPILED else 12)
compiled = pytest.mark.skipif(not COMPILED, reason="thousands of samples")


class Run:
    """A gateway of the motor that is fed frames."""

    def __init__(self, config):
        self.gateway = Gateway(load_config(config), None, file=config)
        self.events = []
        self.gateway.listen(self.events.append)
        self.gateway.start(BEGIN)
        self.state = self.gateway.engine.state_of(0)[0]

    def feed(self, frames):
        self.gateway.feed(frames)
        return self

    def residuals(self, frames):
        """Feed frames one by one; the time and the residuals of each sample that was taken."""
        times, rows = [], []
        for k in range(len(frames)):
            before = int(self.state.own.samples)
            self.gateway.feed(frames[k : k + 1])
            if self.state.own.samples != before:
                times.append(int(self.state.own.last_ns))
                rows.append(self.state.own.residual[:4].copy())
        return np.array(times), np.array(rows)

    def failed(self):
        told = [e for e in self.events if e["event"] == "dtc" and e["status"] & 1]
        return list(dict.fromkeys(e["fault"].split(".", 1)[1] for e in told))


def by_hand(samples, dts):
    """The residuals of the four tests, from u, i, w, in the order of TESTS; a dt of 0 begins anew.

    Voltage and current are held, so that the speed is exact: x + (exp(a dt) - 1) / a x'.
    """
    pole = {"e1_2": -B / J, "e5": -(K**2 / R + B) / J, "e5_2": -B / J}
    rows = np.zeros((len(samples), 4))
    state = {}
    for n, ((u, i, w), dt) in enumerate(zip(samples, dts, strict=True)):
        if dt == 0.0:
            state = {"e1_2": (u - R * i) / K, "e5": w, "e5_2": w}
            slopes = dict.fromkeys(state, 0.0)
        omega = {name: x + np.expm1(pole[name] * dt) / pole[name] * slopes[name] for name, x in state.items()}
        current = {"e1_2": i, "e5": (u - K * omega["e5"]) / R, "e5_2": i}
        slopes = {name: (K * current[name] - B * omega[name]) / J for name in omega}
        state = omega
        rows[n] = u - R * i - K * w, u - R * i - K * omega["e1_2"], w - omega["e5"], w - omega["e5_2"]
    return rows


def test_residuals_are_those_by_hand(tmp_path):
    """By sets; all four tests from the samples that cantools decodes."""
    frames = motor_data.frames_of(motor_data.drive(4, seed=2, noise=3.0, f_R=0.2, f_w=1.0))
    _, found = Run(configuration(tmp_path, 'sample = "set"\n')).residuals(frames)
    samples = motor_data.decoded(frames)
    dts = [0.0] + [DT] * (len(samples) - 1)
    assert len(found) == len(samples)
    assert np.abs(found - by_hand(samples, dts)).max() < 1e-9
    assert np.abs(found).max(0).min() > 0.1


def test_lost_frames_are_stepped_over(tmp_path):
    """A set that lacks a frame is no sample; the next one spans the gap, and behind six all begins anew."""
    frames = motor_data.frames_of(motor_data.drive(2, seed=3))
    samples = motor_data.decoded(frames)
    lost = {20, 21, 50, *range(80, 85), *range(110, 116)}
    kept = np.array([not (n // 2 in lost and n % 2 == (n // 2) % 2) for n in range(len(frames))])
    _, found = Run(configuration(tmp_path, 'sample = "set"\n')).residuals(frames[kept])
    there = [n for n in range(len(samples)) if n not in lost]
    assert len(found) == len(there)
    dts = [0.0, *(DT * (b - a) if b - a <= 6 else 0.0 for a, b in pairwise(there))]
    assert dts.count(0.0) == 2
    assert np.abs(found - by_hand(samples[there], dts)).max() < 1e-9


def asynchronous(rows, current_each=3):
    """Drive each sample, Sensors only each third, and never at the clock's time."""
    frames = motor_data.frames_of(rows, between_ns=3_000_000)
    return frames[[n for n in range(len(frames)) if n % 2 == 0 or (n // 2) % current_each == 0]]


def test_by_the_clock_values_are_held(tmp_path):
    """At each multiple of the period once all is there, from the newest values that came before it."""
    rows = motor_data.drive(2, seed=4)
    frames = asynchronous(rows)
    samples = motor_data.decoded(motor_data.frames_of(rows))
    times, found = Run(configuration(tmp_path)).residuals(frames)
    assert times.tolist() == [BEGIN + n * 10_000_000 for n in range(1, len(rows))]
    # The frame of that very time has not come yet.
    held = [(samples[n - 1, 0], *samples[(n - 1) // 3 * 3, 1:]) for n in range(1, len(rows))]
    assert np.abs(found - by_hand(held, [0.0] + [DT] * (len(times) - 1))).max() < 1e-9


def test_what_is_too_old_makes_no_sample(tmp_path):
    """The sensors are silent for 0.41 s, and their age is 50 ms 50 ms later: the sample behind that is the one after
    their next frame, and everything begins anew with it."""
    frames = motor_data.frames_of(motor_data.drive(2, seed=5))
    silent = (frames["can_id"] == 513) & (frames["t_ns"] > BEGIN + 10**9) & (frames["t_ns"] < BEGIN + 1.4e9)
    run = Run(configuration(tmp_path, "max_age_ms = 50\n"))
    times, _ = run.residuals(frames[~silent])
    gap = np.diff(times)
    assert sorted(set(gap.tolist())) == [10_000_000, 410_000_000 - 50_000_000 + 10_000_000]
    assert (gap > 10_000_000).sum() == 1
    assert int(run.state.own.missed) == 36
    assert int(run.state.own.since_ns) == times[np.argmax(gap) + 1]


def test_it_runs_while_the_condition_holds(tmp_path):
    """`omega` is an unknown: what its sensor says stands for it."""
    rows = motor_data.drive(3, seed=6)
    frames = motor_data.frames_of(rows)
    speed = motor_data.decoded(frames)[:, 2]
    times, _ = Run(configuration(tmp_path, 'sample = "set"\nactive = "omega > 60 and u > 0"\n')).residuals(frames)
    wanted = np.flatnonzero(speed > 60)
    assert 0 < len(wanted) < len(rows)
    assert ((times - BEGIN) // 10_000_000).tolist() == wanted.tolist()


@compiled
@pytest.mark.parametrize(
    ("fault", "size"), [("f_R", 0.3), ("f_b", 0.5), ("f_i", 0.5), ("f_w", 5.0), ("f_w", -5.0), ("f_R", -0.3)]
)
def test_each_fault_has_its_name(tmp_path, fault, size):
    run = Run(configuration(tmp_path, TURNS)).feed(
        motor_data.frames_of(motor_data.drive(SECONDS, seed=7, onset=10.0, **{fault: size}))
    )
    assert run.failed() == [fault]
    (event,) = [e for e in run.events if e["event"] == "dtc" and e["status"] & 1]
    assert event["t_ns"] - BEGIN > 10e9
    place = ("f_R", "f_b", "f_i", "f_w").index(fault) + 1
    words = event["evidence"]
    (ranked,) = [v for k, v in words.items() if k.startswith("faults that explain them")]
    assert ranked == place
    checked = [k for k in words if k.startswith("residual of")]
    assert len(checked) == 2
    ((label, told),) = [(k, v) for k, v in words.items() if k.startswith("size of")]
    text = {"f_R": "winding's resistance", "f_b": "bearing's friction", "f_i": "current's", "f_w": "speed's"}[fault]
    assert label.startswith(f"size of the fault: the {text}")
    assert told == pytest.approx(size, rel=0.05)
    shown = run.gateway.engine.readout()["motor"]
    assert shown[f"size_{fault}"] == pytest.approx(size, rel=0.05)
    assert all(k.startswith("residual of test ") for k in checked)


@compiled
def test_a_fault_that_goes_away_keeps_its_name(tmp_path):
    """Its tests come down one after the other: what is left of them would fit others, too."""
    rows = motor_data.drive(60, seed=7)
    rows[1000:2000, 1] += 0.5
    run = Run(configuration(tmp_path, TURNS)).feed(motor_data.frames_of(rows))
    told = [(e["fault"], e["status"] & 1) for e in run.events if e["event"] == "dtc"]
    assert told == [("motor.f_i", 1), ("motor.f_i", 0)]


@compiled
def test_healthy_drives_have_none(tmp_path):
    for seed in range(amount(10, 3)):
        run = Run(configuration(tmp_path, TURNS)).feed(motor_data.frames_of(motor_data.drive(SECONDS, seed=seed)))
        assert run.failed() == []


@compiled
def test_two_faults_at_once_have_no_single_name(tmp_path):
    """Friction and the current's sensor fire all four tests: that no fault alone explains."""
    rows = motor_data.drive(32, seed=8, f_b=1.0, f_i=1.0, onset=10.0)
    run = Run(configuration(tmp_path, TURNS + "confirm_s = 3\n")).feed(motor_data.frames_of(rows))
    assert run.failed() == ["unisolated"]


@compiled
def test_faults_that_fit_alike_are_a_group(tmp_path):
    """With the static test alone three faults cannot be told apart: one DTC for the three."""
    more = 'tests = ["1:e1"]\nunseen = ["f_b"]\nnu = { 1_e1 = 0.065 }\nthresholds = { 1_e1 = 50 }\n'
    run = Run(configuration(tmp_path, TURNS + more, nu=None)).feed(
        motor_data.frames_of(motor_data.drive(SECONDS, seed=7, onset=10.0, f_R=0.3))
    )
    assert run.failed() == ["f_R_or_f_i_or_f_w"]


@compiled
def test_a_part_of_the_tests_names_nobody_else(tmp_path):
    """Without thresholds for one test it never fires; what the others say is a group or nothing, never a wrong name."""
    for silent in TESTS:
        for fault, size in (("f_R", 0.3), ("f_b", 0.5), ("f_i", 0.5), ("f_w", 5.0)):
            nu = {k: v for k, v in NU.items() if k != silent}
            run = Run(configuration(tmp_path, TURNS, nu=nu)).feed(
                motor_data.frames_of(motor_data.drive(25, seed=7, onset=8.0, **{fault: size}))
            )
            assert set(run.failed()) <= {fault, "unisolated"}, (silent, fault)
            assert run.failed(), (silent, fault)


def test_a_reload_goes_on(tmp_path):
    """The same model and parameters: the same monitor, and its state; another model is another one."""
    frames = motor_data.frames_of(motor_data.drive(1, seed=9))
    path = configuration(tmp_path)
    old = Run(path).feed(frames[:100])
    new = Gateway(load_config(path), None, file=path)
    assert new.engine.monitors[0].monitor is old.gateway.engine.monitors[0].monitor
    own = tmp_path / "mine.toml"
    own.write_text(shipped("models/motor.toml").read_text().replace("- b *", "- 1.0 * b *"))
    other = Gateway(load_config(configuration(tmp_path, model="mine.toml")), None)
    assert other.engine.monitors[0].monitor is not old.gateway.engine.monitors[0].monitor
    for gateway in (old.gateway, new, other):
        gateway.close()


def test_frames_that_cannot_be_read_are_no_arrivals(tmp_path):
    """Too short a frame has no values: the ones before it are held, with their age."""
    frames = motor_data.frames_of(motor_data.drive(1, seed=9))
    run = Run(configuration(tmp_path, 'sample = "set"\n')).feed(frames[:100])
    before = int(run.state.own.samples)
    broken = empty(1)
    put(broken, 0, int(frames[100]["t_ns"]), 512, b"", bus=0)
    run.feed(broken).feed(frames[101:102])
    assert int(run.state.own.samples) == before
