"""The adaptive method: acquisition, hypotheses about every pulse, learned wheel, isolation.

See :mod:`gateway_plants.crank.pulse_tracking` for the observer. It keeps the paper's form - observer, input
generator, residual, correction - with the time of the next pulse as its output, so that it holds
while the speed changes.
"""

from __future__ import annotations

import numpy as np

from gateway_fdi.jit import f8s, kernel
from gateway_plants.crank import wheel_estimation, wheel_pairs
from gateway_plants.crank.monitor import anchor, defects, no_gap, noise, reversal, wrong_wheel
from gateway_plants.crank.monitor.faults import Reports
from gateway_plants.crank.monitor.isolation import decide, fall_noisy, lose
from gateway_plants.crank.monitor.place_proof import hold_to_gap, prove
from gateway_plants.crank.monitor.silence import fall_silent, steady
from gateway_plants.crank.monitor.sync_state import (
    CONFIRMED,
    SEARCHING,
    TENTATIVE,
    Const,
    State,
    doubt,
    laid,
    search,
    unlearned,
    waver,
)
from gateway_plants.crank.monitor.turns import decided, turned, turned_back
from gateway_plants.crank.monitor.unproven import UNSEEN_PULSES, unwatched, wait
from gateway_plants.crank.pulse_tracking import profile
from gateway_plants.crank.pulse_tracking.acquisition import restart, seek
from gateway_plants.crank.pulse_tracking.branching import MOST_MISSED
from gateway_plants.crank.pulse_tracking.hypotheses import HOPELESS, RING, Limits, Pulses, short, take
from gateway_plants.crank.pulse_tracking.tracker import (
    agreed,
    begin,
    best,
    jump,
    keep_reported,
    reported,
    shift,
    slowest,
    transfer_ripple,
    unanimous,
)

#: Mean cost of a pulse [nat] above which the hypotheses are given up.
MOST_MEAN_COST = 8.0
#: Pulses that no frame brought, below which they fall no more, as :data:`LEAST_COST` does.
LEAST_UNSEEN = 1e-9
#: Least time between two pulses, and of a pitch [us]: a frame may tell of none.
LEAST_US = 0.1
#: Regular pulses in a row by which the time of a pitch is known while no place is.
REGULAR = 4
#: An engine does not slow down by this factor from one tooth to the next.
ABRUPT = 4.0
#: The neighbours of the largest gap, so many on each side, are never taken the short way.
NEAR = 2
#: Variance of the edges [pitch^2] below which intervals are those of a wheel of equal pitches.
MOST_UNEVEN = 0.2**2 / 2.0
#: Largest pitch from which on a whole turn tells the place: a smaller one is what defects make of other places, too.
MARK = 1.3
#: A pulse so much later [pitch] than the last tooth that can be counted is behind more of them.
BEYOND = 0.45


@kernel
def lost(s: State, c: Const, number: int, counted: bool, out: Reports) -> None:
    """Pass over pulses whose times were lost on the bus: they were there, unseen.

    A tooth missed among them would not be known: the place is not proven any more, until a gap is seen where it is
    expected. If their number is not known (not ``counted``), what came before says nothing of what comes.
    """
    unwatched(s, c, number, out)
    wheel_estimation.skip(s.seen)
    wheel_pairs.skip(s.pairs)
    if s.burst.count > 0:
        noise.tell(s.burst, c.firing_us, out)
        search(s, c)
    _pass_over(s, c, defects.passed(s.defects, c.pulses, int(s.index), number, int(s.teeth)))
    if not counted:
        anchor.skip(s.anchor, c.anchor.length, c.pulses + anchor.EDGES)
    no_gap.clear(s.waiting)  # what the bus lost is no reason to blame the sensor


@kernel
def _pass_over(s: State, c: Const, number: int) -> None:
    """Go on by teeth that passed without an interval of their own; the gap has to prove the place again."""
    anchor.skip(s.anchor, c.anchor.length, number)
    if s.phase == SEARCHING:
        restart(s.search)
        s.held_fault = -1
    else:
        jump(s.tracker, c.pulses, number)
        s.revolutions += (s.index + number) // c.pulses
        s.index = best(s.tracker).index
        waver(s)
        s.hole = 1
    s.y1 = 0.0
    s.y2 = 0.0
    s.reversal.index = -1


@kernel
def recount(s: State, c: Const, number: int) -> None:
    """Put the index right by pulses that were lost on the bus and counted wrongly."""
    if number != 0 and s.phase != SEARCHING:
        shift(s.tracker, c.pulses, number)
        s.revolutions += (s.index + number) // c.pulses
        s.index = best(s.tracker).index
        doubt(s)
        anchor.skip(s.anchor, c.anchor.length, c.pulses + anchor.EDGES)
        s.hole = 1


