"""Plausibility of any signal: one step a frame looks at the signals that it carries, and at no others.

A value that is none (an invalid code, all bits set, one that the database does not know) says so and is not tested
further, nor remembered; one beyond what its circuit can give is not tested for plausibility. So a broken wire is one
fault.

The scatter is that of second differences: d_k = x_k - 2 x_(k-1) + x_(k-2) of a course without corners is noise alone,
with variance 6 sigma^2; sigma^2 is its mean over the samples asked for, divided by 6. They want values of one rhythm:
after a gap (frames lost, rejected, or not heard by the gateway) it starts again.

A multiplexed signal is looked at in the frames that have it.

A change is taken over the usual time between two values, or longer: frames that an adapter hands over together were not
sampled together. One odd frame with silence after it is no limit that was broken for ``failed_ms``: a limit that failed
last is not tested any more when no value has come for half of that, and for longer than the usual time.
"""

from __future__ import annotations

from math import inf, isnan, nan, sqrt
from typing import Any

import numpy as np

from gateway.monitors.contract import TIMER, Blames, Connection, Fault, Monitor, Out, Parts, Signal, report
from gateway_checks.signal.faults import (
    ABOVE,
    ALL_ONES,
    BELOW,
    GRADIENT,
    HIGH,
    INVALID,
    KINDS,
    LOW,
    MISSING,
    NOISE,
    STUCK,
    UNDEFINED,
    blames,
    faults,
    kinds_of,
)
from gateway_checks.signal.params import MOST_LEVELS, MOST_SIGNALS, Params, PartParams
from gateway_checks.signal.parts import parts
from gateway_checks.signal.records import Const, Course, Evidence, Inputs, One, State
from gateway_fdi.jit import kernel

#: Number of usual times between values that make a gap: then the scatter starts again.
GAP = 4.0
#: A failure counts for this share of ``failed_ms`` without another value; where values come seldom, for this multiple
#: of the time between two.
PATIENCE, LATE = 0.5, 1.5
#: Verdicts of a test of movement; OPEN: it could not have failed yet, or is not to be tested here.
PASSED, FAILED, OPEN = range(3)


@kernel
def report_test(out: Any, p: One, s: Course, kind: int, failed: bool, value: float, limit: float, shown: float) -> None:
    """Report a test of a signal, if it is asked for; ``shown`` is its evidence."""
    if p.fault[kind] >= 0:
        evidence = report(out, p.fault[kind], failed, value, limit)
        evidence.value = shown
        evidence.before = s.before
        s.failed = s.failed | (1 << kind) if failed else s.failed & ~(1 << kind)


@kernel
def untested(out: Any, p: One, s: Course, kind: int) -> None:
    """Say of a test that failed last that it is not tested any more."""
    report(out, p.fault[kind], False, nan, nan)
    s.failed = s.failed & ~(1 << kind)


@kernel
def beyond(p: One, s: Course, kind: int, over: float) -> bool:
    """Return whether a limit is broken: from ``over`` > 0 on, until it is kept by the hysteresis."""
    if over > 0.0:
        s.beyond[kind] = 1
    elif over < -p.hysteresis or p.hysteresis == 0.0:
        s.beyond[kind] = 0
    return bool(s.beyond[kind] == 1)


@kernel
def is_none(out: Any, p: One, s: Course, x: float) -> bool:
    """Test whether a value is none; returns True if it is."""
    code = False
    for k in range(p.codes):
        code = code or x == p.code[k]
    known = p.values == 0
    for k in range(p.values):
        known = known or x == p.allowed[k]
    ones = x == p.ones
    report_test(out, p, s, INVALID, code, x, x, x)
    report_test(out, p, s, ALL_ONES, ones and not code, x, p.ones, x)
    report_test(out, p, s, UNDEFINED, not (known or code or ones), x, x, x)
    return code or ones or not known


