"""A revolution that has ended: speed, learning, what passed in it, doubled edges, and the wheel as it was learned."""

from __future__ import annotations

from gateway.monitors.contract import report
from gateway_fdi.jit import kernel
from gateway_plants.crank.monitor import defects, runout
from gateway_plants.crank.monitor.faults import (
    CAM_CORRELATION,
    CAM_SILENT,
    DAMAGED,
    DOUBLED,
    RUNOUT,
    WRONG_WHEEL,
    Reports,
)
from gateway_plants.crank.monitor.sync_state import CONFIRMED, Const, State, speed, tooth_of, unlearned
from gateway_plants.crank.pulse_tracking import profile
from gateway_plants.crank.pulse_tracking.motion import Q3
from gateway_plants.crank.pulse_tracking.tracker import COARSE, agreed, best, expect_less

#: Share of the teeth with a second pulse from which on the edges are doubled.
DOUBLE_SHARE = 0.25
#: Teeth with a second pulse that one disturbance may leave.
DOUBLED_AT_ONCE = 3
#: Revolutions that the pitches must have been learned from before they are believed.
LEARNED = 3
#: Runout and single teeth are judged above this speed, where torsional ripple is small [rpm].
RUNOUT_RPM = 800.0
#: A tooth is damaged when it is off by more than the least of these [pitch], and by so many standard deviations of the
#: other teeth, but at the most by this.
BENT, BENT_SIGMAS, BENT_MOST = 0.17, 5.5, 0.3
#: Turns in a row without a fault that only the configured wheel has.
FITTED = 3
#: Process noise of the growth [1/pitch^2] up to which a tooth missed cannot hide in it: over two pitches it makes an
#: error of one pitch, whose cost 1 / (2 HIDES) is above those of a tooth missed and what is undecided beside it.
HIDES = 0.15**2
#: Tooth of the next revolution by which one has to be decided to count.
DECIDED_BY = 4
#: Revolutions in a row with a defect in each, from which on the speed is the filter's, and no clean revolution's.
UNCLEAN = 3


@kernel
def trust(s: State, c: Const) -> None:
    """Trust the pitches as far as they are learned, and as the turns repeat."""
    turns = s.profile.turns
    wander = max(Q3, s.profile.rest * s.profile.rest * c.rest)
    s.tracker.wander = unlearned(c, best(s.tracker).period) if turns == 0 else wander
    for i in range(c.pulses):
        s.tracker.slack[i] = c.slack[i] / (1 + turns * turns)


@kernel
def turned(s: State) -> None:
    """End a revolution, which :func:`decided` takes when its gap is."""
    s.revolutions += 1
    if s.anchor.wins > 0 or (s.anchor.verified == 0 and s.defects.turns == 0):
        s.profile.clean = 0
    profile.end(s.profile)
    expect_less(s.tracker, 1)


@kernel
def turned_back(s: State) -> None:
    """Take the end of a revolution back: the gap had not come yet, after all."""
    s.revolutions -= 1
    s.profile.ended = 0
    s.profile.clean = 0


