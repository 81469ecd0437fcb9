"""The gear's side: motor, steering wheel and pinion angle must fit (paper 001, (1)), each at the same time.

The steering wheel's sensor has a time of its own: at each of its frames, motor and pinion are taken from their history
for the moment at which it measured. Its own rate is a second witness of it.
"""

from __future__ import annotations

from typing import Annotated

from gateway_fdi.jit import Record, f8, f8s, i8, i8s, kernel, means
from gateway_plants.steering.monitor.params import Params

#: History of the frames with motor and pinion.
KEPT = 32
#: The steering wheel's age is learned while it turns faster than this, from so many frames with rates so far apart
#: [deg/s]; (1) must hold that well then [deg]. Within this it is as told [ns].
TURNING, TURNS, SPREAD, UNEXPLAINED, RIGHT_NS = 15.0, 30, 20.0, 0.12, 1_500_000.0
#: It is learned better until so many frames; until then it is known so nearly [ns].
KNOWN, NEARLY = 480, 1_500_000.0
#: Dates that do not follow each other as the counters do, by more than this, were found anew; a frame that seems to
#: have waited for longer has no sure date: its sender may have begun anew [ns].
TOLERANCE_NS = 1_000_000
#: Periods behind such a correction until no other one is likely: what had waited together has come by then.
SETTLES = 20
#: Behind a silence of so many periods nobody knows how often the counter went round.
ROUND = 16


class Const(Record):
    """Constants."""

    motor_ratio: f8 = means("motor over pinion")
    wheel_ratio: f8 = means("steering wheel over pinion")
    delay_ns: i8 = means("what the steering wheel's angle is older than its frame", "ns")
    age_ns: i8 = means("longest time between frames of motor and pinion, or behind the last, that is bridged", "ns")
    leak: f8 = means("share of the sum of wheel that is forgotten", "1/s")
    jitter: f8 = means("what a steering wheel's frame may be late", "s")
    angle_ns: f8 = means("period of motor and pinion angle", "ns")
    wheel_ns: f8 = means("period of the steering wheel's angle", "ns")
    stale_ns: i8 = means("after so long (1) is not tested", "ns")
    unsure: f8 = means("what delay_ns may be wrong", "s")
    most_ns: f8 = means("likewise", "ns")
    step: f8 = means("resolution of the motor's angle", "deg")
    twist: f8 = means("difference of the angles by which column and gear twist at the largest load", "deg")


class Dated(Record):
    """Date of the last frame of a message."""

    at_ns: i8 = means("when it was sampled", "ns")
    t_ns: i8 = means("when it came", "ns")
    since_ns: i8 = means("since when dates follow one another", "ns")


class State(Record):
    """State. Sums over the frames in which the steering wheel turns find how old its angle is."""

    at: i8 = means("place of the next frame in the history")
    kept: i8 = means("frames in the history")
    t_ns: Annotated[i8s, KEPT] = means("when motor and pinion were sampled", "ns")
    motor: Annotated[f8s, KEPT] = means("motor angle", "deg")
    pinion: Annotated[f8s, KEPT] = means("pinion angle", "deg")
    parity: f8 = means("what is left of (1), of the pinion", "deg")
    sure: f8 = means("the middle one of the last three, less what late frames explain", "deg")
    before: f8 = means("parity before the last", "deg")
    last: f8 = means("last parity", "deg")
    own: f8 = means("steering wheel's angle less the integral of its rate, since (1) and its rate last held", "deg")
    others: f8 = means("as sure, with the integral of the rate instead of the steering wheel's angle", "deg")
    others_before: f8 = means("parity less own, before the last", "deg")
    others_last: f8 = means("likewise, the last", "deg")
    wheel: f8 = means("steering wheel's angle less the integral of its rate, forgetting", "deg")
    last_wheel: f8 = means("steering wheel's last angle", "deg")
    last_rate: f8 = means("steering wheel's last rate", "deg/s")
    wheel_ns: i8 = means("when it was sampled", "ns")
    started: i8 = means("1: the steering wheel is followed")
    fitted_ns: i8 = means("the last frame for which (1) could be tested", "ns")
    watched: i8 = means("1: the rate has been followed since (1) last held")
    extra_ns: f8 = means("what the steering wheel's angle is older than told", "ns")
    aged: i8 = means("1: extra_ns is known")
    turns: i8 = means("frames in which the steering wheel turns", "frames")
    due: i8 = means("with so many turns extra_ns is found anew", "frames")
    rate_before: f8 = means("rate before the last", "deg/s")
    r: f8 = means("sum of the rates, of the pinion", "deg/s")
    p: f8 = means("sum of the parities", "deg")
    rr: f8 = means("sum of squares of the rates", "(deg/s)^2")
    rp: f8 = means("sum of rates by parities", "deg^2/s")
    pp: f8 = means("sum of squares of the parities", "deg^2")
    angle_date: Dated = means("of the frames with motor and pinion")
    wheel_date: Dated = means("of the frames with the steering wheel")


