"""What the steering monitor works on: constants, state, inputs, and what it sends."""

from __future__ import annotations

from gateway.monitors import contract
from gateway_fdi.jit import Record, f8, i8, means
from gateway_plants.steering.monitor import decision, electrics, kinematics, road_wheel, symptoms


class Const(Record):
    """Constants."""

    period_ns: i8
    settled: i8
    degraded: i8
    electrics: electrics.Const
    kinematics: kinematics.Const
    symptoms: symptoms.Const
    decision: decision.Const
    road_wheel: road_wheel.Const


class State(Record):
    """State.

    ``value`` of the motor's angle [deg], ``speed`` [rad/s], ``load`` [N m].
    ``pairs`` of motor frames taken, the last at ``paired_ns``, ``passed`` periods since then; ``unpaired``: pairs whose
    voltage came later than the next current.
    ``wheel_age_ms``, ``angle_step`` [deg]: as learned; ``not_seen``: bits of what is not tested at present.
    """

    value: f8
    speed: f8
    load: f8
    quality: i8
    pairs: i8
    unpaired: i8
    found: i8
    paired_ns: i8
    passed: f8
    motor: f8
    angle_ns: i8
    parity: f8
    wheel_age_ms: f8
    angle_step: f8
    not_seen: i8
    electrics: electrics.State
    kinematics: kinematics.State
    symptoms: symptoms.State
    decision: decision.State
    road_wheel: road_wheel.State


class Inputs(contract.SampledInputs):
    """Signals of the motor's currents and voltages, of the angles, and of the vehicle's speed, as they are called.

    The motor's counters are those of the newest frames.
    """

    i_u: f8
    i_v: f8
    theta_park: f8
    valid_cur: f8
    u_sd_mean: f8
    u_sq_mean: f8
    t_wdg: f8
    delta_m: f8
    delta_g: f8
    valid_ang: f8
    delta_s: f8
    delta_s_dot: f8
    valid_sas: f8
    mc_cur: f8
    mc_vol: f8
    v_x: f8
    valid_v: f8


class Outputs(Record):
    """What it sends."""

    value: f8 = means("motor angle", "deg")
    speed: f8 = means("motor speed", "rad/s")
    quality: f8
    found: f8 = means("number of the fault found, from 1")
    load: f8 = means("load torque", "Nm")
