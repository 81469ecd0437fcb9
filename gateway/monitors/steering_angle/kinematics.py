"""The gear's side: motor, steering wheel and pinion angle must fit (paper 001, (1)), each at the same time.

The steering wheel's sensor has a time of its own: at each of its frames, motor and pinion are taken from their history
for the moment at which it measured. Its own rate is a second witness of it.
"""

from __future__ import annotations

from typing import Any

from gateway.jit import f8, i8, kernel, record

#: History of the frames with motor and pinion.
KEPT = 32
#: A sender's clock is not faster or slower than ours by more than this; and is taken anew after a delay of this [ns].
DRIFT, LATE_NS = 2e-4, 40_000_000

#: When a message with a period was sampled: the earliest time that its frames, one period apart, allow. A frame that waited
#: somewhere on its way does not move it.
CLOCK = record(t_ns=f8, counter=i8, started=i8)

CONST = record(
    motor_ratio=f8,
    wheel_ratio=f8,
    delay_ns=i8,
    age_ns=i8,
    leak=f8,
    jitter=f8,
    angle_ns=f8,
    wheel_ns=f8,
)

#: ``parity``: what is left of (1) [deg, pinion]; ``sure``: the middle one
#: of the last three, less what late frames explain. ``wheel``: the steering wheel's angle
#: less the integral of its rate, forgetting [deg].
STATE = record(
    at=i8,
    kept=i8,
    t_ns=(i8, KEPT),
    motor=(f8, KEPT),
    pinion=(f8, KEPT),
    parity=f8,
    sure=f8,
    before=f8,
    last=f8,
    wheel=f8,
    last_wheel=f8,
    last_rate=f8,
    wheel_ns=i8,
    started=i8,
    angle_clock=CLOCK,
    wheel_clock=CLOCK,
)


@kernel
def sampled_at(s: Any, arrived_ns: int, counter: int, period_ns: float) -> int:
    """Return when a frame was sampled, as its own period tells [ns].

    Args:
        s: record of CLOCK.
        arrived_ns: when it came.
        counter: its alive counter, modulo 16.
        period_ns: of the message.
    """
    due = s.t_ns + ((counter - s.counter) % 16) * period_ns * (1.0 + DRIFT)
    late = s.started == 1 and arrived_ns - due <= LATE_NS
    s.t_ns = min(due, float(arrived_ns)) if late else float(arrived_ns)
    s.counter = counter
    s.started = 1
    return int(s.t_ns)


@kernel
def keep(s: Any, t_ns: int, motor: float, pinion: float) -> None:
    """Take a frame with motor and pinion angle [deg]."""
    s.t_ns[s.at] = t_ns
    s.motor[s.at] = motor
    s.pinion[s.at] = pinion
    s.at = (s.at + 1) % KEPT
    s.kept = min(s.kept + 1, KEPT)


@kernel
def fit(s: Any, c: Any, t_ns: int, wheel: float) -> bool:
    """Compute (1)'s residual for a steering wheel angle [deg] measured at a time; tells whether it could be.

    Frames on both sides of that moment are needed; the wheel's delay makes them likely to be there. Without a later
    one the newest two are extrapolated, not further than ``age_ns``. :func:`follow` comes first.
    """
    if s.kept < 2:
        return False
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
    # What a frame that was late on the bus makes of a turning wheel.
    slack = c.jitter * abs(s.last_rate) / c.wheel_ratio
    # One that was is not like those before and behind it.
    one, two, three = s.before, s.last, s.parity
    s.before, s.last = s.last, s.parity
    middle = max(min(one, two), min(max(one, two), three))
    s.sure = middle - min(max(middle, -slack), slack)
    return True


@kernel
def follow(s: Any, c: Any, t_ns: int, wheel: float, rate: float) -> None:
    """Compare the steering wheel's step [deg] with its rate [deg/s]."""
    if s.started == 1:
        dt = (t_ns - s.wheel_ns) * 1e-9
        odd = wheel - s.last_wheel - 0.5 * (rate + s.last_rate) * dt
        s.wheel += odd - min(c.leak * dt, 1.0) * s.wheel
    s.started = 1
    s.last_wheel, s.last_rate, s.wheel_ns = wheel, rate, t_ns


@kernel
def now(s: Any, c: Any, t_ns: int) -> float:
    """Return the steering wheel's angle at a time, continued with its rate [deg]."""
    age = (t_ns - s.wheel_ns + c.delay_ns) * 1e-9
    return float(s.last_wheel + s.last_rate * age)
