"""The motor's side: a filter of its angle, and what that says of angle sensor, currents and voltages.

Everything runs once for a pair of motor frames. Three residuals are independent of each other's
weak spots:

increment  the sensor's step less the one of the alpha-beta filter's speed: sees what changes at once, at rest too
angle      where the EMF lies in the controller's frame: (17), (18) of paper 001 turned into it give
           (E_d, E_q) = c_M omega (sin, cos) of the sensor's error. Resistance and dead time act along the current,
           which the controller keeps on q, so that E_d knows hardly anything of them; blind at rest
balance    the EMF vector less c_M omega of the sensor's own speed: currents or voltages are wrong, or the angle
"""

from __future__ import annotations

from math import atan2, exp, hypot, isfinite, nan, pi, sin

from gateway_fdi.filters import ekf_alpha_beta, feedforward
from gateway_fdi.filters.motor import warm_resistance
from gateway_fdi.filters.transforms import clarke, inverse_park, park, wrap
from gateway_fdi.jit import Record, f8, i8, kernel, means
from gateway_plants.steering.monitor.params import Params

#: Share of a new value in the EMF's average, per millisecond.
AVERAGE = 0.05
#: Frames at rest after which it is known whether the sensor is lively; it is if in one of so many it turns back by more
#: than so many steps of its resolution. On the edge between two codes any sensor does so by one.
LEARNED, LIVELY, TURNS = 300, 25, 1.5
#: Steps of the sensor after which the least one is its resolution; a coarser one is none [rad, electrical].
STEPS, COARSEST = 50, 0.6
#: Factor of the anchor's standard deviation while the sensor is at fault.
DOUBT = 20.0
#: For so long the filter's speed may ask for more EMF than there is [s].
LOST = 0.05
#: Share of a resistance's largest error that is taken for noise of a step, squared.
SHARE = 0.25
#: What a silent sensor should have moved is forgotten, share a frame: at rest the filter's speed is noise.
STILL = 0.02
#: After so many lost frames, or ones that only waited, nobody knows how far the motor has turned, nor how fast [rad/s].
GAP, MOVING = 8.0, 100.0
#: Time in which the filter finds its state, and its speed alone [ms], and least frames of that.
SETTLES, RESUMES, LEAST = 100.0, 15.0, 10


class Const(Record):
    """Constants."""

    pole_pairs: f8 = means("z_p")
    emf: f8 = means("c_M: EMF per mechanical speed", "V s")
    period: f8 = means("period of the motor's messages", "s")
    resistance: f8 = means("resistance of a winding, cold", "Ohm")
    warm: i8 = means("1: the resistance follows the winding's temperature")
    gate: f8 = means("EMF from which on its angle is used", "V")
    share: f8 = means("share of a new value in the averages")
    resistance_error: f8 = means("share that the resistance may be off")
    flux_error: f8 = means("share that c_M may be off")
    dead: f8 = means("voltage lost to dead time", "V")
    noise: f8 = means("voltage that is noise", "V")
    settled: i8 = means("frames from which on the filter's state is known", "frames")
    resumed: i8 = means("frames after a gap that its speed takes", "frames")
    input_gain: f8 = means("current that a voltage makes in a period", "A/V")
    quiet: f8 = means("speed below which the motor rests", "rad/s")
    silent: i8 = means("frames from which on a repeated reading counts", "frames")
    filter: ekf_alpha_beta.Const = means("alpha-beta filter")
    forward: feedforward.Const = means("feedforward of the EMF")