@kernel
def decided(s: State, c: Const, out: Reports) -> None:
    """Take a revolution that has ended, once the hypotheses agree, at the latest at tooth :data:`DECIDED_BY`.

    A gap that real sensors make longer or shorter than it is leaves a doubt for a pulse or two.
    """
    if not agreed(s.tracker):
        if s.index < min(DECIDED_BY, c.pulses // 2):
            return
        s.profile.ended_clean = 0
    _take_turn(s, c, out)


@kernel
def _take_turn(s: State, c: Const, out: Reports) -> None:
    """Take a revolution: speed, learning, doubled edges, passed results of a clean one, runout, bent teeth.

    One that has only what is missing or added in each turn is learned from, and judged, but passes nothing.
    """
    us = s.profile.ended_us
    before = s.profile.turns
    clean = profile.turn(s.profile, c.wheel, s.tracker.pitches, s.index)
    if s.profile.turns != before or before == 0:
        trust(s, c)
    if s.profile.turns != before:
        runout.take(s.law, 60e6 * c.turns / us, s.profile.even, s.profile.odd)
    quiet = agreed(s.tracker) and s.tracker.variance <= COARSE and s.tracker.wander <= HIDES
    s.fitted = s.fitted + 1 if clean or quiet else 0
    if s.fitted >= FITTED:
        s.known = 1
    doubled = s.doubled
    s.doubled = 0
    if s.phase != CONFIRMED:
        if s.recurring == 1:
            note_speed(s, speed(s, c))
        return
    s.doubling = 1 if doubled > max(DOUBLE_SHARE * c.pulses, DOUBLED_AT_ONCE) else 0
    if s.doubling == 1:
        share = doubled / c.pulses
        d = report(out, DOUBLED, True, share, DOUBLE_SHARE).doubled
        d.share, d.teeth, d.speed = share, s.teeth, speed(s, c)
    s.unclean = 0 if clean else s.unclean + 1
    if clean:
        note_speed(s, 60e6 * c.turns / us)
    elif s.unclean >= UNCLEAN:
        note_speed(s, speed(s, c))
    if not clean:
        return
    if s.teeth - s.uneven > c.pulses + DECIDED_BY:
        s.recent_missed = 0
        s.recent_added = 0
        for fault in range(WRONG_WHEEL + 1):
            if fault not in (RUNOUT, DAMAGED, CAM_CORRELATION, CAM_SILENT):
                report(out, fault, False, 0.0, 0.0)
    if c.turns == 1 and s.profile.turns > LEARNED and s.speed_rpm > RUNOUT_RPM:
        _judge_wheel(s, c, out)


@kernel
def tell_broken(tooth: int, off: float, rpm: float, out: Reports) -> None:
    """Report a tooth (-1: not told which) that each turn has so far off its place [pitch]; 1 and more: so many lack."""
    d = report(out, DAMAGED, True, off, BENT).damaged
    d.tooth, d.off, d.speed = tooth, off, rpm


@kernel
def tell_bent(s: State, c: Const, tooth: int, named: int, out: Reports) -> None:
    """Report a tooth whose edge each turn has far off, as ``named``, unless edges are so noisy that it may be chance.

    How far is what the last turn says, by the places of its neighbours.
    """
    since = (s.index - tooth) % c.pulses
    at = s.anchor.at - 1 - since
    before, behind = s.anchor.intervals[at % c.anchor.length], s.anchor.intervals[(at + 1) % c.anchor.length]
    span = c.wheel.nominal[(tooth - 1) % c.pulses] + c.wheel.nominal[tooth]
    off = before / (before + behind) * span - c.wheel.nominal[(tooth - 1) % c.pulses]
    if abs(off) > max(BENT, BENT_SIGMAS * s.tracker.variance**0.5):
        tell_broken(named, off, speed(s, c), out)


@kernel
def note_speed(s: State, rpm: float) -> None:
    """Note the speed of a revolution [rpm]."""
    s.speed_rpm = rpm
    s.fastest_rpm = max(s.fastest_rpm, rpm)
    if s.slowest_rpm == 0.0 or rpm < s.slowest_rpm:
        s.slowest_rpm = rpm


@kernel
def _judge_wheel(s: State, c: Const, out: Reports) -> None:
    """Judge the wheel as it was learned: off centre, a tooth out of its place."""
    learned_rpm = 60e6 / (s.profile.period * c.wheel.whole)
    amplitude, most = runout.geometry(s.law, learned_rpm, s.profile.first, c.runout)
    if profile.tells_runout(c.wheel):
        r = report(out, RUNOUT, amplitude > most, amplitude, most).runout
        r.amplitude, r.tooth = amplitude, tooth_of(s, c, s.profile.worst)
        r.speed = s.speed_rpm
    off = s.profile.off
    limit = max(BENT, min(BENT_SIGMAS * s.profile.scatter, BENT_MOST))
    if abs(off) <= limit and defects.of_wheel(s.defects):
        return  # a tooth is damaged: it is missing, or too far off to be learned
    d = report(out, DAMAGED, abs(off) > limit, abs(off), limit).damaged
    d.tooth, d.off, d.speed = tooth_of(s, c, s.profile.bent), off, s.speed_rpm
