"""Filters of filterpy's as monitors: equal to filterpy's own steps, the false alarms that were asked for."""

import json
import textwrap
from itertools import count
from math import nan
from typing import Any

import numpy as np
import pytest
from amount import amount
from filterpy.kalman import KalmanFilter
from scipy.stats import poisson
from stepping import failures

from gateway.bus.frames import empty, put
from gateway.common import trust
from gateway.config.load import load_config
from gateway.monitors.contract import results_of
from gateway.runtime.assemble import prepare
from gateway_fdi.jit import f8s, kernel, zeros
from gateway_plants.filter import author
from gateway_plants.filter import kernel as steps
from gateway_plants.filter.monitor import fill, share
from gateway_plants.filter.params import Params
from gateway_plants.filter.python import pair


@kernel
def over(s: steps.State, c: steps.Const, z: f8s, u: f8s, x: f8s, nis: f8s) -> None:
    """Step over rows of measurements and inputs; keeps x and NIS."""
    for k in range(z.shape[0]):
        for j in range(c.measured):
            s.z[j] = z[k, j]
        for j in range(c.inputs):
            s.u[j] = u[k, j]
        steps.predict(s, c)
        steps.update(s, c)
        nis[k] = s.nis
        for i in range(c.states):
            x[k, i] = s.x[i]


def params(m=1, r=0, **more):
    """Return parameters for so many measurements and inputs."""
    given = {"filter": "mine:make", "period_ms": 10.0, "false_per_hour": 1.0, **more}
    return Params(z=tuple(f"M.Z{k}" for k in range(m)), u=tuple(f"M.U{k}" for k in range(r)), **given)


def records(make, p):
    """Return state and constants of a filter, as they are before its first step."""
    made = author.checked(p, make)
    s, c = zeros(1, steps.State)[0], zeros(1, steps.Const)[0]
    fill(p, made, s, c)
    steps.begin(s, c)
    return s, c


def random_filter(seed):
    """Return a stable filter of 1 to 8 states, measurements and 0 to 8 inputs, and its sizes."""
    rng = np.random.default_rng(seed)
    n, m, r = (int(rng.integers(low, 9)) for low in (1, 1, 0))
    kf = KalmanFilter(n, m, r)
    f = rng.normal(size=(n, n))
    kf.F = f * rng.uniform(0.3, 0.99) / np.abs(np.linalg.eigvals(f)).max()
    kf.H = rng.normal(size=(m, n))
    for name, size in (("Q", n), ("R", m), ("P", n)):
        root = rng.normal(size=(size, size))
        setattr(kf, name, root @ root.T + 0.1 * np.eye(size))
    if r:
        kf.B = rng.normal(size=(n, r))
    kf.x = rng.normal(size=(n, 1))
    if seed % 5 == 0:
        kf.alpha = 1.01
    return kf, (n, m, r)


def both(seed, count):
    """Return x of the kernel and of filterpy, and their NIS, over random rows with missing values."""
    kf, (n, m, r) = random_filter(seed)
    rng = np.random.default_rng(seed + 1)
    z, u = rng.normal(size=(count, m)) * 10.0, rng.normal(size=(count, max(r, 1)))
    z[rng.random(z.shape) < 0.1] = np.nan
    z[rng.random(count) < 0.05] = np.nan
    s, c = records(lambda: kf, params(m, r))
    x, nis = np.zeros((count, n)), np.zeros(count)
    over(s, c, z, u, x, nis)
    x_peer, nis_peer = np.zeros_like(x), np.full(count, np.nan)
    for k in range(count):
        there = np.isfinite(z[k])
        kf.predict(u[k, :r].reshape(-1, 1) if r else None)
        if there.all():
            kf.update(z[k].reshape(-1, 1))
        elif there.any():
            kf.update(z[k][there].reshape(-1, 1), R=kf.R[np.ix_(there, there)], H=kf.H[there])
        else:
            kf.update(None)
        x_peer[k] = kf.x[:, 0]
        if there.any():
            nis_peer[k] = (kf.y.T @ kf.SI @ kf.y).item()
    return x, x_peer, nis, nis_peer, s, kf


@pytest.mark.parametrize("seed", range(amount(200, 200, 20)))
def test_a_linear_filter_is_filterpys(seed):
    x, x_peer, nis, nis_peer, s, kf = both(seed, 12)
    np.testing.assert_allclose(x, x_peer, rtol=1e-10, atol=1e-11 * np.abs(x_peer).max())
    np.testing.assert_allclose(nis, nis_peer, rtol=1e-9)
    n = len(kf.x)
    np.testing.assert_allclose(s.p[:n, :n], kf.P, atol=1e-12 * np.abs(kf.P).max())


