"""From symptoms to the component at fault (paper 001, Fig. 2: stopping rules; beyond it: isolation).

Signature of a single fault:

    component             increment   EMF's angle   parity (1)   own rate   balance, NIS
    motor angle sensor        x            x            x            -           -
    steering wheel angle      -            -            x            x           -
    pinion angle              -            -            x            -           -
    currents, voltages        -            -            -            -           x

At rest the EMF is silent: a parity that grows there belongs to one of three angles, and is reported so; the next
motion tells which. The sensors are in a closed loop: the motor follows a wrong angle, and the pinion tells of it.

A current sensor's error shows at once, a voltage's only after the inductance: the first sample of the voltage residual
is, for a current sensor, R T/2 + L times the error's step over T, and R times the error from then on.
"""

from __future__ import annotations

from math import hypot, isnan, pi, sqrt
from typing import Annotated

from gateway.fdi import stopping
from gateway.jit import Record, f8, f8s, i8, i8s, kernel
from gateway.monitors.steering.faults import (
    ANGLES,
    CURRENT,
    DRIFT,
    ELECTRIC,
    IMPLAUSIBLE,
    INTERMITTENT,
    NOISE,
    OFFSET,
    PINION,
    SCALE,
    STUCK,
    VOLTAGE,
    WHEEL,
)

#: Symptoms by their place.
JUMP, RESTLESS, ANGLE, PARITY, BALANCE, SURPRISE, RATE = range(7)
SYMPTOMS = 7
#: Nothing found.
NONE = -1
#: Voltage residuals, and parities, that are kept.
RING, HISTORY = 256, 64
#: Of the last voltage residuals so many are searched for the onset; before it, and behind it, so many are averaged.
SEARCH, BEFORE, BEHIND = 220, 12, 6
#: First sample of a current sensor's error over the following ones lies above, a voltage's below.
FIRST = 1.5
#: Parity beyond which the steering wheel's rate would have told of its error [deg].
CLEAR = 0.3
#: A first increment beyond so many thresholds is a jump.
SUDDEN = 3.0
#: Share of odd increments in a window from which on a sensor is noisy.
NOISY = 0.12


class Const(Record):
    """Constants."""

    rules: Annotated[list[stopping.Const], SYMPTOMS]
    window: i8
    silent: i8
    confirm: i8
    wait: i8
    hold: i8
    exonerate: i8
    ratio: f8


class State(Record):
    """State.

    ``found``: the fault, NONE without; ``quiet``: frames since the last symptom of it. ``window``: frames left in
    which a jump is looked at: how many were ``odd``, the ``largest``, the largest ``back`` of it, whether it
    began ``sudden``ly. ``geared``: what compares the gear's angles is tested at present. ``open``: frames since
    the parity's alarm; ``cleared``: of these, how often the EMF vouched for the motor's angle; ``accused``: how
    often against it in a row. ``electric``: how often currents and voltages did not fit, lately; ``frozen``:
    frames for which a current has not changed.
    """

    rules: Annotated[list[stopping.State], SYMPTOMS]
    alarm: Annotated[i8s, SYMPTOMS]
    found: i8
    quiet: i8
    window: i8
    odd: i8
    up: i8
    down: i8
    late: i8
    net: f8
    largest: f8
    back: f8
    sudden: i8
    before: f8
    surprised: i8
    geared: i8
    open: i8
    cleared: i8
    accused: i8
    electric: i8
    frozen: i8
    last_u: f8
    last_v: f8
    at: i8
    filled: i8
    alpha: Annotated[f8s, RING]
    beta: Annotated[f8s, RING]
    place: i8
    held: i8
    parity: Annotated[f8s, HISTORY]
    motor: Annotated[f8s, HISTORY]


@kernel
def hear(s: State, c: Const, symptom: int, x: float) -> None:
    """Put one value of a symptom through its stopping rule."""
    s.alarm[symptom] = 1 if stopping.update(s.rules[symptom], c.rules[symptom], x) else 0


@kernel
def remember(s: State, alpha: float, beta: float) -> None:
    """Keep a voltage residual [V]."""
    s.alpha[s.at] = alpha
    s.beta[s.at] = beta
    s.at = (s.at + 1) % RING
    s.filled = min(s.filled + 1, RING)


@kernel
def note_parity(s: State, parity: float, motor: float) -> None:
    """Keep a parity [deg] with the motor's angle [deg]."""
    s.parity[s.place] = parity
    s.motor[s.place] = motor
    s.place = (s.place + 1) % HISTORY
    s.held = min(s.held + 1, HISTORY)