@kernel
def has_stuck(p: One, s: Course, x: float, other: float, seconds: float, shut: bool) -> int:
    """Return FAILED for a signal that has not moved where it must, PASSED for one that moved, else OPEN."""
    if s.valid == 0 or isnan(s.anchor) or abs(x - s.anchor) > p.stuck_by:
        moved = s.valid > 0 and not isnan(s.anchor)
        s.anchor, s.still_s, s.other = x, 0.0, other
        return PASSED if moved and not shut else OPEN
    if p.moving_by > 0.0:
        return FAILED if abs(other - s.other) >= p.moving_by else OPEN
    s.still_s = 0.0 if shut else s.still_s + seconds
    return FAILED if s.still_s >= p.stuck_s else OPEN


@kernel
def seldom_moves(p: One, s: Course, x: float, usual_s: float, shut: bool) -> int:
    """Return FAILED if too few of a signal's values differ from the one before; ``moved`` is the share that do.

    The share is that of the last ``stuck_s``, each value counting less the older it is; where it need not move, and
    after no value, it begins again from all. OPEN as long as a signal that stands could not have failed yet.
    """
    if s.valid == 0 or shut:
        s.moved = s.least = 1.0
        return OPEN
    weight = min(max(usual_s, 1e-3) / p.stuck_s, 1.0)
    s.moved += weight * ((1.0 if abs(x - s.before) > p.stuck_by else 0.0) - s.moved)
    s.least -= weight * s.least
    if s.least >= p.stuck_share:
        return OPEN
    return FAILED if s.moved < p.stuck_share else PASSED


@kernel
def watch_movement(out: Any, p: One, s: Course, x: float, other: float, seconds: float, usual_s: float) -> None:
    """Test whether a signal moves, where it must: another signal says so, and it is not at the end of its range.

    Elsewhere nothing is tested: a signal that stands there does not pass.
    """
    if (p.moving_by > 0.0 or p.during_low > -inf) and isnan(other):
        return  # another signal: until it comes nothing is known
    shut = p.during_low > -inf and not p.during_low <= other <= p.during_high
    if not p.inside_low < x < p.inside_high:
        s.anchor, s.still_s, s.moved, s.least, shut = nan, 0.0, 1.0, 1.0, True
        verdict = OPEN
    elif p.stuck_share > 0.0:
        verdict = seldom_moves(p, s, x, usual_s, shut)
    else:
        verdict = has_stuck(p, s, x, other, seconds, shut)
    if verdict == OPEN:
        if shut and s.tested == 1:  # else the time of its last result would go on
            untested(out, p, s, STUCK)
            s.tested = 0
        return
    s.tested = 1
    if p.stuck_share > 0.0:
        report_test(out, p, s, STUCK, verdict == FAILED, s.moved, p.stuck_share, x)
    elif p.moving_by > 0.0:
        report_test(out, p, s, STUCK, verdict == FAILED, abs(other - s.other), p.moving_by, x)
    else:
        report_test(out, p, s, STUCK, verdict == FAILED, s.still_s, p.stuck_s, x)


@kernel
def follow_rhythm(s: Course, t_ns: int) -> None:
    """Learn how often values come; a gap, in which the signal is unknown, starts its scatter again."""
    seconds = (t_ns - s.came_ns) * 1e-9
    if s.came_ns > 0:
        if s.usual_s == 0.0:
            s.usual_s = seconds
        elif seconds > GAP * s.usual_s:
            s.even = 0
        s.usual_s += (min(seconds, GAP * s.usual_s) - s.usual_s) / 8.0  # a message that now comes seldom is soon usual
    s.came_ns = t_ns


@kernel
def scatter(p: One, s: Course, x: float) -> float:
    """Return a signal's standard deviation around its course, 0 until there are samples enough."""
    if s.even < 2:
        s.variance = 0.0
        return 0.0
    second = x - 2.0 * s.before + s.second
    weight = max(p.weight, 1.0 / (s.even - 1))
    s.variance += weight * (second * second / 6.0 - s.variance)
    return sqrt(s.variance) if s.even > p.samples else 0.0