class State(Record):
    """State."""

    started: i8 = means("1: a pair of frames has come")
    frames: i8 = means("pairs of frames since the start; a gap takes some back", "frames")
    theta: f8 = means("electrical angle of the last frame", "rad")
    turned: f8 = means("electrical angle since then", "rad")
    speed: f8 = means("speed of the sensor", "rad/s")
    increment: f8 = means("increment residual, mechanical", "rad")
    strength: f8 = means("size of the EMF, averaged", "V")
    lost: i8 = means("frames in a row in which the filter's speed asks for an EMF that is not there", "frames")
    restarts: i8 = means("restarts of the filter")
    e_d: f8 = means("EMF in the controller's frame, averaged", "V")
    e_q: f8 = means("likewise", "V")
    angle: f8 = means("error of the sensor, mechanical; NaN: the EMF is too small to tell", "rad")
    r_d: f8 = means("EMF that the sensor's speed does not explain, averaged", "V")
    r_q: f8 = means("likewise", "V")
    balance: f8 = means("size of (r_d, r_q), in units of what parameter errors explain")
    nis: f8 = means("normalised innovation squared")
    repeated: i8 = means("frames for which the sensor has said the same", "frames")
    longest: i8 = means("largest number of repeated in its life", "frames")
    slow: i8 = means("frames at rest that were looked at", "frames")
    lively: i8 = means("slow frames in which it turned back, by more than its resolution", "frames")
    still: f8 = means("what the sensor should have moved while it repeats, mechanical", "rad")
    step: f8 = means("resolution of the sensor, electrical", "rad")
    steps: i8 = means("steps that the sensor has made")
    least: f8 = means("smallest step, electrical", "rad")
    made: f8 = means("last step, electrical", "rad")
    strict: i8 = means("1: the EMF is larger than what a wrong resistance makes, too")
    i_alpha: f8 = means("current of the last frame", "A")
    i_beta: f8 = means("likewise", "A")
    residual_d: f8 = means("EMF that the sensor's speed does not explain, of the last frame alone", "V")
    residual_q: f8 = means("likewise", "V")
    middle: f8 = means("electrical angle of the frame that residual_d and residual_q are in", "rad")
    filter: ekf_alpha_beta.State = means("alpha-beta filter")
    forward: feedforward.State = means("feedforward of the EMF")


def prepare(s: State, c: Const, p: Params) -> None:
    """Fill state and constants.

    Args:
        p: parameters of the monitor.
    """
    motor, period = p.motor.motor, p.period_ms * 1e-3
    s.angle = nan
    s.step = p.angle_resolution * pi / 180.0 * motor.pole_pairs
    c.pole_pairs, c.emf, c.period = motor.pole_pairs, motor.emf, period
    c.resistance, c.warm = motor.resistance, p.temperature
    c.quiet, c.silent = 2.0, max(p.frames(35.0), 10)
    c.share = 1.0 - (1.0 - AVERAGE) ** p.period_ms
    c.gate, c.noise = 5.0 * motor.emf, 0.05
    c.settled, c.resumed = p.frames(SETTLES), max(p.frames(RESUMES), LEAST)
    c.resistance_error, c.flux_error = p.resistance_error, p.flux_error
    c.dead = p.dead_volts
    c.input_gain = (1.0 - exp(-motor.resistance * period / motor.lq)) / motor.resistance
    ekf_alpha_beta.prepare(c.filter, motor, period, slow=p.slow)
    feedforward.prepare(c.forward, motor, period)


@kernel
def _watch(s: State, c: Const, mechanical: float) -> None:
    """Start the filter anew if its speed asks for an EMF that is not there: it has lost its angle."""
    f = s.filter
    if c.emf * abs(f.x[2]) > 2.0 * s.strength + 2.0 * c.gate:
        s.lost += 1
    else:
        s.lost = 0
    if s.lost * c.period > LOST:
        s.lost = 0
        s.restarts += 1
        ekf_alpha_beta.begin(f, c.filter, mechanical)


@kernel
def _resolve(s: State) -> None:
    """Take a step of the sensor: the least one is its resolution."""
    size = abs(s.turned)
    s.least = size if s.steps == 0 else min(s.least, size)
    s.steps += 1
    if s.steps == STEPS:
        s.step = max(s.step, min(s.least, COARSEST))


@kernel
def _listen(s: State, c: Const) -> None:
    """Note whether the sensor turns to and fro at rest, because of its noise, and learn its resolution."""
    # Angles that have gone round the circle differ by arithmetic.
    same = abs(s.turned) < 1e-9
    if not same:
        _resolve(s)
    if abs(s.filter.x[2]) < c.quiet and s.slow < LEARNED and s.steps >= STEPS:
        s.slow += 1
        back = s.turned * s.made < 0.0 and abs(s.turned) > TURNS * s.step
        s.lively += 1 if back else 0
    if not same:
        s.made = s.turned
    if same:
        s.repeated += 1
        s.still += s.increment - STILL * s.still
        return
    if s.repeated < c.silent:
        s.longest = max(s.longest, s.repeated)
    s.repeated = 0
    s.still = 0.0


