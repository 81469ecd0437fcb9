"""Monitors of linear plants by configuration: banks of PI observers and plain observers."""

import tomllib

import numpy as np
import pytest

from gateway.config.load import load_config
from gateway.config.monitor_types import monitor_of
from gateway.monitors.contract import FAILED
from gateway.runtime.app import Gateway
from gateway_bench.vecu.contract import Run
from gateway_bench.vecu.scenario import load_scenario
from gateway_fdi import run_length
from gateway_fdi.common.resources import shipped
from gateway_fdi.errors import InputError, InputErrors
from gateway_fdi.jit import COMPILED, zeros
from gateway_plants.linear.ecu.ecu import ECU
from gateway_plants.linear.ecu.params import LinearFault
from gateway_plants.linear.ecu.plant import simulate
from gateway_plants.linear.mathematics.gains import from_noise
from gateway_plants.linear.monitor import observer as linear_observer
from gateway_plants.linear.monitor import plant as linear_plant
from gateway_plants.linear.monitor.pi_bank import MONITOR as BANK
from gateway_plants.linear.monitor.pi_bank.params import Params
from gateway_plants.linear.study import example
from gateway_plants.linear.study.bank import FEEDBACK, drive, noise
from gateway_replay.replay import replay

compiled = pytest.mark.skipif(not COMPILED, reason="thousands of steps of a whole bank")


def entry(config, name=None):
    document = tomllib.loads(shipped(f"configs/linear_{config}.toml").read_text())
    (found,) = [m for m in document["monitor"] if name in (None, m["name"])]
    return {k: v for k, v in found.items() if k not in ("name", "type")}


def written(tmp_path, config, *changes):
    text = shipped(f"configs/linear_{config}.toml").read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    path = tmp_path / f"{config}.toml"
    path.write_text(text)
    return path


def refused(path):
    with pytest.raises((InputError, InputErrors)) as caught:
        Gateway(load_config(path), None, file=path)
    return str(caught.value)


def test_the_study_s_plant_is_the_shipped_configuration_s():
    p = Params(**entry("aircraft"))
    np.testing.assert_array_equal(p.plant.phi, example.plant().phi)
    np.testing.assert_array_equal(p.plant.gamma, example.plant().gamma)
    for ours, theirs in zip(
        (p.noise.outputs, p.noise.states, p.noise.faults),
        (noise().outputs, noise().states, noise().faults),
        strict=True,
    ):
        np.testing.assert_allclose(ours, theirs)
    assert (p.actuator_limits == example.ACTUATOR_LIMIT).all()
    assert (p.sensor_limits == example.SENSOR_LIMIT).all()
    for name in ("healthy", "faults", "both"):
        (ecu,) = load_scenario(shipped(f"scenarios/linear_aircraft_{name}.toml")).ecu
        assert (ecu.a, ecu.b, ecu.c, ecu.feedback) == (example.A, example.B, example.C, FEEDBACK)


def test_faults_are_named_by_the_user_s_parts():
    faults = BANK.faults(Params(**entry("belt", "belt")))
    assert [fault.name for fault in faults] == [
        "unexplained", "actuator_voltage", "sensor_motor_speed", "sensor_load_speed", "sensor_current",
    ]  # fmt: skip
    assert [fault.dtc for fault in faults] == [
        "C1B10-62",
        "P1A30-64",
        "P1A31-64",
        "P1A32-64",
        "P1A33-64",
    ]
    assert BANK.faults(Params(**entry("aircraft")))[2].dtc == "C1B12-64"


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ('unit = "rad"', 'unit = "deg"', 'its unit is "rad" in the database, the plant wants "deg"'),
        ("[0.0, 1.0],", "[0.0, 0.0],", "Theorem 1 does not hold for i = 1 (roll)"),
        ("[-7.8013, -1.1160],", "[-7.8013],", "b: its rows are not of one length"),
        ("sample_ms = 100.0", "sample_ms = 0.0", "sample_ms"),
        ('states = ["roll", "roll rate", "yaw rate", "sideslip"]', 'states = ["x"]',
         "states has 1 entries, the plant 4 states"),
        ('name = "rudder"', 'name = "aileron"', "two inputs or outputs share a name"),
        ("Aircraft_Command.Rudder", "Aircraft_Command.Ruder", "no signal 'Ruder'"),
        ("sample_ms = 100.0", "sample_ms = 100.0\npoles = [-1.0, -2.0]", "gains are Kalman's"),
        ("sample_ms = 100.0", "sample_ms = 100.0\nstate_noise = -1.0", "not negative"),
        ("sample_ms = 100.0", "sample_ms = 100.0\nwrong = 1", "wrong"),
    ],
)  # fmt: skip
def test_what_does_not_fit_is_refused_with_its_key(tmp_path, old, new, says):
    said = refused(written(tmp_path, "aircraft", (old, new)))
    assert says in said
    assert "monitor" in said