@kernel(inlined=False)
def tooth(s: State, c: Const, y: float, out: Reports) -> None:
    """Take one interval between two pulses.

    Args:
        s: record of State.
        c: record of Const.
        y: interval [us].
        out: record of Out.
    """
    y = max(y, LEAST_US)
    s.teeth += 1
    _see(s, 1)
    if s.burst.count > 0:
        _wait_for_end(s, c, y, out)
        return
    anchor.note(s.anchor, c.anchor.length, y)
    if s.looks == 1:
        wrong_wheel.note(s, c, y, out)
    if s.wrong == 1:
        return
    shows = c.even == 0 and c.turns == 1  # a wheel of few pulses looks the same turned back
    if shows and s.reversal.index >= 0 and reversal.seen(s.reversal, c.pulses, c.gap, s.y2, s.y1, y):
        reversal.tell(s.reversal, out, c.told == 1)
        search(s, c)
    if s.phase == SEARCHING:
        _watch_noise(s, c, y)
        _seek(s, c, y)
    else:
        period = best(s.tracker).period
        noise.note(s.burst, s.teeth, y, period)
        crowded = noise.crowd(s.burst, s.teeth) >= noise.BURST  # the time of a pitch may be that of its pulses
        silent = not crowded and y > (MOST_MISSED + 1) * period and _silent(s, c, y, slowest(s.tracker))
        _watch_turning(s, c, y)
        if silent and s.reversal.stood == 1:
            search(s, c)
        elif silent:
            fall_silent(s, c, out, y / period)
        else:
            _track(s, c, y, out)
            if s.phase != SEARCHING:
                hold_to_gap(s, c, y, out)
    if s.phase != CONFIRMED:
        wait(s, c, y, out)
    s.y2 = s.y1
    s.y1 = y


@kernel
def _watch_noise(s: State, c: Const, y: float) -> None:
    """Look for a burst while no place is known: pulses closer than half the pitch of regular ones before them."""
    if s.seen.run < REGULAR or c.pulses < anchor.FEW:
        return
    noise.note(s.burst, s.teeth, y, s.seen.pitch)
    count = noise.crowd(s.burst, s.teeth)
    if count >= noise.BURST and noise.close(s.burst, c.firing_us):
        noise.begin(s.burst, count, s.burst.crowd_us, s.seen.pitch, 0.0, -1)
        wheel_estimation.skip(s.seen)


@kernel
def _wait_for_end(s: State, c: Const, y: float, out: Reports) -> None:
    """Wait for the end of a burst; then go on by the time that has passed, or look for the place again."""
    if noise.goes_on(s.burst, y, c.firing_us, out):
        return
    number = 0
    s.burst.told = s.teeth
    if s.burst.known == 1:
        number = noise.passed(s.burst, best(s.tracker), s.tracker.pitches, c.pulses)
    if number == 0:
        search(s, c)
    defects.clear(s.defects)
    _pass_over(s, c, max(number, 1))


@kernel
def regular(s: State, c: Const, us: f8s, first: int, last: int) -> int:
    """Take the pulses that are the next teeth beyond doubt, away from the gap, up to one that is not.

    The same as :func:`tooth` does for them, without what that only does elsewhere.

    Args:
        s: record of State.
        c: record of Const.
        us: intervals [us].
        first: of them, where to begin.
        last: where to end at the latest.

    Returns:
        how many were taken.
    """
    pr, index = s.profile, int(s.index)
    if s.phase != CONFIRMED or s.looks == 1 or index < NEAR or pr.ended == 1 or s.reversal.index >= 0:
        return 0
    last = min(last, first + c.pulses - NEAR - index, first + c.pulses + 1 - s.anchor.age)
    learned = pr.turns > 0
    limits = Limits(c.longest_us, 1.0 / pr.slow if learned else 0.0, 1.0 / pr.fast if learned else np.inf)
    taken = short(s.tracker, Pulses(us, first, last), limits, s.residuals, s.teeth)
    at, size, total, y1, y2 = int(s.anchor.at), int(c.anchor.length), pr.turn_us, s.y1, s.y2
    for k in range(first, first + taken):
        y = us[np.uint64(k)]
        at = anchor.put(s.anchor, at, size, y)
        pr.intervals[np.uint64(index)] = y
        total += y
        index += 1
        y1, y2 = y, y1
    s.anchor.at, pr.turn_us, s.y1, s.y2 = at, total, y1, y2
    s.anchor.age += taken
    _see(s, taken)
    s.teeth += taken
    s.index = index
    s.since += taken
    return taken


@kernel
def _see(s: State, number: int) -> None:
    """Let the pulses that no frame brought lie further back, by as many that have come."""
    if s.unseen > LEAST_UNSEEN:
        s.unseen = max(s.unseen * (1.0 - 1.0 / UNSEEN_PULSES) ** number, LEAST_UNSEEN)


@kernel
def _apart(c: Const, one: int, next_one: int) -> float:
    """Return the pitches from the middle of a slot to the middle of the next one."""
    return float(0.5 * (c.wheel.nominal[one] + c.wheel.nominal[next_one]))