DBC = """VERSION ""
NS_ :
BS_:
BU_: ECU
BO_ 256 CAR: 8 ECU
 SG_ Speed : 0|16@1- (0.01,0) [-300|300] "m/s" X
 SG_ Force : 16|16@1- (0.01,0) [-300|300] "kN" X
 SG_ Way : 32|16@1- (0.01,0) [-300|300] "m" X
BO_ 257 BOX: 8 ECU
 SG_ Pedal : 0|16@1- (0.01,0) [-300|300] "%" X
"""
HEAD = """import numpy as np
from filterpy.kalman import *
from filterpy.kalman import ExtendedKalmanFilter, IMMEstimator, KalmanFilter, MerweScaledSigmaPoints
from filterpy.kalman import UnscentedKalmanFilter

def linear():
    kf = KalmanFilter(2, 1, 1)
    kf.F, kf.B = np.array([[1, 0.01], [0, 1]]), np.array([[0], [0.01]])
    kf.H, kf.Q, kf.R = np.array([[1.0, 0]]), np.diag([1e-6, 1e-4]), np.array([[0.01]])
    return kf
"""
EKF = """
def make():
    kf = ExtendedKalmanFilter(2, 1, 1)
    kf.F, kf.B = np.array([[1, 0.01], [0, 0.99]]), np.array([[0], [0.01]])
    kf.x, kf.Q, kf.R, kf.P = np.array([[1.0], [0.1]]), np.eye(2) * 1e-3, np.eye(1) * 0.1, np.eye(2) * 0.2
    def hx(x):
        return np.array([x[0] ** 2]).reshape(1, 1)
    def jacobian(x):
        return np.array([[2 * x[0, 0], 0]])
    return kf, {"HJacobian": jacobian, "Hx": hx}
"""
UKF = """
def make():
    def fx(x, dt, u):
        return np.array([x[0] + dt * x[1], 0.99 * x[1] + dt * u[0]])
    def hx(x):
        return np.array([np.sin(x[0])])
    points = MerweScaledSigmaPoints(2, 0.1, 2.0, 1.0)
    kf = UnscentedKalmanFilter(2, 1, 0.01, hx, fx, points)
    kf.Q, kf.R = np.eye(2) * 1e-3, np.eye(1) * 0.1
    kf.P *= 0.2
    return kf
"""
IMM = """
def make():
    def one(q):
        kf = KalmanFilter(2, 1)
        kf.F, kf.H, kf.Q, kf.R = np.array([[1, 0.01], [0, 1]]), np.array([[1.0, 0]]), np.eye(2) * q, np.eye(1) * 0.01
        return kf
    return IMMEstimator([one(1e-6), one(1e-2)], [0.9, 0.1], np.array([[0.97, 0.03], [0.03, 0.97]]))
"""
_names = count()


@pytest.fixture
def car(tmp_path, monkeypatch):
    """Return a function that writes a filter's file, and returns the path of a configuration with it."""
    monkeypatch.setenv(trust.VARIABLE, trust.ALL)
    (tmp_path / "car.dbc").write_text(DBC)

    def write(text="make = linear", **keys):
        module = f"filter_{next(_names)}"
        (tmp_path / f"{module}.py").write_text(HEAD + textwrap.dedent(text) + "\n")
        given = {
            "filter": f"{module}:make", "z": ["CAR.Speed [m/s]"], "u": ["CAR.Force [kN]"],
            "period_ms": 10.0, "settle": 0, **keys,
        }  # fmt: skip
        path = tmp_path / "gateway.toml"
        path.write_text(
            '[[bus]]\nname = "can"\nuri = "virtual:car"\ndatabase = ["car.dbc"]\n'
            '[[monitor]]\nname = "mine"\ntype = "filter"\n'
            + "".join(f"{key} = {json.dumps(value)}\n" for key, value in given.items() if value is not None)
        )
        return path

    return write


def drive(rows, period_ns=10_000_000):
    """Return frames of CAR, one for each (speed, force, way); None: none comes then."""
    frames = empty(sum(row is not None for row in rows))
    place = 0
    for k, row in enumerate(rows):
        if row is not None:
            payload = b"".join(round(100 * value).to_bytes(2, "little", signed=True) for value in row) + bytes(2)
            put(frames, place, (k + 1) * period_ns, 256, payload, bus=0)
            place += 1
    return frames