def prepare(c: Const, p: Params) -> None:
    """Fill constants.

    Args:
        p: parameters of the monitor.
    """
    c.motor_ratio, c.wheel_ratio = p.motor_ratio, p.wheel_ratio
    c.delay_ns, c.age_ns, c.leak = round(p.wheel_delay_ms * 1e6), 20_000_000, 2.0
    c.jitter = 1e-3 * p.wheel_jitter_ms
    c.angle_ns, c.wheel_ns = int(1e6 * p.angle_period), int(1e6 * p.wheel_period_ms)
    c.stale_ns = c.age_ns + 3 * c.wheel_ns
    c.unsure, c.most_ns = 1e-3 * p.wheel_delay_error_ms, 1e6 * p.wheel_delay_error_ms
    c.step, c.twist = p.angle_resolution, p.compliance


@kernel
def date(s: Dated, t_ns: int, waited: float, gap: float, period_ns: float) -> bool:
    """Take a frame that came at ``t_ns`` and had waited [s] (``gap`` periods on); returns whether dates start."""
    at_ns = t_ns - int(waited * 1e9)
    anew = s.t_ns == 0 or gap >= ROUND or abs(at_ns - s.at_ns - gap * period_ns) > TOLERANCE_NS
    s.at_ns, s.t_ns = at_ns, t_ns
    if anew:
        s.since_ns = t_ns
    return bool(anew)


@kernel
def sure(s: Dated, period_ns: float) -> bool:
    """Return whether the last frame's date can be relied on, the message's period given [ns]."""
    return bool(s.t_ns - s.since_ns >= SETTLES * period_ns and s.t_ns - s.at_ns <= TOLERANCE_NS)


@kernel
def keep(s: State, t_ns: int, motor: float, pinion: float) -> None:
    """Take a frame with motor and pinion angle [deg]."""
    s.t_ns[s.at] = t_ns
    s.motor[s.at] = motor
    s.pinion[s.at] = pinion
    s.at = (s.at + 1) % KEPT
    s.kept = min(s.kept + 1, KEPT)


@kernel
def _learn(s: State, c: Const) -> None:
    """Learn how old the steering wheel's angle is: while it turns, (1) is off by its rate times what was told wrong."""
    rate = s.last_rate / c.wheel_ratio
    if abs(rate) < TURNING:
        return
    s.turns += 1
    parity = s.parity - 1e-9 * s.extra_ns * rate  # as it was with the age as told
    s.r += rate
    s.p += parity
    s.rr += rate * rate
    s.rp += rate * parity
    s.pp += parity * parity
    rr = s.rr - s.r * s.r / s.turns
    if s.turns < max(s.due, TURNS) or rr < s.turns * SPREAD * SPREAD:
        return
    s.due = 2 * s.turns
    rp, pp = s.rp - s.r * s.p / s.turns, s.pp - s.p * s.p / s.turns
    age = -1e9 * rp / rr
    left = max(pp - rp * rp / rr, 0.0) / s.turns
    if left <= UNEXPLAINED * UNEXPLAINED and abs(age) <= c.most_ns:
        s.extra_ns = age if abs(age) > RIGHT_NS else 0.0
        s.aged = 1
        s.before = s.last = 0.0  # what was off by it is not
    elif s.aged == 0:
        s.turns = 0  # an angle is wrong, or it was: once more
        s.r = s.p = s.rr = s.rp = s.pp = 0.0
        s.due = 0