@kernel
def _silent(s: State, c: Const, y: float, period: float) -> bool:
    """Tell whether an interval [us] goes beyond the last tooth that hypotheses count to.

    The truth must be among the hypotheses: of nine pulses missed, eight and a late edge would win, and the index be
    wrong by one. An engine that nearly stands is given more.
    """
    span, slot = 0.0, int(s.index)
    for _ in range(MOST_MISSED + 1):
        span += s.tracker.pitches[slot]
        slot = slot + 1 if slot + 1 < c.pulses else 0
    most = span + BEYOND if period < c.slowest_us / ABRUPT else (MOST_MISSED + 1 + c.gap) * ABRUPT
    return bool(y > most * period)


@kernel
def _watch_turning(s: State, c: Const, y: float) -> None:
    """Look whether the engine may have turned back in an interval [us]; then its place is doubted."""
    re, pitches = s.reversal, s.tracker.pitches
    behind = s.index - 1 if s.index > 0 else c.pulses - 1
    before = behind - 1 if behind > 0 else c.pulses - 1
    u2, u1, u = s.y2 / pitches[before], s.y1 / pitches[behind], y / pitches[s.index]
    crowded = noise.crowd(s.burst, s.teeth) >= noise.BURST  # intervals of a burst are no engine's
    if c.teeth >= anchor.FEW and reversal.slow(c.turn_us, s.y1, y):  # fewer are as far apart at any starter's speed
        re.slow = 1
    stopping = not crowded and reversal.stopping(c.turn_us, pitches[s.index], u2, u1, u, s.tracker.variance)
    if stopping or min(u, best(s.tracker).period) > c.slowest_us:
        reversal.begin(re, c.pulses, s.index, y)
        doubt(s)
        re.stood = 1
        s.held_fault = -1


@kernel
def _seek(s: State, c: Const, y: float) -> None:
    """Look for the place on the wheel."""
    if reversal.stopping(c.turn_us * c.gap, 1.0, s.y2, s.y1, y, s.tracker.variance):
        s.reversal.stood = 1
        restart(s.search)
    if s.held_fault >= 0 and (s.reversal.stood == 1 or not steady(s, c, y)):
        s.held_fault = -1
    se = s.search
    index = seek(se, c.logs, c.repeats, y)
    if index < 0 and c.gap > MARK and se.seen > c.pulses and se.seen % (c.pulses - 1) == 0:
        index = laid(s, c)
        se.period, se.growth, se.variance = s.seen.pitch, 0.0, s.seen.variance / 2.0
    if index >= 0 and (c.even == 0 or se.variance < MOST_UNEVEN):
        begin(s.tracker, index, se.period, se.growth, se.variance)
        s.tracker.wander = unlearned(c, se.period)
        s.phase = TENTATIVE
        s.index = index
        s.since = 0
        s.suspects = 0
        s.recurring = 0
        defects.clear(s.defects)
        s.profile.clean = 0
        s.profile.turn_us = 0.0
        anchor.restart(s.anchor)
        s.sure = 1 if anchor.shows(s.anchor, c.anchor, index) else 0


@kernel
def _track(s: State, c: Const, y: float, out: Reports) -> None:
    """Follow the wheel by one pulse."""
    tr = s.tracker
    before = int(s.index)
    cost = take(tr, c.pulses, c.acceleration, c.ripple, y)
    s.residuals[s.teeth & (RING - 1)] = tr.residual
    if not (cost <= HOPELESS and tr.mean_cost <= MOST_MEAN_COST and best(tr).period > LEAST_US):
        count = noise.crowd(s.burst, s.teeth)
        if count >= noise.BURST and (s.reversal.stood == 0 or noise.close(s.burst, c.firing_us)):
            fall_noisy(s, c, count)
        else:
            lose(s, c, out, cost)
        return
    if tr.open > 5 * c.pulses // 2:
        if not unanimous(tr):
            waver(s)  # what is chosen is not proven
        keep_reported(tr)
    h = reported(tr)
    s.index = h.index
    s.since += 1
    behind = s.index - 1 if s.index > 0 else c.pulses - 1
    old_behind = profile.smooth(s.profile, behind)
    old_ahead = profile.smooth(s.profile, s.index)
    profile.follow(s.profile, c.wheel, h.period, tr.pitches)
    profile.note_pulse(s.profile, tr.pitches, c.pulses, before, s.index, h.associated == 1, y)
    first = best(tr)
    if first.associated == 1 and (first.missed != 0 or first.added != 0) and agreed(tr):
        s.index = first.index
        decide(s, c, out)
        if s.phase == SEARCHING:
            return
    if s.index < before and before - s.index > c.pulses // 2:
        turned(s)
    elif s.index > before and s.index - before > c.pulses // 2:
        turned_back(s)
    if s.profile.ended == 1:
        decided(s, c, out)
    new_behind = profile.smooth(s.profile, behind)
    new_ahead = profile.smooth(s.profile, s.index)
    if new_behind != old_behind or new_ahead != old_ahead:
        transfer_ripple(tr, old_behind - new_behind, old_ahead - new_ahead, _apart(c, behind, s.index))
    if s.phase == TENTATIVE and (s.hole == 0 or c.even == 1) and agreed(tr):
        prove(s, c, out)