@kernel
def current_or_voltage(s: State) -> int:
    """Tell by the first sample of the voltage residual's step what is wrong."""
    if s.frozen >= 20:
        return CURRENT
    if s.filled < RING:
        return ELECTRIC
    best, ratio = 0.0, 0.0
    for back in range(BEHIND + 1, SEARCH):
        base_a = base_b = 0.0
        spread = 0.0
        for k in range(BEFORE):
            j = (s.at - 1 - back - BEFORE + k) % RING
            base_a += s.alpha[j] / BEFORE
            base_b += s.beta[j] / BEFORE
        for k in range(BEFORE):
            j = (s.at - 1 - back - BEFORE + k) % RING
            spread += (s.alpha[j] - base_a) ** 2 + (s.beta[j] - base_b) ** 2
        first = (s.at - 1 - back) % RING
        y_a, y_b = s.alpha[first] - base_a, s.beta[first] - base_b
        m_a = m_b = 0.0
        for k in range(1, BEHIND + 1):
            j = (first + k) % RING
            m_a += (s.alpha[j] - base_a) / BEHIND
            m_b += (s.beta[j] - base_b) / BEHIND
        step = hypot(m_a, m_b)
        noise = sqrt(spread / BEFORE) + 1e-3
        # The onset is where the step stands out most from what was before.
        standing = min(step, hypot(y_a, y_b)) / noise if step > 0.0 else 0.0
        if standing > best:
            best = standing
            ratio = (y_a * m_a + y_b * m_b) / (step * step)
    if best < 2.0:
        return ELECTRIC
    return CURRENT if ratio > FIRST else VOLTAGE


@kernel
def drift_or_scale(s: State) -> int:
    """Tell by the last parities whether the motor angle's error grows with time, with the angle, or stands."""
    n = s.held
    if n < 16:
        return IMPLAUSIBLE
    t = p = tt = tp = pp = mm = mp = mean_m = 0.0
    for k in range(n):
        j = (s.place - n + k) % HISTORY
        y, x = s.parity[j], s.motor[j]
        t += k
        p += y
        tt += k * k
        tp += k * y
        pp += y * y
        mm += x * x
        mp += x * y
        mean_m += x
    spread_t = tt - t * t / n
    slope = (tp - t * p / n) / spread_t
    around = max(pp - p * p / n, 0.0)
    with_time = max(around - slope * slope * spread_t, 0.0)
    with_angle = max(pp - mp * mp / mm, 0.0) if mm > 0.0 else pp
    moving = mm - mean_m * mean_m / n > 1e-3 * mm + n * 400.0  # more than 20 deg of the motor
    floor = n * 1.5e-3  # of quantisation and lash [deg^2]
    if moving and with_angle < 0.5 * with_time + floor and with_angle < 0.5 * around:
        return SCALE
    if with_time < 0.6 * with_angle and with_time < 0.5 * around + floor:
        return DRIFT
    return IMPLAUSIBLE


@kernel
def _look_at_jumps(s: State, c: Const, increment: float, parity: float) -> int:
    """Follow a window behind an odd increment; returns a fault at its end, NONE before and without."""
    odd = s.alarm[JUMP] == 1
    if s.window == 0:
        if not odd and s.alarm[RESTLESS] == 0:
            return NONE
        s.window = c.window
        s.odd = s.up = s.down = s.late = s.surprised = 0
        s.net = s.largest = s.back = 0.0
        # A wrong current or voltage surprises the filter before its speed is wrong.
        s.sudden = 1 if abs(increment) > SUDDEN * c.rules[JUMP].threshold else 0
        if s.alarm[SURPRISE] == 1:
            s.sudden = 0
        s.before = parity
    s.window -= 1
    s.net += increment
    if odd:
        s.odd += 1
        if increment > 0.0:
            s.up += 1
        else:
            s.down += 1
        if 2 * s.window < c.window:
            s.late += 1
        if abs(increment) > abs(s.largest):
            if increment * s.largest < 0.0:
                s.back = abs(s.largest)
            s.largest = increment
        elif increment * s.largest < 0.0:
            s.back = max(s.back, abs(increment))
    s.surprised += s.alarm[SURPRISE]
    if s.window > 0:
        return NONE
    moved = (parity - s.before) * c.ratio * pi / 180.0
    if s.odd > 0 and abs(moved - s.largest) < 0.4 * abs(s.largest):
        return OFFSET  # a jump that the gear has not made, and that stays
    if s.sudden == 1 and s.back < 0.6 * abs(s.largest):
        return OFFSET
    if s.sudden == 0 and 2 * s.surprised > s.odd:
        return NONE  # currents or voltages: the filter's speed is wrong, not the sensor
    if s.odd > NOISY * c.window and s.late > 0 and min(s.up, s.down) > 0:
        return NOISE
    if s.odd == 0:
        return NOISE if s.alarm[RESTLESS] == 1 else NONE
    limit = c.rules[JUMP].threshold
    if abs(s.net) > limit and (min(s.up, s.down) == 0 or s.odd == 1):
        return OFFSET
    if min(s.up, s.down) > 0:
        return INTERMITTENT
    return NONE


@kernel
def _agree(c: Const, angle: float, parity: float) -> bool:
    """Tell whether EMF and gear find the same error of the motor's angle, and not a small one."""
    expected = parity * c.ratio * pi / 180.0
    large = abs(angle) > 0.5 * c.rules[ANGLE].threshold
    return bool(large and abs(expected - angle) < 0.5 * abs(angle))


