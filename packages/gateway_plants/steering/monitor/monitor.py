"""Active front steering: angle sensors, current sensors and inverter of its motor.

Source: Reinelt, Lundquist, Johansson, "On-Line Sensor Monitoring in an Active Front Steering System using Extended
Kalman Filtering" (SAE 2005). Its four estimators run as it has them, with their misprints corrected
(:mod:`gateway_fdi.filters`), but three of them need the sensor that they monitor. What decides is independent of it:
an extended Kalman filter in stator co-ordinates, anchored at standstill, the EMF's angle, and the gear's equation (1).

Three samplings: currents and voltages of one counter are a pair, in whatever order they come; the angles of motor and
pinion; the steering wheel's. Without the one the others are tested all the same.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import inf, isfinite, isnan, pi

from gateway.monitors.contract import (
    TIMER,
    Blame,
    Blames,
    Calibration,
    Connection,
    Emission,
    Fault,
    Monitor,
    Out,
    Readout,
    Sampled,
    Signal,
    Warnings,
    report,
)
from gateway.monitors.sampling import MOST_DEPTH, Sampling
from gateway_fdi.jit import kernel
from gateway_plants.steering.monitor import (
    decision,
    electrics,
    kinematics,
    road_wheel,
    symptoms,
)
from gateway_plants.steering.monitor.decision import NONE
from gateway_plants.steering.monitor.faults import (
    ANGLES,
    BLAMES,
    FAULTS,
    IMPLAUSIBLE,
    PAIRING,
    PINION,
    RATIO,
    WHEEL,
    Evidence,
)
from gateway_plants.steering.monitor.params import Params, Thresholds
from gateway_plants.steering.monitor.records import Const, Inputs, Outputs, State
from gateway_plants.steering.monitor.underlying_tests import BEHIND

#: Quality of the motor's angle that is sent.
STARTING, MEASURED, REPLACED, DEGRADED, INVALID = range(5)
#: Without a pair of motor frames for so many periods the angle is invalid.
SILENCE = 50
#: Behind a silence of so many periods all begins anew.
OLDEST = 1000
#: What is not tested at present, and why. No pair of motor frames yet, or not enough: nothing. No frames of the gear,
#: or their times are not sure: the three angles. How old the steering wheel's angle is, is not known, for it has not
#: turned: what it makes of a turning wheel is allowed for. The motor stands: the EMF cannot say which angle is wrong.
#: The angle sensor is not lively at rest: one that is stuck shows when it is to move.
NO_PAIRS, NO_GEAR, AGE_UNKNOWN, NO_EMF, STUCK_AT_REST = 1, 2, 4, 8, 16
#: Steps of the motor's angle sensor that matter beside the other two [deg].
COARSE_STEP = 0.1
#: From this period on the current's time constant is missed [ms].
COARSE = 5.0

#: Counters are modulo this.
ROUND = 16
#: Samplings by their place.
PAIR, ANGLE, STEERED = range(3)
#: Inputs by message: field and signal.
_MESSAGES = {
    "AFS_MotCur": ("I_U", "I_V", "Theta_park", "Valid_cur"),
    "AFS_MotVol": ("U_sd_mean", "U_sq_mean", "T_wdg"),
    "AFS_Angle": ("Delta_M", "Delta_G", "Valid_ang"),
    "SAS_Angle": ("Delta_S", "Delta_S_dot", "Valid_sas"),
    "ESC_Speed": ("v_X", "Valid_v"),
}
#: Frame counters by message, and those that are inputs, too.
_COUNTERS = {"AFS_MotCur": "MC_cur", "AFS_MotVol": "MC_vol", "AFS_Angle": "MC_ang", "SAS_Angle": "MC_sas"}
_NEWEST = ("AFS_MotCur", "AFS_MotVol")
#: Units of the signals that have one: a database that says another is refused.


def _connect(p: Params) -> Mapping[str, Connection]:
    def signal(message: str, name: str, triggers: bool) -> Connection:
        unit = Inputs.meanings[name.lower()].unit or None
        return Signal(f"{message}.{name}", unit=unit, triggers=triggers, optional=True, may_be_nan=True)

    found: dict[str, Connection] = {
        name.lower(): None
        if message == "ESC_Speed" and p.ratio is None
        else signal(message, name, message in _COUNTERS)
        for message, names in _MESSAGES.items()
        for name in names
    }
    return found | {_COUNTERS[message].lower(): signal(message, _COUNTERS[message], False) for message in _NEWEST}


def samplings(p: Params) -> tuple[Sampling, ...]:
    """Return how frames become samples, in the order of their places."""

    def of(period_ms: float, *messages: str) -> Sampling:
        fields = tuple(name.lower() for message in messages for name in _MESSAGES[message])
        counters = tuple(f"{message}.{_COUNTERS[message]}" for message in messages)
        return Sampling("counter", period_ms, inf, OLDEST * period_ms, counters, depth=MOST_DEPTH, inputs=fields)

    return (
        of(p.period_ms, "AFS_MotCur", "AFS_MotVol"),
        of(p.angle_period, "AFS_Angle"),
        of(p.wheel_period_ms, "SAS_Angle"),
    )


def _faults(_: Params) -> tuple[Fault, ...]:
    return FAULTS


def _blames(p: Params) -> Mapping[str, Sequence[Blame]]:
    speed = {} if p.ratio is not None else {"ratio": BLAMES["ratio"][:-1]}  # without a ratio no speed is connected
    return BLAMES | speed


def _emits(_: Params) -> Emission:
    signals = {
        "value": "MotorAngle", "speed": "MotorSpeed", "quality": "Quality", "found": "Found", "load": "Load",
    }  # fmt: skip
    return Emission("GW_Steering", signals)


def _prepare(p: Params, s: State, c: Const) -> None:
    c.period_ns = round(p.period_ms * 1e6)
    c.degraded = p.period_ms >= COARSE
    electrics.prepare(s.electrics, c.electrics, p)
    kinematics.prepare(c.kinematics, p)
    symptoms.prepare(c.symptoms, p)
    decision.prepare(s.decision, c.decision, p)
    road_wheel.prepare(c.road_wheel, p.ratio)
    s.found = NONE
    s.wheel_age_ms = p.wheel_delay_ms
    s.not_seen = NO_PAIRS | NO_GEAR | AGE_UNKNOWN | STUCK_AT_REST


@kernel
def _report(s: State, fault: int, failed: bool, value: float, limit: float, out: Out[Evidence, Outputs]) -> None:
    """Report a test with the symptoms as evidence."""
    e = report(out, fault, failed, value, limit)
    if not failed:
        return
    m = s.electrics
    e.increment, e.angle, e.parity, e.balance = m.increment, m.angle, s.parity, m.balance
    e.wheel, e.nis, e.speed, e.repeated = s.kinematics.wheel, m.nis, m.filter.x[2], m.repeated
    if isnan(e.angle):
        e.angle = 0.0


@kernel
def _unseen(s: State, c: Const) -> int:
    """Return what cannot be seen at present, and why: bits NO_PAIRS to STUCK_AT_REST."""
    m, k = s.electrics, s.kinematics
    s.wheel_age_ms = (c.kinematics.delay_ns + k.extra_ns) * 1e-6
    s.angle_step = m.step * 180.0 / (pi * c.electrics.pole_pairs)
    missing = NO_PAIRS if m.frames < c.electrics.settled else 0
    if s.symptoms.geared == 0:
        missing |= NO_GEAR
    elif k.aged == 0:
        missing |= AGE_UNKNOWN
    if isnan(m.angle):
        missing |= NO_EMF
    if not electrics.lively(m):
        missing |= STUCK_AT_REST
    return missing


@kernel
def _conclude(s: State, c: Const, out: Out[Evidence, Outputs]) -> None:
    """Report all tests that this pair of frames has carried out."""
    d, y = s.decision, s.symptoms
    s.not_seen = _unseen(s, c)
    s.found = d.found
    if d.found != NONE:
        k = decision.alarm_of(d.found)
        level = abs(y.jump.largest) if k == symptoms.JUMP else y.rules[k].level
        _report(s, d.found, True, level, c.symptoms.rules[k].threshold, out)
        for fault in (ANGLES, IMPLAUSIBLE):
            if d.found != fault:  # what was not known then is known now
                _report(s, fault, False, 0.0, 0.0, out)
    elif y.jump.left == 0 and decision.quiet(d):
        for fault in range(PAIRING):
            if y.geared == 1 or not decision.needs_gear(fault):
                _report(s, fault, False, 0.0, 0.0, out)


@kernel
def _pair(s: State, c: Const, u: Inputs, out: Out[Evidence, Outputs]) -> bool:
    """Take a pair of motor frames; tells whether it has values."""
    ahead = (u.mc_cur - u.mc_vol) % ROUND
    if ahead == 0.0:
        _report(s, PAIRING, False, 0.0, 1.0, out)
    elif ahead < ROUND - 1.0:  # a voltage that is ahead by one waits for its current
        s.unpaired += 1
        _report(s, PAIRING, True, ahead, 0.0, out)
    s.passed += u.gap
    if not (u.valid_cur > 0.0 and isfinite(u.i_u + u.i_v + u.theta_park + u.u_sd_mean + u.u_sq_mean)):
        return False
    m, k, y, d = s.electrics, s.kinematics, s.symptoms, s.decision
    periods = s.passed
    s.passed = 0.0
    s.pairs += 1
    trusted = not decision.motor_angle_fault(d.found)
    theta = u.theta_park * pi / 180.0
    electrics.step(m, c.electrics, u.i_u, u.i_v, theta, u.u_sd_mean, u.u_sq_mean, u.t_wdg, periods, trusted)
    if m.frames < c.electrics.settled or periods > 1.0:
        y.onset.torn = 1
    else:
        symptoms.update_motor(y, c.symptoms, m)
        y.geared = 1 if kinematics.tested(k, c.kinematics, u.t_ns) else 0
        known = decision.angle_fault(d.found)
        on = symptoms.present(y, c.symptoms, m, c.electrics, k, u.i_u, u.i_v, known)
        decision.decide(d, c.decision, y, on)
    _conclude(s, c, out)
    return True


@kernel
def _angle_frame(s: State, c: Const, u: Inputs) -> None:
    """Take a frame with motor and pinion angle."""
    k = s.kinematics
    anew = kinematics.date(k.angle_date, u.t_ns, u.waited[0], u.gap, c.kinematics.angle_ns)
    if not (u.valid_ang > 0.0 and isfinite(u.delta_m + u.delta_g)):
        return
    s.motor, s.angle_ns = u.delta_m, u.t_ns
    if anew:
        k.kept = 0
    kinematics.keep(k, k.angle_date.at_ns, u.delta_m, u.delta_g)


@kernel
def _wheel_frame(s: State, c: Const, u: Inputs, out: Out[Evidence, Outputs]) -> None:
    """Take a frame of the steering wheel: parity and rate."""
    k, y = s.kinematics, s.symptoms
    anew = kinematics.date(k.wheel_date, u.t_ns, u.waited[0], u.gap, c.kinematics.wheel_ns)
    at_ns = k.wheel_date.at_ns
    if anew:
        kinematics.begin(k)
    if not (u.valid_sas > 0.0 and isfinite(u.delta_s + u.delta_s_dot)):
        return
    kinematics.follow(k, c.kinematics, at_ns, u.delta_s, u.delta_s_dot)
    sure = kinematics.sure(k.wheel_date, c.kinematics.wheel_ns) and kinematics.sure(k.angle_date, c.kinematics.angle_ns)
    # What is finer than this is noise beside the other two.
    step = s.electrics.step * 180.0 / (pi * c.electrics.pole_pairs)
    coarse = step if step > COARSE_STEP else 0.0
    if sure and kinematics.fit(k, c.kinematics, at_ns - c.kinematics.delay_ns, u.delta_s, coarse):
        s.parity = k.parity
        k.fitted_ns = u.t_ns
        symptoms.update_gear(y, c.symptoms, k, s.motor)
        if y.alarm[symptoms.PARITY] == 0:
            k.watched = 1
        if k.sure == 0.0 and y.alarm[symptoms.RATE] == 0:
            k.own = 0.0
    # Where the pinion's angle is of long ago, nobody knows where the road wheels are.
    known = s.motor == s.motor and u.t_ns - s.angle_ns <= c.kinematics.stale_ns
    if c.road_wheel.points > 0 and u.valid_v > 0.0 and known:
        tested = road_wheel.check(s.road_wheel, c.road_wheel, u.delta_g, u.delta_s, u.v_x)
        if tested:
            off, limit = abs(s.road_wheel.off), c.road_wheel.tolerance
            _report(s, RATIO, off > limit, off, limit, out)


@kernel
def _value(s: State, c: Const, u: Inputs) -> None:
    """Find the motor angle to send: measured, or out of the gear when the sensor is at fault."""
    m, d = s.electrics, s.decision
    s.speed, s.load = m.filter.x[2], m.filter.x[4]
    s.value = u.delta_m
    s.quality = DEGRADED if c.degraded == 1 else MEASURED
    if isnan(u.delta_m):
        s.quality = STARTING
    elif decision.motor_angle_fault(d.found):
        s.quality = INVALID
        if s.kinematics.started == 1:
            wheel = kinematics.now(s.kinematics, c.kinematics, u.t_ns)
            s.value = c.kinematics.motor_ratio * (u.delta_g - wheel / c.kinematics.wheel_ratio)
            s.quality = REPLACED
    elif d.found in (ANGLES, WHEEL, PINION):
        s.quality = DEGRADED


@kernel
def step(s: State, c: Const, u: Inputs, out: Out[Evidence, Outputs]) -> None:
    """Take one sample, or the timer of a silent bus."""
    if u.trigger == TIMER:
        s.quality = INVALID
    else:
        out.wake_ns = u.t_ns + SILENCE * c.period_ns
        if u.which == ANGLE:
            _angle_frame(s, c, u)
            return
        if u.which == STEERED:
            _wheel_frame(s, c, u, out)
            return
        if not _pair(s, c, u, out):
            return
        _value(s, c, u)
    out.send = 1
    out.values.value = 0.0 if isnan(s.value) else s.value
    out.values.speed = s.speed
    out.values.quality = s.quality
    out.values.found = s.found + 1
    out.values.load = s.load


def _warnings(p: Params) -> tuple[str, ...]:
    if p.period_ms < COARSE:
        return ()
    constant = 1e3 * p.motor.inductance / p.motor.resistance
    return (
        f"period_ms = {p.period_ms}: the currents' time constant is {constant:.2f} ms; detection is degraded "
        "(noise and scale of the motor angle are found late or not at all), and the quality sent says so",
    )


MONITOR = Monitor(
    type="steering_angle",
    api=2,
    params=Params,
    state=State,
    const=Const,
    inputs=Inputs,
    evidence=Evidence,
    outputs=Outputs,
    step=step,
    connect=_connect,
    prepare=_prepare,
    faults=_faults,
    emits=_emits,
    capabilities=(
        BEHIND,
        Blames(_blames),
        Readout(
            (
                "value",
                "speed",
                "load",
                "quality",
                "pairs",
                "unpaired",
                "found",
                "parity",
                "wheel_age_ms",
                "angle_step",
                "not_seen",
            )
        ),
        Calibration(
            names=tuple(Thresholds.model_fields),
            rules=lambda s: s["symptoms"]["rules"],
            levels=lambda p: p.thresholds.at(p.period_ms),
        ),
        Warnings(_warnings),
        Sampled(samplings),
    ),
)
