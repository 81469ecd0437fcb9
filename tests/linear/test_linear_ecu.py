"""The ECU of a linear plant: physics against scipy, frames against cantools, faults, errors."""

import cantools
import numpy as np
import pytest
from pydantic import ValidationError
from scipy.integrate import solve_ivp

from gateway_bench.vecu.contract import Run
from gateway_bench.vecu.scenario import load_scenario
from gateway_fdi.common.resources import shipped
from gateway_fdi.errors import InputError
from gateway_plants.linear.ecu.ecu import ECU
from gateway_plants.linear.ecu.params import LinearFault, LinearParams
from gateway_plants.linear.ecu.plant import simulate
from gateway_plants.linear.study import example
from gateway_plants.linear.study.bank import drive

RNG = np.random.default_rng


def test_faults_within_a_sample_are_integrated_exactly():
    faults = (
        LinearFault(kind="actuator_offset", place=1, from_s=0.537, to_s=1.213, size=0.2),
        LinearFault(kind="actuator_offset", place=2, from_s=0.561, size=-0.1),
    )
    y, u = simulate(drive(0.0, stable=False), faults, 2.0, RNG(0))
    a, b = np.array(example.A), np.array(example.B)

    def slope(t, x):
        added = np.array([0.2 * (0.537 <= t < 1.213), -0.1 * (t >= 0.561)])
        return a @ x + b @ (0.5 + added)

    solved = solve_ivp(slope, (0, 2), np.zeros(4), max_step=1e-3, rtol=1e-9, t_eval=np.arange(20) * 0.1)
    np.testing.assert_allclose(y, solved.y[:3].T, atol=3e-4)
    np.testing.assert_array_equal(u, 0.5)


def test_an_actuator_that_drifts_is_one_that_is_commanded_more_and_more():
    """Its fault is held over a sample: as if the command had drifted."""
    fault = LinearFault(kind="actuator_drift", place=1, from_s=1.0, size=0.2)
    y, _ = simulate(drive(0.0, stable=False), (fault,), 3.0, RNG(0))
    plant, x = example.plant(), np.zeros(4)
    for k in range(30):
        np.testing.assert_allclose(y[k], x[:3], atol=1e-12)
        x = plant.phi @ x + plant.gamma @ np.array([0.5 + 0.2 * max(0.1 * k - 1.0, 0.0), 0.5])


def test_each_sensor_fault_does_what_it_says():
    def told(**fault):
        return simulate(drive(0.0, stable=False), (LinearFault(**fault),), 3.0, RNG(0))[0]

    plain = simulate(drive(0.0, stable=False), (), 3.0, RNG(0))[0]
    off = told(kind="output_offset", place=2, from_s=1.0, to_s=2.0, size=0.3) - plain
    np.testing.assert_allclose(off[10:20, 1], 0.3)
    assert not off[:10].any()
    assert not off[20:].any()
    drift = told(kind="output_drift", place=1, from_s=1.0, size=0.5) - plain
    np.testing.assert_allclose(drift[10:, 0], 0.05 * np.arange(20))
    stuck = told(kind="output_stuck", place=3, from_s=1.0)
    np.testing.assert_array_equal(stuck[10:, 2], plain[10, 2])
    np.testing.assert_array_equal(stuck[:, :2], plain[:, :2])


def test_frames_carry_what_was_simulated():
    scenario = load_scenario(shipped("scenarios/linear_belt_faults.toml"))
    (ecu,) = scenario.ecu
    frames, truth = ECU.frames(ecu, scenario.fault, Run(2.0, 0, RNG(4)))
    y, u = simulate(ecu, (), 2.0, RNG(4))
    database = cantools.database.load_file(shipped("dbc/linear.dbc"))
    assert len(frames) == 400
    assert (np.diff(frames["t_ns"]) > 0).all()
    names = ("MotorSpeed", "LoadSpeed", "Current")
    for k in range(200):
        command, sensors = (
            database.decode_message(int(f["can_id"]), bytes(f["data"][:8])) for f in frames[2 * k : 2 * k + 2]
        )
        assert command["FrameCnt"] == sensors["FrameCnt"] == k % 16
        assert command["Voltage"] == pytest.approx(u[k, 0], abs=0.0006)
        np.testing.assert_allclose([sensors[name] for name in names], y[k], atol=0.0101)
    assert truth == []  # its faults come later


def test_a_message_of_other_signals_is_refused():
    (ecu,) = load_scenario(shipped("scenarios/linear_belt_faults.toml")).ecu
    wrong = ecu.model_copy(update={"commands": "Aircraft_Command"})
    with pytest.raises(
        InputError,
        match="this message has 2 signals besides Crc and FrameCnt .Rudder, Aileron., the plant has 1",
    ):
        ECU.frames(wrong, (), Run(1.0, 0, RNG(0)))
    with pytest.raises(InputError, match="no message 'Nothing'"):
        ECU.frames(ecu.model_copy(update={"sensors": "Nothing"}), (), Run(1.0, 0, RNG(0)))


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"noise": (0.1,)}, "noise has 1 entries, the plant needs 3"),
        ({"swing": ({"offset": 1.0},)}, "swing has 1 entries, the plant needs 2"),
        ({"feedback": ((1.0,),)}, "feedback is 2 x 4"),
        ({"b": ((1.0,),)}, "b has 1 rows, a has 4"),
    ],
)
def test_parameters_that_do_not_fit_are_refused(options, says):
    plain = {
        "type": "linear", "sensors": "Aircraft_Sensors", "commands": "Aircraft_Command", "sample_ms": 100.0,
        "a": example.A, "b": example.B, "c": example.C,
    }  # fmt: skip
    with pytest.raises(ValidationError, match=says):
        LinearParams(**{**plain, **options})


def test_a_fault_of_a_part_that_is_not_there_is_refused(tmp_path):
    text = shipped("scenarios/linear_aircraft_faults.toml").read_text()
    path = tmp_path / "wrong.toml"
    path.write_text(text.replace('kind = "actuator_offset"\nplace = 2', 'kind = "actuator_offset"\nplace = 3', 1))
    with pytest.raises(Exception, match="has no place 3 for actuator_offset"):
        load_scenario(path)
    with pytest.raises(ValidationError, match="to_s must lie after from_s"):
        LinearFault(kind="output_offset", from_s=2.0, to_s=1.0)
