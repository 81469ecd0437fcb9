"""Symptoms: what each residual says over time (paper 001, Fig. 2: stopping rules; beyond it: how long, how large).

Seven residuals have a stopping rule each, and an alarm. What alarms do over time makes the binary symptoms that the
signature table of :mod:`gateway_plants.steering.monitor.decision` is written in: at the end of a window behind a jump
(:mod:`.jumps`), after so many frames in a row, or by comparing two residuals that should see the same error. Here is
how a symptom is turned on and off; which component a set of symptoms belongs to is decided there.
"""

from __future__ import annotations

from math import isnan, nan, pi
from typing import Annotated

from gateway_fdi import stopping
from gateway_fdi.filters.transforms import inverse_park
from gateway_fdi.jit import Record, f8, i8, i8s, kernel, means
from gateway_plants.steering.monitor import electrics, jumps, kinematics, onset, trend
from gateway_plants.steering.monitor.params import Params

#: Alarms of the stopping rules, by their place: that of Thresholds.
JUMP, RESTLESS, ANGLE, PARITY, BALANCE, SURPRISE, RATE = range(7)
ALARMS = 7

#: The sensor repeats itself as no live one does.
REPEATS = 1 << 0
#: At the end of a window behind a jump, and only then: increments beyond the threshold; the largest one stands in the
#: parity, so that the gear has not made it; it began far beyond the threshold; one as large went back.
EXCEEDS, IN_PARITY, SUDDEN, RETURNS = 1 << 1, 1 << 2, 1 << 3, 1 << 4
#: Likewise: more of the innovation's alarms than of increments, or one shortly before, and not sudden: the filter's
#: speed is wrong, not the sensor; many increments, until the end; of both signs; their sum is beyond the threshold;
#: their mean square is.
NIS_FIRST, FREQUENT, BOTH_SIGNS = 1 << 5, 1 << 6, 1 << 7
NET_STEP, MEAN_SQUARE = 1 << 8, 1 << 9
#: The three angles do not fit, by CUSUM; so for long.
PARITY_ALARM, LASTING = 1 << 10, 1 << 11
#: The EMF contradicts the sensor for some frames, and the gear confirms it; how this error grows.
EMF_CONTRADICTS, GROWS_WITH_TIME, GROWS_WITH_ANGLE = 1 << 12, 1 << 13, 1 << 14
#: The EMF has known for some frames that the motor's angle is not what breaks the parity.
EMF_CONSISTENT = 1 << 15
#: The steering wheel's own rate tells of what breaks the parity; or it does not, though it would.
RATE_CONTRADICTS, RATE_CONSISTENT = 1 << 16, 1 << 17
#: Currents, voltages and motion do not fit for long; a current does not change; how the voltage residual has stepped.
ELECTRIC_MISFIT, CURRENT_FROZEN = 1 << 18, 1 << 19
STEP_AT_ONCE, STEP_DELAYED = 1 << 20, 1 << 21

#: Parity beyond which the steering wheel's rate would have told of its error [deg].
CLEAR = 0.3
#: Share of increments beyond the threshold in a window from which on a sensor is noisy.
NOISY = 0.12
#: Steps of a coarse sensor by which it should have moved further, for it to be stuck.
COARSE = 6.0
#: Frames for which a current that is measured changes at least once.
FROZEN = 20


class Const(Record):
    """Constants."""

    rules: Annotated[list[stopping.Const], ALARMS] = means("stopping rule of each residual")
    window: i8 = means("frames behind a jump", "frames")
    confirm: i8 = means("frames of the EMF's alarm in a row", "frames")
    rule_out: i8 = means("frames in a row of an EMF that is consistent with the motor's angle", "frames")
    wait: i8 = means("frames of the parity's alarm", "frames")
    ratio: f8 = means("motor over pinion")


class State(Record):
    """State."""

    rules: Annotated[list[stopping.State], ALARMS] = means("stopping rule of each residual")
    alarm: Annotated[i8s, ALARMS] = means("1: the residual's alarm is on")
    geared: i8 = means("1: what compares the gear's angles is tested at present")
    misfit: i8 = means("frames since the parity's alarm", "frames")
    emf_consistent: i8 = means("frames in a row, since then, in which the EMF confirmed the motor's angle", "frames")
    emf_alarms: i8 = means("frames in a row in which the EMF contradicted the motor's angle", "frames")
    electric: i8 = means("how often currents and voltages did not fit, lately")
    frozen: i8 = means("frames for which a current has not changed", "frames")
    unseen: i8 = means("1: nobody has seen how the present misfit of currents and voltages began")
    last_u: f8 = means("last phase current", "A")
    last_v: f8 = means("likewise", "A")
    surprised: i8 = means("frames for which an alarm of the innovation outside a window counts", "frames")
    jump: jumps.State = means("window behind a jump")
    onset: onset.State = means("how the voltage residual steps")
    trend: trend.State = means("how the error of the motor's angle grows")