@kernel
def look(out: Any, p: One, s: Course, t_ns: int, x: float, other: float) -> None:
    """Test one value of a signal."""
    usual_s = s.usual_s
    follow_rhythm(s, t_ns)
    if is_none(out, p, s, x):
        s.valid = s.even = 0
        return
    seconds = (t_ns - s.before_ns) * 1e-9 if s.valid > 0 else 0.0
    below = beyond(p, s, BELOW, p.electrical_low - x)
    above = beyond(p, s, ABOVE, x - p.electrical_high)
    report_test(out, p, s, BELOW, below, x, p.electrical_low, x)
    report_test(out, p, s, ABOVE, above, x, p.electrical_high, x)
    if not (below or above):
        report_test(out, p, s, LOW, beyond(p, s, LOW, p.low - x), x, p.low, x)
        report_test(out, p, s, HIGH, beyond(p, s, HIGH, x - p.high), x, p.high, x)
    least_s = p.least_s if p.least_s > 0.0 else usual_s
    if s.valid > 0 and least_s > 0.0:
        rate = abs(x - s.before) / max(seconds, least_s)
        report_test(out, p, s, GRADIENT, rate > p.gradient, rate, p.gradient, x)
    if p.fault[STUCK] >= 0:
        watch_movement(out, p, s, x, other, seconds, usual_s)
    if p.fault[NOISE] >= 0:
        deviation = scatter(p, s, x)
        if s.even > p.samples:
            report_test(out, p, s, NOISE, deviation > p.deviation, deviation, p.deviation, deviation)
        s.even += 1
    s.second, s.before, s.before_ns = s.before, x, t_ns
    s.valid += 1


@kernel
def is_there(p: One, selector: Any) -> bool:
    """Return whether a frame has a signal, by the values of its multiplexers, the outermost first."""
    for level in range(p.levels):
        selected = False
        value = selector[level]  # of this frame: it was selected itself; NaN: the frame ends before it
        for k in range(p.ranges[level]):
            selected = selected or p.least[level, k] <= value <= p.greatest[level, k]
        if not selected:
            return False
    return True


@kernel
def watch_absence(out: Any, p: One, s: Course, t_ns: int, there: bool) -> None:
    """Test how long a signal has not been selected while frames of its message came.

    After a pause as long as that nothing is known: the message itself was away.
    """
    seconds = (t_ns - s.frame_ns) * 1e-9
    known = s.frame_ns > 0 and seconds < p.missing_s
    s.frame_ns = t_ns
    s.away_s = s.away_s + seconds if known and not there else 0.0
    if there or s.away_s >= p.missing_s:
        evidence = report(out, p.fault[MISSING], not there, s.away_s, p.missing_s)
        evidence.value = s.away_s


@kernel
def give_up(out: Any, p: One, s: Course, t_ns: int) -> None:
    """Say of the tests that failed last, if no value has come for too long, that they are not tested any more."""
    if s.failed == 0 or t_ns - s.came_ns < patience_ns(p, s):
        return
    for kind in range(len(KINDS)):
        if s.failed & (1 << kind):
            untested(out, p, s, kind)


@kernel
def patience_ns(p: One, s: Course) -> int:
    """Return for how long a result counts without another value."""
    return int(max(p.patience_ns, LATE * s.usual_s * 1e9))


@kernel
def step(s: State, c: Const, u: Inputs, out: Out[Evidence, Any]) -> None:
    """Look at the signals that a frame carries; without a frame, at those that failed last."""
    for k in range(c.signals):
        p, course = c.one[k], s.one[k]
        if u.trigger == TIMER:
            give_up(out, p, course, u.t_ns)
        else:
            there = is_there(p, u.selector[k]) and not isnan(u.value[k])
            if p.fault[MISSING] >= 0:
                watch_absence(out, p, course, u.t_ns, there)
            if there:
                look(out, p, course, u.t_ns, u.value[k], u.other[k])
        if course.failed != 0:
            at_ns = course.came_ns + patience_ns(p, course)
            out.wake_ns = at_ns if out.wake_ns == 0 else min(out.wake_ns, at_ns)