def speeds(count, seed=1):
    """Return rows of a car whose speed grows by its jerk, with noise, as they are after the bus."""
    rng = np.random.default_rng(seed)
    force = np.where(np.arange(count) % 200 < 100, 1.0, -1.0)
    rate = np.cumsum(0.01 * force + 0.01 * rng.normal(size=count))
    speed = np.cumsum(0.01 * np.append(0.0, rate[:-1]))
    return [tuple(np.round(row, 2)) for row in np.column_stack([speed + 0.1 * rng.normal(size=count), force, speed])]


@pytest.mark.costly
def test_a_filter_on_the_bus_finds_a_fault(car):
    rows = speeds(1000)
    path = car()
    assert failures(path, drive(rows)) == []
    bad = rows[:500] + [(speed + 0.5, force, way) for speed, force, way in rows[500:]]
    found = failures(path, drive(bad), batch=1)
    assert {name for name, _ in found} >= {"mine.nis", "mine.bias_1_Speed"}
    assert all(5_000_000_000 < t_ns < 5_400_000_000 for _, t_ns in found)
    assert failures(path, drive(bad)) == found


@pytest.mark.parametrize(("text", "keys"), [(EKF, {}), (UKF, {}), (IMM, {"u": None, "modes": ["slow", "fast"]})])
def test_others_are_filterpys_own_steps(text, keys, car):
    rows = [None if k % 17 == 5 else row for k, row in enumerate(speeds(200))]
    path = car(text, **keys)
    engine = prepare(load_config(path), path).engine
    engine.process(drive(rows), lambda _: None)
    space: dict[str, Any] = {}
    exec(HEAD + textwrap.dedent(text), space)  # as in a notebook
    kf, options = pair(space["make"]())
    flat = text == UKF
    held = np.nan
    for speed, force, _ in (np.round(100 * np.array(row or [np.nan] * 3)) * 0.01 for row in rows):
        held = force if np.isfinite(force) else held
        if text == IMM:
            kf.predict()
        elif flat:
            kf.predict(u=np.array([held]))
        else:
            kf.predict(np.array([[held]]))
        if np.isfinite(speed):
            kf.update(np.array([speed]) if flat else np.array([[speed]]), **options)
    s = engine.state_of(engine.place_of("mine"))[0]
    assert s["x"][:2].tolist() == np.ravel(kf.x).tolist()
    if text == IMM:
        assert s["mode"][:2].tolist() == kf.mu.tolist()


def test_a_continuous_model_is_that_of_a_period():
    def make():
        kf = KalmanFilter(2, 1, 1)
        kf.F, kf.B, kf.Q = np.array([[0.0, 1.0], [-4.0, -0.5]]), np.array([[0.0], [2.0]]), np.diag([0.0, 0.3])
        kf.H[0, 0] = 1.0
        return kf

    c = records(make, params(1, 1, period_ms=100.0, continuous=True))[1]
    # By halves: two periods of 50 ms are one of 100 ms.
    half = records(make, params(1, 1, period_ms=50.0, continuous=True))[1]
    f, b, q = half.f[:2, :2], half.b[:2, :1], half.q[:2, :2]
    np.testing.assert_allclose(c.f[:2, :2], f @ f, rtol=1e-12)
    np.testing.assert_allclose(c.b[:2, :1], f @ b + b, rtol=1e-12)
    np.testing.assert_allclose(c.q[:2, :2], f @ q @ f.T + q, rtol=1e-10)
    small = records(make, params(1, 1, period_ms=0.01, continuous=True))[1]
    np.testing.assert_allclose((small.f[:2, :2] - np.eye(2)) / 1e-5, make().F, atol=1e-3)
    np.testing.assert_allclose(small.b[:2, :1] / 1e-5, make().B, atol=1e-3)
    np.testing.assert_allclose(small.q[:2, :2] / 1e-5, make().Q, atol=1e-4)


def state_after(path, rows):
    engine = prepare(load_config(path), path).engine
    engine.process(drive(rows), lambda _: None)
    return engine.state_of(engine.place_of("mine"))[0]