@kernel
def _fastest(s: State, c: Const) -> float:
    """Return how fast the steering wheel has turned lately, by its rate or by the other two angles [deg/s, pinion]."""
    rate = max(abs(s.last_rate), abs(s.rate_before)) / c.wheel_ratio
    new, old = (s.at - 1) % KEPT, (s.at - min(s.kept, 6)) % KEPT
    dt = 1e-9 * (s.t_ns[new] - s.t_ns[old])
    if dt > 0.0:
        turned = s.pinion[new] - s.pinion[old] - (s.motor[new] - s.motor[old]) / c.motor_ratio
        rate = max(rate, abs(turned) / dt)
    return float(rate)


@kernel
def fit(s: State, c: Const, sampled_ns: int, wheel: float, coarse: float) -> bool:
    """Compute (1)'s residual for a steering wheel angle [deg] measured at a time; tells whether it could be.

    Frames on both sides of that moment are needed; the wheel's delay makes them likely to be there. Without a later
    one the newest two are extrapolated, not further than ``age_ns``. :func:`follow` comes first. ``coarse``: the motor
    sensor's resolution [deg] where that matters.
    """
    if s.kept < 2:
        return False
    t_ns = sampled_ns - int(s.extra_ns)
    later = (s.at - 1) % KEPT
    for _ in range(s.kept - 2):
        before = (later - 1) % KEPT
        if s.t_ns[before] <= t_ns:
            break
        later = before
    before = (later - 1) % KEPT
    width = s.t_ns[later] - s.t_ns[before]
    if width <= 0 or width > c.age_ns:
        return False
    if t_ns < s.t_ns[before] or t_ns - s.t_ns[later] > c.age_ns:
        return False
    share = (t_ns - s.t_ns[before]) / width
    motor = s.motor[before] + share * (s.motor[later] - s.motor[before])
    pinion = s.pinion[before] + share * (s.pinion[later] - s.pinion[before])
    s.parity = motor / c.motor_ratio + wheel / c.wheel_ratio - pinion
    # What a load twists; what a frame that was late on the bus makes of a turning wheel; half a step of the sensor, and
    # as much for what lies between two of its frames.
    slack = c.twist + c.jitter * abs(s.last_rate) / c.wheel_ratio + coarse / c.motor_ratio
    if s.turns < KNOWN:
        due = s.due
        _learn(s, c)
        if s.aged == 1 and s.due != due:
            return False  # the next one is with the new age
        slack += (c.unsure if s.aged == 0 else NEARLY * 1e-9) * _fastest(s, c)
    others = s.parity - s.own
    s.sure = _beyond(s.before, s.last, s.parity, slack)
    s.others = _beyond(s.others_before, s.others_last, others, slack)
    s.before, s.last, s.others_before, s.others_last = s.last, s.parity, s.others_last, others
    return True


@kernel
def _beyond(one: float, two: float, three: float, slack: float) -> float:
    """Return what the middle one of three has beyond a slack: one that was late is not like those beside it."""
    middle = max(min(one, two), min(max(one, two), three))
    return float(middle - min(max(middle, -slack), slack))


@kernel
def begin(s: State) -> None:
    """Follow the steering wheel anew: when it was sampled is known anew."""
    s.started = s.watched = 0
    s.wheel = s.own = 0.0


@kernel
def follow(s: State, c: Const, t_ns: int, wheel: float, rate: float) -> None:
    """Compare the steering wheel's step [deg] with its rate [deg/s]."""
    if s.started == 1:
        dt = (t_ns - s.wheel_ns) * 1e-9
        error = wheel - s.last_wheel - 0.5 * (rate + s.last_rate) * dt
        s.wheel += error - min(c.leak * dt, 1.0) * s.wheel
        s.own += error
    s.started = 1
    s.rate_before = s.last_rate
    s.last_wheel, s.last_rate, s.wheel_ns = wheel, rate, t_ns


@kernel
def now(s: State, c: Const, t_ns: int) -> float:
    """Return the steering wheel's angle at a time, continued with its rate [deg]."""
    age = (t_ns - s.wheel_ns + c.delay_ns + s.extra_ns) * 1e-9
    return float(s.last_wheel + s.last_rate * age)


@kernel
def tested(s: State, c: Const, t_ns: int) -> bool:
    """Return whether (1) is tested at present: the last time is not long ago."""
    return bool(s.fitted_ns > 0 and t_ns - s.fitted_ns <= c.stale_ns)
