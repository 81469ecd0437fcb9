"""T7: its filter beside filterpy's, what it estimates, and what a truck that differs from the model does to
the tests.
"""

import numpy as np
import pytest
from amount import amount
from filterpy.kalman import KalmanFilter
from truck_runs import TABLE, TRUCK, UNISOLATED, driven, run

from gateway_fdi.jit import COMPILED, zeros
from gateway_plants.truck.ecu.params import TruckFault
from gateway_plants.truck.monitor import MONITOR, observer
from gateway_plants.truck.monitor.generated import t7
from gateway_plants.truck.monitor.observer import BRAKE, CURVE, ENGINE, GENERATOR, MASS, MOTOR, SLOPE
from gateway_plants.truck.monitor.params import Params
from gateway_plants.truck.study import paper
from gateway_plants.truck.study.follow import follow, inputs
from gateway_plants.truck.study.table import DISTURBANCES

compiled = pytest.mark.skipif(not COMPILED, reason="hundreds of thousands of sets")
#: Engine, road and load, of both signs; the negative ones in a long run.
OURS = {
    "engine +2 %": {"engine": 1.02},
    "engine -2 %": {"engine": 0.98},
    "slope 0.3 %": {"slope": 0.003},
    "slope -0.3 %": {"slope": -0.003},
    "mass +2 %": {"mass": 1.02},
    "mass -2 %": {"mass": 0.98},
}


def records():
    s, c = zeros(1, MONITOR.state), zeros(1, MONITOR.const)
    MONITOR.prepare(Params(), s[0], c[0])
    return s[0]["observer"], c[0]["observer"], zeros(1, t7.State)[0], c[0]["t7"]