def test_a_filter_of_a_class_of_ones_own_is_the_compiled_one(car):
    rows = [None if k % 13 == 7 else row for k, row in enumerate(speeds(300))]
    own = "class Own(KalmanFilter):\n    pass\ndef make():\n    kf = linear()\n    kf.__class__ = Own\n    return kf"
    compiled, python = state_after(car(), rows), state_after(car(own), rows)
    np.testing.assert_allclose(compiled["x"], python["x"], rtol=1e-10)
    assert compiled["nis"] == pytest.approx(python["nis"], rel=1e-9)
    assert compiled["number"] == 0 < python["number"]


def test_after_a_long_gap_it_begins_again(car):
    rows = speeds(200)
    gone = [*rows[:100], *[None] * 30, *rows[130:]]
    s = state_after(car(missing=20), gone)
    assert (s["begun"], s["samples"]) == (1, 70)
    fresh = state_after(car(), [None] * 130 + rows[130:])
    np.testing.assert_allclose(s["x"], fresh["x"], rtol=1e-12)
    assert state_after(car(missing=40), gone)["begun"] == 0


def test_a_mode_is_a_fault(car):
    rng = np.random.default_rng(3)
    still = rng.normal(0.0, 0.1, 600)
    still[300:] += np.cumsum(np.cumsum(rng.normal(0.0, 0.1, 300)))
    path = car(IMM, u=None, modes=["slow", "fast"])
    found = failures(path, drive([(speed, 0.0, 0.0) for speed in np.clip(still, -300, 300)]))
    assert {name for name, _ in found} == {"mine.mode_fast"}
    assert 3_000_000_000 < found[0][1] < 3_300_000_000


@kernel
def alarms(s: steps.State, c: steps.Const, g: f8s, r: f8s, w: f8s, v: f8s, x: f8s, out: Any, found: f8s) -> None:
    """Step a plant that is what its filter says, shape of noise (count, ...), and count the failed results."""
    for k in range(w.shape[0]):
        for i in range(c.states):
            x[1, i] = 0.0
            for j in range(c.states):
                x[1, i] += c.f[i, j] * x[0, j] + g[i, j] * w[k, j]
        for i in range(c.states):
            x[0, i] = x[1, i]
        for a in range(c.measured):
            s.z[a] = nan if w[k, c.states + a] > c.alpha + 0.5 else 0.0
            for i in range(c.states):
                s.z[a] += c.h[a, i] * x[0, i]
            for b in range(c.measured):
                s.z[a] += r[a, b] * v[k, b]
        steps.predict(s, c)
        steps.update(s, c)
        if s.seen > 0:
            out.n = 0
            steps.judge(s, c, out)
            for j in range(out.n):
                found[out.results[j].fault] += out.results[j].result == 2


def false_alarms(steps_, per_hour, lost, chunk=100_000, **more):
    """Return the false alarms of each test, and how many were expected."""
    rng = np.random.default_rng(5)

    def make():
        kf = KalmanFilter(2, 2)
        kf.F, kf.H = np.array([[0.9, 0.1], [0.0, 0.8]]), np.array([[1.0, 0.3], [0.0, 1.0]])
        kf.Q, kf.R = np.array([[0.2, 0.05], [0.05, 0.1]]), np.array([[0.5, 0.1], [0.1, 0.3]])
        return kf

    p, kf = params(2, false_per_hour=per_hour, **more), make()
    s, c = records(make, p)
    g, r = np.linalg.cholesky(kf.Q), np.linalg.cholesky(kf.R)
    x, found = np.zeros((2, 2)), np.zeros(4)
    x[0] = rng.multivariate_normal(np.zeros(2), kf.P)
    out = np.zeros(1, results_of(steps.Evidence.dtype, None)).view(np.recarray)[0]
    for _ in range(steps_ // chunk):
        w = rng.normal(size=(chunk, 4))
        w[:, 2:] = 2.0 * (rng.random((chunk, 2)) < lost)
        alarms(s, c, g, r, w, rng.normal(size=(chunk, 2)), x, out, found)
    return found, share(p, 4) * steps_


@pytest.mark.costly
def test_as_many_false_alarms_as_were_asked_for():
    found, expected = false_alarms(400_000, 1440.0, 0.0, window=8)
    low, high = poisson.ppf([1e-3, 1 - 1e-3], expected)
    print(found, expected, low, high)
    assert ((found >= 0.97 * low) & (found <= 1.03 * high)).all()
    found, _ = false_alarms(400_000, 1440.0, 0.2, window=8)
    assert (found <= 1.03 * high).all()
    assert found[0] >= 0.97 * low, "the window's limit is exact with missing measurements, too"