def prepare(c: Const, p: Params) -> None:
    """Fill constants.

    Args:
        p: parameters of the monitor.
    """
    levels = p.thresholds.at(p.period_ms)
    forget = {RESTLESS: 0.98**p.period_ms, SURPRISE: 0.8**p.period_ms}
    for k, level in enumerate(levels):
        if k == PARITY:
            stopping.prepare(c.rules[k], "cusum", level, drift=p.blind, most=4.0 * level)
        elif k in forget:
            stopping.prepare(c.rules[k], "gma", level, forget=forget[k])
        else:
            stopping.prepare(c.rules[k], "direct", level)
    c.window = max(p.frames(40.0), 12)
    c.confirm = max(p.frames(8.0), 4)
    c.wait, c.rule_out = p.frames(15.0), p.frames(60.0)
    c.ratio = p.motor_ratio


@kernel
def update_symptom(s: State, c: Const, symptom: int, x: float) -> None:
    """Put one value of a symptom through its stopping rule."""
    s.alarm[symptom] = 1 if stopping.update(s.rules[symptom], c.rules[symptom], x) else 0


@kernel
def update_motor(s: State, c: Const, m: electrics.State) -> None:
    """Take the residuals of a pair of motor frames."""
    update_symptom(s, c, JUMP, m.increment)
    # A single jump is no noise.
    usual = min(abs(m.increment), 2.0 * c.rules[JUMP].threshold)
    update_symptom(s, c, RESTLESS, usual * usual)
    update_symptom(s, c, ANGLE, 0.0 if isnan(m.angle) else m.angle)
    update_symptom(s, c, BALANCE, m.balance)
    update_symptom(s, c, SURPRISE, m.nis)
    r_alpha, r_beta = inverse_park(m.residual_d, m.residual_q, m.middle)
    onset.keep(s.onset, r_alpha, r_beta)


@kernel
def update_gear(s: State, c: Const, k: kinematics.State, motor: float) -> None:
    """Take the residuals of a frame of the steering wheel, with the motor's angle [deg]."""
    update_symptom(s, c, RATE, k.wheel)
    update_symptom(s, c, PARITY, k.sure)
    trend.keep(s.trend, k.parity, motor)


@kernel
def any_alarm(s: State) -> bool:
    """Tell whether an alarm is on, or a jump is looked at."""
    for k in range(ALARMS):
        if s.alarm[k] == 1:
            return True
    return bool(s.jump.left > 0)


@kernel
def _repeats(c: Const, m: electrics.State, ec: electrics.Const) -> bool:
    """Tell whether the sensor repeats itself, though a live one would not, or though it should have moved far."""
    due = abs(m.still) > 2.0 * c.rules[JUMP].threshold + COARSE * m.step / ec.pole_pairs
    return bool(electrics.silent(m, ec) or (due and m.repeated >= c.confirm))


@kernel
def _judge_jump(s: State, c: Const, parity: float) -> int:
    """Return the symptoms of a window that is over."""
    j, on = s.jump, 0
    limit = c.rules[JUMP].threshold
    # What the motor's angle must have done to make this change of the parity [rad].
    moved = (parity - j.parity_before) * c.ratio * pi / 180.0
    if j.exceedances > 0:
        on |= EXCEEDS
        if abs(moved - j.largest) < 0.4 * abs(j.largest):
            on |= IN_PARITY
    if j.sudden == 1:
        on |= SUDDEN
    elif 2 * j.nis_alarms > j.exceedances or s.surprised > 0:
        on |= NIS_FIRST
    if not j.opposite < 0.6 * abs(j.largest):
        on |= RETURNS
    if j.exceedances > NOISY * c.window and j.second_half > 0:
        on |= FREQUENT
    if min(j.up, j.down) > 0:
        on |= BOTH_SIGNS
    if abs(j.net) > limit:
        on |= NET_STEP
    if s.alarm[RESTLESS] == 1:
        on |= MEAN_SQUARE
    return on


@kernel
def _jump(s: State, c: Const, increment: float, parity: float) -> int:
    """Follow a window behind a jump; returns its symptoms at its end, none before and without."""
    exceeds = s.alarm[JUMP] == 1
    if s.jump.left == 0:
        before = s.alarm[SURPRISE] == 1 and not exceeds
        s.surprised = c.window if before else max(s.surprised - 1, 0)
        if not exceeds and s.alarm[RESTLESS] == 0:
            return 0
        far = abs(increment) > jumps.SUDDEN * c.rules[JUMP].threshold
        # A wrong current or voltage surprises the filter before its speed is wrong.
        jumps.begin(s.jump, c.window, far and s.alarm[SURPRISE] == 0, parity)
    over = jumps.update(s.jump, c.window, increment, exceeds, s.alarm[SURPRISE])
    return _judge_jump(s, c, parity) if over else 0


@kernel
def _agree(c: Const, angle: float, parity: float) -> bool:
    """Tell whether EMF and gear find the same error of the motor's angle, and not a small one."""
    expected = parity * c.ratio * pi / 180.0
    large = abs(angle) > 0.5 * c.rules[ANGLE].threshold
    return bool(large and abs(expected - angle) < 0.5 * abs(angle))