@pytest.mark.long
def test_the_filter_is_filterpys():
    """The same samples, as the state (omega_w, p) of a Kalman filter that knows its F, Q, H and R."""
    rng = np.random.default_rng(5)
    s, c, g, q = records()
    observer.restart(s, c)
    ours = observer.ERRORS
    kf = KalmanFilter(dim_x=ours + 1, dim_z=1)
    kf.x = np.zeros(ours + 1)
    kf.P = np.diag([float(c["start"]), *c["prior"]])
    kf.R[:] = c["noise"]
    kf.H = np.zeros((1, ours + 1))
    kf.H[0, 0] = q["u_f"]
    omega, does, dt, largest = 30.0, np.zeros(ours), 0.0, 0.0
    g["omega_w"] = omega
    for _ in range(400):
        g["shown_T_em"], g["shown_T_c"] = rng.normal(0, 200), rng.normal(600, 200)
        g["shown_eta_gb"], g["shown_u_gb"] = 0.97, rng.choice([1.0, 2.44])
        g["shown_J_tot"], g["shown_m_v"] = 20.0, 20_000.0
        g["d_omega_w"], brake = rng.normal(0, 0.5), abs(rng.normal(0, 1000))
        way = dt * float(g["omega_w"] * q["r_w"])
        step = np.where(np.isin(np.arange(ours), (SLOPE, CURVE)), way, dt)
        kf.F = np.diag([1.0, *(1.0 - step * c["forget"])])
        kf.F[1:3, 1:3] = np.eye(2)
        kf.F[0, 1:] = dt * does
        kf.F[SLOPE + 1, CURVE + 1] = way
        drift = np.where((np.arange(ours) >= ENGINE) | (does != 0.0), step * c["drift"], 0.0)
        kf.Q = np.diag([dt * float(c["torque"]), *drift])
        z = q["u_f"] * omega + 0.2 * rng.normal()
        if dt:
            kf.predict()
        innovation = float(z - q["u_f"] * g["omega_w"])
        nominal = float(g["d_omega_w"])
        # Theirs estimates the deviation of the speed from ours, which ours adds at once.
        kf.x[0] = 0.0
        kf.update(np.array([innovation]))
        before = float(g["omega_w"])
        observer.update(s, c, g, q, innovation, brake, dt)
        assert g["omega_w"] == pytest.approx(before + kf.x[0], rel=1e-12)
        largest = max(largest, float(s["norm"]))
        does = np.array(s["does"])
        assert g["d_omega_w"] == pytest.approx(nominal + does @ np.array(s["error"]), abs=1e-12)
        np.testing.assert_allclose(s["error"], kf.x[1:], rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(s["P"], kf.P, rtol=1e-8, atol=1e-13)
        g["omega_w"] += 0.01 * g["d_omega_w"]  # the generator's own step is the prediction
        omega += 0.01 * nominal
        dt = 0.01
    block = np.array(s["P"])[1:3, 1:3] + float(c["own"]) * np.eye(2)
    a = np.array(s["error"])[:2]
    assert observer.wald(s, c) == pytest.approx(a @ np.linalg.solve(block, a), rel=1e-9)
    assert s["norm"] == pytest.approx(observer.wald(s, c) / float(c["threshold"]))
    assert s["peak"] == largest > s["norm"]
    assert s["samples"] == 400


def test_a_sample_that_is_no_number_changes_nothing():
    s, c, g, q = records()
    before = [s.tobytes(), g.tobytes()]
    observer.update(s, c, g, q, float("nan"), 0.0, 0.01)
    assert [s.tobytes(), g.tobytes()] == before


def test_a_new_window_keeps_the_errors_and_forgets_the_speed():
    s, c, _, _ = records()
    s["error"][:], s["does"][:] = 0.1, 1.0
    s["P"][:] = np.eye(8) + 0.1
    observer.restart(s, c)
    assert list(s["error"]) == [0.1] * 7
    assert list(s["does"]) == [0.0] * 7
    assert s["P"][0, 0] == c["start"]
    assert not s["P"][0, 1:].any()
    assert not s["P"][1:, 0].any()
    np.testing.assert_array_equal(s["P"][1:, 1:], np.eye(7) + 0.1)


@pytest.mark.long
def test_sensitivities_are_the_derivatives_of_the_model():
    """What each error does, against the generated code's acceleration with that error put in."""
    s, c, _, q = records()
    u = zeros(1, MONITOR.inputs)[0]
    for name, value in {
        "u_c": 1.0, "gear": 9.0, "ice_ctrl": 20e3, "T_b_ctrl": 0.0, "I_em_sens": 150.0,
        "omega_e_sens": 140.0, "omega_gb_sens": 73.0,
    }.items():  # fmt: skip
        u[name] = value

    def accelerated(change=lambda q: None, current=150.0, slope=0.0, brake=500.0):
        other = zeros(1, MONITOR.const)
        MONITOR.prepare(Params(), zeros(1, MONITOR.state)[0], other[0])
        change(other[0]["t7"])
        state = zeros(1, t7.State)[0]
        t7.reset(state, other[0]["t7"])
        u["I_em_sens"], u["alpha"], u["T_b_ctrl"] = current, slope, brake
        t7.start(state, other[0]["t7"], u)
        t7.step(state, other[0]["t7"], u, 0.0)
        return state

    def scaled(**factors):
        def change(q):
            for name, factor in factors.items():
                q[name] *= factor

        return change

    small = 1e-4
    for current, place in ((150.0, MOTOR), (-150.0, GENERATOR)):
        base = accelerated(current=current)
        observer._sensitivities(s, base, q, 500.0, float(c["least"]))
        # The torque of the current alone: k_i makes the back EMF too, but T7 takes the current as measured.
        changed = accelerated(scaled(k_i=1 + small), current=current)
        found = (changed["d_omega_w"] - base["d_omega_w"]) / small
        assert s["does"][place] == pytest.approx(found, rel=1e-6)
        assert s["does"][MOTOR + GENERATOR - place] == 0.0
        uphill = accelerated(slope=small, current=current)
        found = (uphill["d_omega_w"] - base["d_omega_w"]) / small
        assert s["does"][SLOPE] == pytest.approx(found, rel=1e-3)
        heavy = accelerated(scaled(m_v0=1 + small), current=current)
        found = (heavy["d_omega_w"] - base["d_omega_w"]) / small
        assert s["does"][MASS] == pytest.approx(found, rel=1e-3)
        idle = accelerated(current=0.1 * current)
        observer._sensitivities(s, idle, q, 500.0, float(c["least"]))
        assert list(s["does"][:2]) == [0.0, 0.0]  # less than 20 A
        observer._sensitivities(s, base, q, 500.0, float(c["least"]))
        braked = accelerated(brake=500.0 * (1 + small), current=current)
        found = (braked["d_omega_w"] - base["d_omega_w"]) / small
        assert s["does"][BRAKE] == pytest.approx(found, rel=1e-6)


@pytest.mark.costly
def test_what_nothing_is_known_of_goes_back_to_its_prior_but_the_machine_stays():
    """At rest a road does not change, however long; on the way it is forgotten, and the covariance stays one."""
    s, c, _, _ = records()
    s["P"][:] = 1e-12 * np.eye(8)
    s["error"][:] = [-0.5, 1.0, 0.04, 0.02, 0.03, 0.05, 1e-5]
    s["does"][:] = 1.0  # of the window before
    for _ in range(60):
        observer.age(s, c, 1000.0, 0.0)
    spread = np.diag(s["P"])[1:]
    assert list(spread[[MOTOR, GENERATOR, SLOPE, CURVE]]) == [1e-12] * 4
    assert list(s["error"][[MOTOR, GENERATOR, SLOPE, CURVE]]) == [-0.5, 1.0, 0.02, 1e-5]
    assert 0.05 < spread[ENGINE] / c["prior"][ENGINE] < 1.0
    for _ in range(2000):
        observer.age(s, c, 1.0, 10.0)
        assert np.linalg.eigvalsh(s["P"]).min() > -1e-15
    spread = np.diag(s["P"])[1:]
    np.testing.assert_allclose(spread[[SLOPE, CURVE]], c["prior"][[SLOPE, CURVE]], rtol=0.15)
    assert abs(s["error"][SLOPE]) < 0.01
    for _ in range(1500):
        observer.age(s, c, 1e3, 0.0)
    np.testing.assert_allclose(np.diag(s["P"])[3:], c["prior"][2:], rtol=0.1)
    assert list(s["error"][:2]) == [-0.5, 1.0]


@compiled
def test_it_finds_road_load_and_engine_and_the_machines_fault():
    """Truth is a slope of 0.3 %, 2 % more mass and torque, and an efficiency that halves at 400 s.

    Forces and mass may all be wrong by the same factor: only drag and what turns tell, hence 0.04.
    """
    truck = TRUCK.model_copy(update={"slope": 0.003, "mass": 1.02, "engine": 1.02})
    fault = TruckFault(kind="machine_efficiency", from_s=400.0)
    trace = follow(inputs(truck, fault, 7000), Params(), keep=True).trace
    before, after = trace.error[39_000], trace.error[-1]
    slope = trace.error[10_000:39_000, SLOPE][trace.valid[10_000:39_000]]
    assert slope.mean() == pytest.approx(0.003, abs=5e-4)
    assert slope.std() < 0.003
    assert before[ENGINE] - before[MASS] == pytest.approx(0.0, abs=0.015)
    for place in (ENGINE, MASS):
        assert before[place] == pytest.approx(0.02, abs=0.04)
    np.testing.assert_allclose(before[:2], 0.0, atol=0.08)
    assert after[MOTOR] == pytest.approx(-0.5, abs=0.08)
    assert after[GENERATOR] == pytest.approx(1.0, abs=0.12)


@pytest.mark.long
@compiled
@pytest.mark.parametrize("name", list(OURS)[:: amount(1, 3)])
def test_a_truck_that_differs_is_diagnosed_with_the_same_thresholds(name):
    """No false alarm, all five faults isolated, through frames, database and engine; nothing is learned anew."""
    truck = TRUCK.model_copy(update=OURS[name])
    for seed in range(8000, 8000 + amount(20, 1)):
        assert run(driven(truck=truck), seed, truck=truck)[2] == [], seed
        for fault, dtc, _, _ in TABLE:
            events = run(driven(fault, 400.0, truck=truck), seed, truck=truck)[2]
            codes = {code for _, code, now in events if now}
            assert dtc in codes, (seed, fault)
            assert codes <= {dtc, UNISOLATED}, (seed, fault, events)
            assert min(t for t, _, now in events if now) >= 400.0


@compiled
@pytest.mark.parametrize("name", ["engine +5 %", "brakes +10 %", "slope 1 %", "wind 5 m/s", "hills of 3 %"])
def test_beyond_what_was_asked_it_is_silent_too(name):
    truck = TRUCK.model_copy(update=DISTURBANCES[name])
    peak, _, events = run(driven(truck=truck), 8100, truck=truck)
    assert events == []
    assert max(peak[test] for test in ("T1", "T2", "T5", "T6", "T7")) < 0.9


@pytest.mark.long
@compiled
def test_the_papers_systems_do_not_stand_it():
    """What is told as a limit: with thresholds of the undisturbed truck ICDS alarms at 2 % torque, MCDS at 0.3
    % slope.
    """
    for name, systems in (("engine +2 %", ["ICDS"]), ("slope 0.3 %", ["ICDS", "MCDS"])):
        truck = TRUCK.model_copy(update=OURS[name])
        for system in systems:
            first = paper.follow(inputs(truck, None, 8200), paper.Paper()).first[system]
            assert first.min() < np.inf, (name, system)