def test_a_plant_that_is_not_observable_is_said_to_be_so(tmp_path):
    # The load turns no wheel that anybody sees: neither belt nor load reach motor and current.
    bare = entry("belt", "model")
    bare["states"] = ["current", "motor speed", "load speed", "twist"]
    bare["a"] = [
        [-500.0, -25.0, 0, 0],
        [500.0, -1.0, 0, 0],
        [0, 0, -22.0, 4000.0],
        [0, 1.0, -1.0, 0],
    ]
    bare["c"] = [[0, 1.0, 0, 0], [0, 0, 0, 0], [1.0, 0, 0, 0]]
    with pytest.raises(ValueError, match="the sensors do not show .*load speed.*twist|twist.*load speed"):
        linear_observer.Params(**bare)


def test_check_tells_what_hides_what():
    warnings = BANK.warnings(Params(**entry("aircraft")))
    assert any("actuator rudder off by 0.05 is hidden in the observer without roll_rate" in w
               and "sensor roll of 0.561 to 0.842" in w for w in warnings)  # fmt: skip


def inputs(y, u, **options):
    rows = zeros(len(y), linear_plant.Inputs)
    rows["y"][:, : y.shape[1]], rows["u"][:, : u.shape[1]] = y, u
    rows["t_ns"] = np.arange(len(y)) * 100_000_000
    rows["which"], rows["gap"] = linear_plant.OUTPUTS, 1
    for name, value in options.items():
        rows[name] = value
    return rows


def walked(rows, monitor=BANK, config="aircraft", **options):
    """Step a monitor through inputs; returns its state and, for each fault, the rows in which it failed."""
    p = monitor.params(**{**entry(config), **options})
    s, c, out = zeros(1, monitor.state), zeros(1, monitor.const), zeros(1, monitor.results)
    monitor.prepare(p, s[0], c[0])
    names = [fault.name for fault in monitor.faults(p)]
    failed = {name: [] for name in names}
    rows["gap"][1:] = np.round(np.diff(rows["t_ns"]) / 1e8)  # as the engine tells it
    for k in range(len(rows)):
        out[0]["n"] = 0
        monitor.step(s[0], c[0], rows[k], out[0])
        for r in out[0]["results"][: out[0]["n"]]:
            if r["result"] == FAILED:
                failed[names[r["fault"]]].append(k)
    return s[0], failed


def flight(faults=(), seconds=40.0, seed=2):
    return simulate(drive(0.01, stable=True), faults, seconds, np.random.default_rng(seed))


ACTUATOR = LinearFault(kind="actuator_offset", place=1, from_s=15.0, to_s=30.0, size=0.08)


@compiled
def test_lost_samples_are_predicted_and_many_of_them_begin_anew():
    rows = inputs(*flight((ACTUATOR,)))
    keep = np.ones(len(rows), bool)
    keep[100:140:3] = False  # counted
    s, failed = walked(rows[keep])
    assert s["missing"] == 14
    assert s["restarts"] == 0
    assert failed["actuator_rudder"]
    assert not any(failed[name] for name in failed if name != "actuator_rudder")
    keep[60:80] = False  # more than the counter can tell
    s, failed = walked(rows[keep])
    assert s["restarts"] == 1
    assert not any(failed[name] for name in failed if name != "actuator_rudder")


@compiled
def test_without_a_counter_time_tells_what_is_lost():
    rows = inputs(*flight())
    rows["t_ns"] += np.random.default_rng(1).integers(-20_000_000, 20_000_000, len(rows))
    keep = np.ones(len(rows), bool)
    keep[100:110:2] = False
    s, failed = walked(rows[keep], counter=None)
    assert s["missing"] == 5
    assert not any(failed.values())


def test_a_plant_that_is_too_large_is_refused():
    large = {"a": (-np.eye(9)).tolist(), "b": np.ones((9, 2)).tolist(), "c": np.eye(9)[:3].tolist()}
    with pytest.raises(ValueError, match="9 states; at most 8"):
        Params(**entry("aircraft") | large)


def test_there_is_no_choice_of_a_logic(tmp_path):
    path = written(tmp_path, "aircraft", ('type = "pi_bank"', 'type = "pi_bank"\nlogic = "jumps"'))
    assert "logic = 'jumps': one logic decides, with model_error or without; leave the key out" in refused(path)


@compiled
def test_evidence_has_the_size():
    p = Params(**entry("aircraft"))
    s, c, out = zeros(1, BANK.state), zeros(1, BANK.const), zeros(1, BANK.results)
    BANK.prepare(p, s[0], c[0])
    sizes = []
    for row in inputs(*flight((ACTUATOR,))):
        out[0]["n"] = 0
        BANK.step(s[0], c[0], row, out[0])
        sizes += [r["evidence"][0] for r in out[0]["results"][: out[0]["n"]] if r["result"] == FAILED]
    assert np.median(sizes) == pytest.approx(0.08, abs=0.01)


