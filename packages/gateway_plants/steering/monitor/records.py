"""What the steering monitor works on: constants, state, inputs, and what it sends."""

from __future__ import annotations

from gateway.monitors import contract
from gateway_fdi.jit import Record, f8, i8, means
from gateway_plants.steering.monitor import decision, electrics, kinematics, road_wheel, symptoms


class Const(Record):
    """Constants."""

    period_ns: i8 = means("period of the motor's messages", "ns")
    degraded: i8 = means("1: the period is too long for the currents' time constant")
    electrics: electrics.Const = means("the motor's side")
    kinematics: kinematics.Const = means("the gear's side")
    symptoms: symptoms.Const = means("what residuals say over time")
    decision: decision.Const = means("which component is at fault")
    road_wheel: road_wheel.Const = means("plausibility of the road wheel angle")


class State(Record):
    """State."""

    value: f8 = means("motor angle to send", "deg")
    speed: f8 = means("motor speed", "rad/s")
    load: f8 = means("load torque", "N m")
    quality: i8 = means("quality of the motor angle: STARTING to INVALID")
    pairs: i8 = means("pairs of motor frames taken")
    unpaired: i8 = means("motor frames without their pair")
    found: i8 = means("number of the fault found; NONE: none")
    passed: f8 = means("periods since the last pair")
    motor: f8 = means("last motor angle", "deg")
    angle_ns: i8 = means("when it came", "ns")
    parity: f8 = means("last parity", "deg")
    wheel_age_ms: f8 = means("age of the steering wheel's angle, as learned", "ms")
    angle_step: f8 = means("resolution of the motor's angle sensor, as learned", "deg")
    not_seen: i8 = means("bits of what is not tested at present, NO_PAIRS to STUCK_AT_REST")
    electrics: electrics.State = means("the motor's side")
    kinematics: kinematics.State = means("the gear's side")
    symptoms: symptoms.State = means("what residuals say over time")
    decision: decision.State = means("which component is at fault")
    road_wheel: road_wheel.State = means("plausibility of the road wheel angle")


class Inputs(contract.SampledInputs):
    """Signals of the motor's currents and voltages, of the angles, and of the vehicle's speed, as they are called.

    The motor's counters are those of the newest frames.
    """

    i_u: f8 = means("phase current", "A")
    i_v: f8 = means("phase current", "A")
    theta_park: f8 = means("electrical angle used for Park", "deg")
    valid_cur: f8 = means("above 0: the currents are valid")
    u_sd_mean: f8 = means("mean voltage in the controller's frame, d", "V")
    u_sq_mean: f8 = means("mean voltage in the controller's frame, q", "V")
    t_wdg: f8 = means("temperature of the winding", "degC")
    delta_m: f8 = means("motor angle", "deg")
    delta_g: f8 = means("pinion angle", "deg")
    valid_ang: f8 = means("above 0: motor and pinion angle are valid")
    delta_s: f8 = means("steering wheel's angle", "deg")
    delta_s_dot: f8 = means("steering wheel's rate", "deg/s")
    valid_sas: f8 = means("above 0: the steering wheel's signals are valid")
    mc_cur: f8 = means("alive counter of the currents")
    mc_vol: f8 = means("alive counter of the voltages")
    v_x: f8 = means("speed of the vehicle", "km/h")
    valid_v: f8 = means("above 0: that speed is valid")


class Outputs(Record):
    """What it sends."""

    value: f8 = means("motor angle", "deg")
    speed: f8 = means("motor speed", "rad/s")
    quality: f8 = means("quality of the motor angle: STARTING to INVALID")
    found: f8 = means("number of the fault found, from 1")
    load: f8 = means("load torque", "Nm")