@kernel
def _emf(s: State, c: Const, u_d: float, u_q: float, middle: float, usable: bool) -> None:
    """Average the EMF in the controller's frame; find the sensor's error and the balance of voltages."""
    f = s.forward
    u_alpha, u_beta = inverse_park(u_d, u_q, middle)
    e_alpha, e_beta = feedforward.emf(f, c.forward, u_alpha, u_beta, s.i_alpha, s.i_beta, s.filter.resistance)
    if not usable:
        return
    e_d, e_q = park(e_alpha, e_beta, middle)
    s.strength += c.share * (hypot(e_d, e_q) - s.strength)
    way = 1.0 if s.filter.x[2] >= 0.0 else -1.0
    s.e_d += c.share * (way * e_d - s.e_d)
    s.e_q += c.share * (way * e_q - s.e_q)
    size, current = hypot(s.e_d, s.e_q), hypot(s.i_alpha, s.i_beta)
    s.angle = atan2(s.e_d, s.e_q) / c.pole_pairs if size > c.gate else nan
    s.strict = 1 if size > c.gate + c.resistance_error * s.filter.resistance * current else 0
    s.residual_d, s.residual_q, s.middle = e_d, e_q - c.emf * s.speed, middle
    s.r_d += c.share * (s.residual_d - s.r_d)
    s.r_q += c.share * (s.residual_q - s.r_q)
    allowed = (
        c.noise + c.dead + c.resistance_error * s.filter.resistance * current + c.flux_error * c.emf * abs(s.speed)
    )
    s.balance = hypot(s.r_d, s.r_q) / allowed


@kernel
def _begin(s: State, c: Const, theta: float, i_alpha: float, i_beta: float) -> None:
    """Begin with a pair of frames: nothing is known of the motor's speed."""
    f = s.filter
    s.started = 1
    s.frames = 0
    ekf_alpha_beta.begin(f, c.filter, theta / c.pole_pairs)
    f.p[2 * c.filter.n + 2] = MOVING * MOVING
    s.theta, s.i_alpha, s.i_beta = theta, i_alpha, i_beta
    s.forward.alpha, s.forward.beta = i_alpha, i_beta
    s.angle = nan


@kernel
def _go_on(s: State, c: Const, theta: float, i_alpha: float, i_beta: float, periods: float) -> None:
    """Go on after a gap: angle, speed and currents are found anew, load and resistance are what they were.

    How long it was is not sure: what seems lost may have waited, and come now. So nothing is predicted over it; the
    load wanders by its process noise.
    """
    f, n = s.filter, c.filter.n
    speed, load = f.x[2], f.x[4]
    unsure = f.p[4 * n + 4] + periods * c.filter.steps * c.filter.q[4 * n + 4]
    resistance, frames, angle = f.resistance, s.frames, s.angle
    _begin(s, c, theta, i_alpha, i_beta)
    f.x[0], f.x[1], f.x[2], f.x[4] = i_alpha, i_beta, speed, load
    f.p[0] = f.p[n + 1] = c.filter.r
    f.p[4 * n + 4] = min(unsure, f.p[4 * n + 4])
    f.resistance, s.angle = resistance, angle
    s.frames = min(frames, c.settled - c.resumed)


@kernel
def _predict(s: State, c: Const, u_d: float, u_q: float, periods: float) -> None:
    """Predict to the end of the frame, by steps of one length; lost frames are taken like the one that came."""
    count = int(periods)
    for k in range(count):
        share = s.turned / count
        ekf_alpha_beta.predict(s.filter, c.filter, u_d, u_q, s.theta + k * share, share)


@kernel
def _unexplained(s: State, c: Const, before: float, dt: float) -> float:
    """Return the sensor's step less the one that the filter's mean speed makes [rad, electrical].

    Args:
        before: the filter's speed when the step began [rad/s].
        dt: its length [s].
    """
    return wrap(s.turned - 0.5 * (before + s.filter.x[2]) * c.pole_pairs * dt, 2.0 * pi)