@compiled
def test_frames_lost_on_the_bus_cause_no_false_fault():
    (ecu,) = load_scenario(shipped("scenarios/linear_aircraft_healthy.toml")).ecu
    frames, _ = ECU.frames(ecu, (), Run(100.0, 0, np.random.default_rng(5)))
    rng = np.random.default_rng(6)
    print("seed 6")
    gateway = Gateway(load_config(shipped("configs/linear_aircraft.toml")))
    events = []
    gateway.listen(events.append)
    replay(gateway, [frames[rng.random(len(frames)) > 0.05]])
    gateway.close()
    assert not [e for e in events if e["event"] == "dtc" and e["fault"].startswith("aircraft.")]


@compiled
@pytest.mark.parametrize("ms", [40, 60, 80])
def test_a_sender_that_stands_still_causes_no_fault(ms):
    """Commands and readings come later for good: their times no longer say which command held (seen on a busy bus)."""
    scenario = load_scenario(shipped("scenarios/linear_belt_faults.toml"))
    (ecu,) = scenario.ecu
    for seed in range(3):
        frames, _ = ECU.frames(ecu, (), Run(7.9, 0, np.random.default_rng(seed)))
        frames["t_ns"][np.random.default_rng(seed).integers(300, 1000) :] += ms * 1_000_000
        gateway = Gateway(load_config(scenario.config))
        events = []
        gateway.listen(events.append)
        replay(gateway, [frames])
        gateway.close()
        assert not [event["dtc"] for event in events if event["event"] == "dtc" and event["status"] & 1], seed


@pytest.mark.long
@compiled
@pytest.mark.parametrize("rule", [pytest.param("direct", marks=pytest.mark.full("6 s")), "cusum"])
def test_one_observer_detects_at_the_rate_it_promises(rule):
    """100 000 healthy samples and three sensors, a false alarm in 1000 s asked for: 30 expected."""
    monitor = linear_observer.MONITOR
    options = {"rule": rule, "mtfa_s": 1000.0, "start_s": 20.0}
    y, u = flight(seconds=10_000.0, seed=9)
    p = monitor.params(**{**entry("aircraft"), **options})
    s, c, out = zeros(1, monitor.state), zeros(1, monitor.const), zeros(1, monitor.results)
    monitor.prepare(p, s[0], c[0])
    alarms, before = 0, np.zeros(4, bool)
    for row in inputs(y, u):
        out[0]["n"] = 0
        monitor.step(s[0], c[0], row, out[0])
        now = np.zeros(4, bool)
        for r in out[0]["results"][: out[0]["n"]]:
            now[r["fault"]] = r["result"] == FAILED
        alarms += int((now & ~before)[1:].sum())
        before = now
    print(rule, alarms)
    assert 2 <= alarms <= 30
    _, failed = walked(inputs(*flight((ACTUATOR,))), monitor, start_s=10.0, rule=rule)
    assert failed["innovation_roll_rate"]
    assert failed["innovation_roll_rate"][0] >= 150


def test_levels_of_rules():
    assert run_length.direct(1e6) == pytest.approx(4.891638, abs=1e-5)
    # Montgomery's table: k = 0.5, h = 4: 168 samples between two-sided alarms; h = 5: 465.
    assert run_length.cusum(168, 0.5) == pytest.approx(4.0, abs=0.05)
    assert run_length.cusum(465, 0.5) == pytest.approx(5.0, abs=0.05)


def test_an_own_level_is_taken():
    assert linear_observer.Params(**entry("belt", "model"), level=7.0).threshold == 7.0


def test_one_observer_of_an_exact_plant_is_the_stationary_filter():
    """Its innovations, their variances and its gain, once nothing is left of the start."""
    monitor = linear_observer.MONITOR
    p = monitor.params(**entry("aircraft"))
    s, c, out = zeros(1, monitor.state)[0], zeros(1, monitor.const)[0], zeros(1, monitor.results)[0]
    monitor.prepare(p, s, c)
    plant, noises = p.plant, p.noise
    q, r = np.diag(noises.states**2 * plant.period), np.diag(noises.outputs**2)
    told = from_noise(plant.phi, plant.c, q, r)
    y, u = flight(seconds=400.0, seed=3)
    x = np.zeros(4)
    for k, row in enumerate(inputs(y, u)):
        out["n"] = 0
        monitor.step(s, c, row, out)
        e = y[k] - plant.c @ x
        x = plant.phi @ x + plant.gamma @ u[k] + told.gain @ e
    np.testing.assert_allclose(s.models.filters.e[0][:3], e, atol=1e-3 * noises.outputs.max())
    np.testing.assert_allclose(s.models.filters.own[:3], np.diag(told.innovation), rtol=1e-3)


def test_the_configuration_names_the_type():
    config = load_config(shipped("configs/linear_belt.toml"))
    kinds = [monitor_of(m)[0].type for m in config.monitor]
    assert kinds == ["pi_bank", "linear_observer"]