def _connect(p: PartParams) -> dict[str, Connection]:
    values = [Signal(watched.limits.signal, triggers=True, optional=True) for watched in p.watched]
    others: list[Signal | None] = []
    for watched in p.watched:
        asked = watched.limits.stuck
        name = None if asked is None else asked.during or asked.moving
        others.append(None if name is None else Signal(name, optional=True))
    selectors = [
        signal
        for watched in p.watched
        for signal in _filled([Signal(level.multiplexer, optional=True) for level in watched.levels], MOST_LEVELS)
    ]
    return {
        "value": _filled(values, MOST_SIGNALS),
        "other": _filled(others, MOST_SIGNALS),
        "selector": _filled(selectors, MOST_SIGNALS * MOST_LEVELS),
    }


def _filled(signals: list[Any], count: int) -> list[Signal | None]:
    return [*signals, *[None] * (count - len(signals))]


def _prepare(p: PartParams, s: Any, c: Any) -> None:
    c["signals"] = len(p.watched)
    number = 0
    for k, watched in enumerate(p.watched):
        one, limits, course = c["one"][k], watched.limits, s["one"][k]
        one["electrical_low"], one["electrical_high"] = limits.electrical or (-inf, inf)
        one["low"], one["high"] = limits.plausible or (-inf, inf)
        one["hysteresis"] = limits.hysteresis
        one["gradient"] = limits.gradient or inf
        one["least_s"] = (limits.least_step_ms or 0.0) * 1e-3
        one["patience_ns"] = round(PATIENCE * limits.failed_ms * 1e6)
        one["during_low"], one["during_high"] = one["inside_low"], one["inside_high"] = -inf, inf
        if limits.stuck is not None:
            one["stuck_s"], one["stuck_by"] = limits.stuck.seconds or inf, limits.stuck.by
            one["during_low"], one["during_high"] = limits.stuck.within or (-inf, inf)
            one["inside_low"], one["inside_high"] = limits.stuck.inside or (-inf, inf)
            one["stuck_share"] = limits.stuck.share or 0.0
            one["moving_by"] = limits.stuck.moving_by or 0.0
        if limits.noise is not None:
            one["deviation"], one["samples"] = limits.noise.deviation, limits.noise.samples
            one["weight"] = 1.0 / limits.noise.samples
        one["ones"] = nan if watched.ones is None else watched.ones
        one["codes"], one["values"] = len(watched.codes), len(watched.values)
        one["code"][: len(watched.codes)] = watched.codes
        one["allowed"][: len(watched.values)] = watched.values
        one["missing_s"] = (limits.missing_ms or 0.0) * 1e-3
        one["levels"] = len(watched.levels)
        for level, selector in enumerate(watched.levels):
            one["ranges"][level] = len(selector.ranges)
            for at, (least, greatest) in enumerate(selector.ranges):
                one["least"][level, at], one["greatest"][level, at] = least, greatest
        one["fault"] = -1
        for kind in kinds_of(watched):
            one["fault"][kind] = number
            number += 1
        course["moved"] = course["least"] = 1.0
        course["before"] = course["second"] = course["anchor"] = course["other"] = np.nan


def _faults(p: Any) -> tuple[Fault, ...]:
    return faults(p)


MONITOR = Monitor(
    type="signal",
    api=2,
    params=Params,
    state=State,
    const=Const,
    inputs=Inputs,
    evidence=Evidence,
    step=step,
    connect=_connect,  # type: ignore[arg-type] # of its parts
    prepare=_prepare,  # type: ignore[arg-type]
    faults=_faults,
    capabilities=(Blames(blames), Parts(parts)),
)