@kernel
def _count_angles(s: State, c: Const, angle: float, parity: float) -> bool:
    """Count for how long parity and EMF have alarmed; tells whether which angle is wrong may be judged.

    Args:
        angle: error of the sensor by the EMF [rad], NaN: there is none.
        parity: the newest residual of (1) [deg].
    """
    if s.jump.left > 0:
        return False  # what just jumped is looked at first
    if s.geared == 0:
        s.misfit = s.emf_consistent = s.emf_alarms = 0
        s.alarm[PARITY] = s.alarm[RATE] = 0
        return False
    s.emf_alarms = s.emf_alarms + 1 if s.alarm[ANGLE] == 1 else 0
    agreed = s.emf_alarms >= c.confirm and _agree(c, angle, parity)
    if s.alarm[PARITY] == 0 and not agreed:
        s.misfit = s.emf_consistent = 0
        return False
    s.misfit += 1
    expected = parity * c.ratio * pi / 180.0
    if not isnan(angle) and abs(expected) > c.rules[ANGLE].threshold:
        s.emf_consistent = s.emf_consistent + 1 if abs(angle) < 0.5 * abs(expected) else 0
    return True


@kernel
def growth(s: State) -> int:
    """Return the symptom of how the motor angle's error grows; none if that cannot be told."""
    grows = trend.growth(s.trend)
    if grows == trend.WITH_ANGLE:
        return GROWS_WITH_ANGLE
    return GROWS_WITH_TIME if grows == trend.WITH_TIME else 0


@kernel
def _angles(s: State, c: Const, angle: float, parity: float, wheel: float, watched: bool) -> int:
    """Return the symptoms of EMF, parity and rate; arguments as of :func:`present`."""
    if not _count_angles(s, c, angle, parity):
        return 0
    if s.emf_alarms >= c.confirm:
        return EMF_CONTRADICTS | growth(s)
    on = 0
    # The wheel's own error stands in (1) as it is; the rest of it belongs to somebody else.
    if s.alarm[RATE] == 1 and abs(wheel) > 0.5 * abs(parity):
        on |= RATE_CONTRADICTS
    if watched and abs(wheel) < 0.4 * abs(parity) and abs(parity) > CLEAR:
        on |= RATE_CONSISTENT
    if s.emf_consistent >= c.rule_out:
        on |= EMF_CONSISTENT
    if s.misfit >= c.wait:
        on |= LASTING
    return on


@kernel
def step_shape(s: State) -> int:
    """Return the symptom of how the voltage residual has stepped; none if that cannot be told."""
    shape = onset.shape(s.onset)
    if shape == onset.UNSEEN:
        s.unseen = 1
    if s.unseen == 1:
        return 0  # a later step is not the one that it began with
    if shape == onset.AT_ONCE:
        return STEP_AT_ONCE
    return STEP_DELAYED if shape == onset.DELAYED else 0


@kernel
def _count_electric(s: State, c: Const, i_u: float, i_v: float, angle_wrong: bool) -> None:
    """Count for how long currents and voltages have not fitted, and for how long a current has not changed."""
    same = i_u == s.last_u or i_v == s.last_v
    s.last_u, s.last_v = i_u, i_v
    s.frozen = s.frozen + 1 if same else 0
    if angle_wrong:
        s.electric = 0  # a wrong angle upsets the currents, too
    elif s.alarm[SURPRISE] == 1 or s.alarm[BALANCE] == 1:
        s.electric = min(s.electric + 1, c.window)
    elif s.electric > 0:
        s.electric -= 1


@kernel
def _electric(s: State, c: Const, i_u: float, i_v: float, angle_wrong: bool) -> int:
    """Return the symptoms of currents and voltages."""
    _count_electric(s, c, i_u, i_v, angle_wrong)
    if s.electric == 0:
        s.unseen = 0
    if s.electric < c.window // 2:
        return 0
    if s.frozen >= FROZEN:
        return ELECTRIC_MISFIT | CURRENT_FROZEN
    return ELECTRIC_MISFIT | step_shape(s)


@kernel
def present(
    s: State,
    c: Const,
    m: electrics.State,
    ec: electrics.Const,
    k: kinematics.State,
    i_u: float,
    i_v: float,
    angle_fault: bool,
) -> int:
    """Return the set of symptoms that are on behind a pair of motor frames.

    Args:
        s: record of State; :func:`update_motor` comes first.
        m: motor's side.
        k: gear's side.
        i_u: current [A].
        i_v: likewise.
        angle_fault: an angle is known to be wrong.
    """
    # The EMF counts where it is beyond doubt.
    angle = m.angle if m.strict == 1 else nan
    on = REPEATS if _repeats(c, m, ec) else 0
    on |= _jump(s, c, m.increment, k.parity)
    on |= _angles(s, c, angle, k.parity, k.wheel, k.watched == 1)
    sudden = s.jump.left > 0 and s.jump.sudden == 1
    angle_wrong = angle_fault or sudden or _agree(c, angle, k.parity)
    on |= _electric(s, c, i_u, i_v, angle_wrong)
    if s.alarm[PARITY] == 1:
        on |= PARITY_ALARM
    return on