@kernel
def _blur(s: State, c: Const, u_d: float, u_q: float, jump: float, current: float) -> None:
    """Let the filter doubt its currents as far as voltages and resistance are not known.

    Args:
        u_d: mean voltage in the controller's frame [V].
        u_q: likewise.
        jump: step of the sensor that the filter does not explain [rad, electrical].
        current: magnitude [A].
    """
    f, n = s.filter, c.filter.n
    # Where the sensor jumped, nobody knows in which frame the controller made the voltages.
    blur = c.input_gain * hypot(u_d, u_q) * sin(0.5 * min(abs(jump), pi))
    # What a wrong resistance and dead time make of the current, taken for noise.
    warm = c.input_gain * (c.resistance_error * f.resistance * current + c.dead)
    f.p[0] += blur * blur + SHARE * warm * warm
    f.p[n + 1] += blur * blur + SHARE * warm * warm


@kernel
def _filter(
    s: State,
    c: Const,
    theta: float,
    u_d: float,
    u_q: float,
    i_alpha: float,
    i_beta: float,
    periods: float,
    trusted: bool,
) -> None:
    """Step the alpha-beta filter, and find the sensor's increment and speed.

    Args:
        theta: electrical angle of the sensor [rad].
        u_d: mean voltage in the controller's frame [V].
        u_q: likewise.
        i_alpha: current [A].
        i_beta: likewise.
        periods: frames since the last pair.
        trusted: nothing is known against the sensor.
    """
    f = s.filter
    s.turned = wrap(theta - s.theta, 2.0 * pi)
    dt = periods * c.period
    before = f.x[2]
    _predict(s, c, u_d, u_q, periods)
    _blur(s, c, u_d, u_q, _unexplained(s, c, before, dt), hypot(i_alpha, i_beta))
    ekf_alpha_beta.correct(f, c.filter, i_alpha, i_beta)
    s.nis = f.nis
    ekf_alpha_beta.hold(f, c.filter, theta / c.pole_pairs, 1.0 if trusted else DOUBT)
    s.increment = _unexplained(s, c, before, dt) / c.pole_pairs
    s.speed = s.turned / (c.pole_pairs * dt)


@kernel
def step(
    s: State,
    c: Const,
    i_u: float,
    i_v: float,
    theta: float,
    u_d: float,
    u_q: float,
    celsius: float,
    periods: float,
    trusted: bool,
) -> None:
    """Take a pair of motor frames.

    Args:
        i_u: phase current at the frame's end [A].
        i_v: likewise.
        theta: electrical angle used for Park there [rad].
        u_d: mean voltage in the controller's frame [V].
        u_q: likewise.
        celsius: temperature of the winding [degC]; NaN: as it was.
        periods: frames since the last pair, 1 if none was lost.
        trusted: nothing is known against the sensor that anchors the filter at standstill.
    """
    i_alpha, i_beta = clarke(i_u, i_v)
    if s.started == 0 or periods > c.settled:  # after as long a gap the load is another one
        _begin(s, c, theta, i_alpha, i_beta)
        return
    if periods > GAP:
        _go_on(s, c, theta, i_alpha, i_beta, periods)
        return
    if c.warm == 1 and isfinite(celsius):
        s.filter.resistance = warm_resistance(c.resistance, celsius)
    s.frames += 1
    _filter(s, c, theta, u_d, u_q, i_alpha, i_beta, periods, trusted)
    _listen(s, c)
    s.i_alpha, s.i_beta = i_alpha, i_beta
    _emf(s, c, u_d, u_q, s.theta + 0.5 * s.turned, periods == 1.0)
    _watch(s, c, theta / c.pole_pairs)
    s.theta = theta


@kernel
def lively(s: State) -> bool:
    """Tell whether the sensor is known to turn to and fro at rest."""
    return bool(LIVELY * s.lively > s.slow and s.slow >= LEARNED)


@kernel
def silent(s: State, c: Const) -> bool:
    """Tell whether the sensor repeats itself for longer than ever before, though it is known to be lively."""
    for_long = s.repeated >= max(c.silent, 3 * s.longest)
    return bool(for_long and lively(s))