@kernel
def _look_at_angles(
    s: State, c: Const, angle: float, parity: float, wheel: float, watched: bool
) -> int:
    """Find out which angle breaks the parity, or that the EMF contradicts the sensor."""
    if s.window > 0:
        return NONE  # what just jumped is looked at first
    if s.geared == 0:
        s.open = s.cleared = s.accused = 0
        s.alarm[PARITY] = s.alarm[RATE] = 0
        return NONE
    against = s.alarm[ANGLE] == 1
    s.accused = s.accused + 1 if against else 0
    agreed = s.accused >= c.confirm and _agree(c, angle, parity)
    if s.alarm[PARITY] == 0 and not agreed:
        s.open = s.cleared = 0
        return NONE
    s.open += 1
    expected = parity * c.ratio * pi / 180.0
    if not isnan(angle) and abs(expected) > c.rules[ANGLE].threshold:
        if abs(angle) < 0.5 * abs(expected):
            s.cleared += 1
        else:
            s.cleared = 0
    if s.accused >= c.confirm:
        return drift_or_scale(s)
    # The wheel's own error stands in (1) as it is; the rest of it belongs to somebody else.
    if s.alarm[RATE] == 1 and abs(wheel) > 0.5 * abs(parity):
        return WHEEL
    fits = watched and abs(wheel) < 0.4 * abs(parity)
    if s.cleared >= c.exonerate and fits and abs(parity) > CLEAR:
        return PINION
    return ANGLES if s.open >= c.wait else NONE


@kernel
def _look_at_currents(
    s: State, c: Const, angle: float, parity: float, i_u: float, i_v: float
) -> int:
    """Find out whether currents and voltages contradict each other for long enough."""
    same = i_u == s.last_u or i_v == s.last_v
    s.last_u, s.last_v = i_u, i_v
    s.frozen = s.frozen + 1 if same else 0
    sudden = s.window > 0 and s.sudden == 1
    if (s.found != NONE and s.found < CURRENT) or sudden or _agree(c, angle, parity):
        s.electric = 0  # a wrong angle upsets the currents, too
    elif s.alarm[SURPRISE] == 1 or s.alarm[BALANCE] == 1:
        s.electric = min(s.electric + 1, c.window)
    elif s.electric > 0:
        s.electric -= 1
    if s.electric < c.window // 2 or s.alarm[PARITY] == 1:
        return NONE
    return current_or_voltage(s)


@kernel
def witness(found: int) -> int:
    """Return the symptom that speaks for a fault."""
    if found in (OFFSET, INTERMITTENT, STUCK):
        return JUMP
    if found == NOISE:
        return RESTLESS
    if found == WHEEL:
        return RATE
    return SURPRISE if found in (CURRENT, VOLTAGE, ELECTRIC) else PARITY


@kernel
def needs_gear(fault: int) -> bool:
    """Tell whether a fault is found, and found to be gone, by comparing the gear's angles."""
    return fault in (DRIFT, SCALE, IMPLAUSIBLE, WHEEL, PINION, ANGLES)


@kernel
def _speaks(s: State) -> bool:
    """Tell whether a symptom speaks."""
    for k in range(SYMPTOMS):
        if s.alarm[k] == 1:
            return True
    return bool(s.window > 0)


@kernel
def decide(
    s: State,
    c: Const,
    increment: float,
    angle: float,
    parity: float,
    wheel: float,
    watched: bool,
    silent: bool,
    i_u: float,
    i_v: float,
) -> None:
    """Take the symptoms of one pair of motor frames; sets ``s.found``.

    Args:
        s: record of State.
        c: record of Const.
        increment: residual [rad].
        angle: error of the sensor by an EMF that is beyond doubt [rad], NaN: there is none.
        parity: the newest residual of (1) [deg].
        wheel: the steering wheel against its own rate [deg].
        watched: this has been known since before the angles did not fit.
        silent: the sensor repeats itself as no live one does.
        i_u: current [A].
        i_v: likewise.
    """
    jumped = _look_at_jumps(s, c, increment, parity)
    angles = _look_at_angles(s, c, angle, parity, wheel, watched)
    electric = _look_at_currents(s, c, angle, parity, i_u, i_v)
    if silent or _speaks(s):
        s.quiet = 0
    elif s.geared == 1 or not needs_gear(s.found):
        s.quiet += 1
    if s.found != NONE and s.quiet >= c.hold:
        s.found = NONE
    vague = s.found in (NONE, ANGLES, IMPLAUSIBLE)
    # What the motor's sensor shows by itself stands beside whatever the gear has said before.
    open_to = vague or s.found in (WHEEL, PINION)
    if silent and open_to:
        s.found = STUCK
    elif jumped != NONE and open_to:
        s.found = jumped
    elif electric != NONE and s.found in (NONE, ELECTRIC):
        s.found = electric
    elif (angles != NONE and s.found == NONE) or (vague and angles not in (NONE, ANGLES)):
        s.found = angles
