"""Where on the wheel the latest pulse was: the state of the adaptive method, and how it is set up and lost."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from gateway.monitors.contract import report
from gateway_fdi.jit import Record, f8, f8s, i4, i8, kernel, means, u1
from gateway_plants.crank.monitor import anchor, candidate_wheels, competing_hypothesis, defects, no_gap, noise
from gateway_plants.crank.monitor.faults import RESIDUALS, Reports, Shape
from gateway_plants.crank.monitor.reversal import Reversal
from gateway_plants.crank.monitor.runout import ALLOWED, ALLOWED_RPM, FIRING_RPM, Law
from gateway_plants.crank.pulse_tracking.acquisition import Search, restart
from gateway_plants.crank.pulse_tracking.hypotheses import RING
from gateway_plants.crank.pulse_tracking.profile import (
    MOST_ORDERS,
    REST_ORDER,
    LearnedWheel,
    Profile,
    forget,
    harmonics,
)
from gateway_plants.crank.pulse_tracking.tracker import AGAIN, Tracker, best, expect_less, unanimous
from gateway_plants.crank.wheel import MOST_TEETH, Wheel
from gateway_plants.crank.wheel_estimation import LEAST_PULSES, Seen, skip
from gateway_plants.crank.wheel_pairs import Pairs
from gateway_plants.crank.wheel_pairs import skip as skip_pairs

#: Synchronisation: none, a place that one more revolution has to prove, proven.
SEARCHING, TENTATIVE, CONFIRMED = range(3)
#: Number of a pulse long ago.
NEVER = -1_000_000
#: Torsional ripple that an engine may have before it is learned (2 per revolution), and the error of the
#: pitches at a gap [pitch].
RIPPLE, GAP_ERROR = 0.05, 0.1
#: Ripple that has to be followed while it is not learned: amplitude at a speed [rpm] (it falls with the square of the
#: speed, down to RIPPLE), and order per revolution. At a lower speed than so many times less it grows no more: to an
#: amplitude of 0.18. More would follow a pulse missed or an engine that turned back as if it were ripple.
UNLEARNED, UNLEARNED_RPM, UNLEARNED_ORDER, SLOWER = 0.08, 720.0, 3.0, 1.5
#: An engine that stops brakes at most so many times harder than ``acceleration`` says. From a speed v [pitch/s] it
#: comes to rest within v^2 / 2 a pitches: one that would need two pitches or more, turns on behind the next tooth.
BRAKE = 4.0
#: A pitch that is less than this share of the one before is short: with ripple it may look like a pulse too many.
SHORT = 0.7
#: Ripple of the speed that an engine may have at most, amplitude (it falls with the square of the speed, as
#: :data:`runout.ALLOWED` says), and how many times that much two places have to be apart by their contrasts.
MOST_RIPPLE, CONTRASTS = 0.4, 5.0
#: How the cam's edges have told the place of a wheel of equal pitches: not yet, or they have; a wheel with a gap tells
#: its place itself.
NOT_TOLD, BY_CAM, BY_GAP = range(3)
#: What goes out for a place that is not told: the speed is followed, and no place is known.
SPEED_ONLY = 3
#: Pulses of a turn below which one too many in each turn makes the edges look as if they were noisy.
MARKED = 24
#: An engine that turns back, in a compression that it does not come over, has up to so many times ``acceleration``.
KICK = 2.0


class Const(Record):
    """Constants.

    The wheel is as it is laid out (see :attr:`gateway_plants.crank.wheel.Wheel.laid_out`). In an interval
    longer than ``longest_us`` the engine may turn back, or stand. No turn longer than ``proof_us`` proves a place: on a
    wheel of few pulses a slower engine's ripple may be as large as what tells the places from each other.
    """

    pulses: i4 = means("pulses of the wheel")
    teeth: i4 = means("pulses of a turn")
    turns: i4 = means("turns that the wheel is laid out over")
    turn: f8 = means("pitches of a turn")
    even: u1 = means("1: its pitches are equal")
    seen: u1 = means("1: its pulses alone show it (:mod:`gateway_plants.crank.wheel_estimation`)")
    rest: f8 = means("process noise of the growth that ripple needs while it is not learned, by its amplitude squared")
    proof_us: f8 = means("longest turn by which a place is proven", "us")
    repeats: i4 = means("pulses after which the pattern repeats")
    acceleration: f8 = means("that the engine can have", "pitch/s^2")
    ripple: f8 = means("growth that torsional ripple can have", "1/pitch")
    unlearned: f8 = means("process noise of the growth while ripple is not learned")
    unlearned_us: f8 = means("time of a pitch at which unlearned holds", "us")
    usual: f8 = means("process noise of the growth, at least")
    runout: f8 = means("amplitude that is a fault, a share of the pitch")
    slowest_us: f8 = means("time of a pitch from which on the engine may have turned back", "us")
    longest_us: f8 = means("longest interval of a regular pulse", "us")
    turn_us: f8 = means("least time over one pitch of an engine that turns back", "us")
    told: u1 = means("1: an engine that turns back is reported")
    short: f8 = means("share of the wheel's own pitches that are much shorter than the one before")
    gap: f8 = means("largest pitch", "pitch")
    turning_us: f8 = means("time of a pitch below which an engine does not come to rest in a silence", "us")
    firing_us: f8 = means("time of a pitch at the least speed of an engine that fires", "us")
    wheel: LearnedWheel = means("what the profile knows of the wheel")
    made: candidate_wheels.Const = means("wheels that are made")
    turned: anchor.Const = means("the gap as an anchor in the pulses that reversed polarity makes")
    polar: u1 = means("1: these are others than the wheel's")
    anchor: anchor.Const = means("the gap as an anchor")
    logs: Annotated[f8s, MOST_TEETH] = means("logarithms of the pitches")
    slack: Annotated[f8s, MOST_TEETH] = means("variance of the pitches while they are not learned", "pitch^2")


class State(Record):
    """State."""

    phase: i4 = means("what is known of the place: SEARCHING to CONFIRMED")
    placed: u1 = means("how the place is told, once it is: NOT_TOLD, BY_CAM, BY_GAP")
    index: i4 = means("latest tooth")
    since: i8 = means("pulses tracked without a doubt")
    teeth: i8 = means("pulses so far")
    revolutions: i8 = means("turns so far")
    suspects: i4 = means("how often came what does not come in each turn")
    defects: defects.Defects = means("what may come in each turn")
    recurring: u1 = means("1: it does")
    refused: i4 = means("places since one was proven")
    sure: u1 = means("1: the gap was seen where the place was found")
    held_fault: i4 = means("fault that a tentative place found; -1: none")
    held: Shape = means("its evidence")
    residuals: Annotated[f8s, RING] = means("residuals of the last pulses, each at its number modulo RING", "pitch")
    missed: i8 = means("pulses missed at proven places")
    added: i8 = means("pulses added at proven places")
    corrections: i8 = means("pulses missed less those added")
    losses: i8 = means("places lost")
    recent_missed: i8 = means("pulses missed since the last clean turn, at other teeth than each turn")
    recent_added: i8 = means("pulses added since the last clean turn, at other teeth than each turn")
    doubled: i8 = means("teeth of this turn with a second pulse")
    doubling: u1 = means("1: the last turn had many of these")
    hole: i4 = means("1: frames were lost, and the gap was not seen since")
    twice: u1 = means("since the engine stood, 1: no gap was seen, 2: the pulses have fitted two places")
    burst: noise.Burst = means("pulses within one tooth")
    rival: competing_hypothesis.CompetingHypothesis = means("another place that explains missing teeth as well")
    seen: Seen = means("wheel that the pulses show")
    looks: u1 = means("1: the wheel is looked at, as it is seen (:mod:`.wrong_wheel`)")
    wrong: u1 = means("1: it is a wrong one")
    filled: u1 = means("1: its gap is filled each turn")
    known: u1 = means("1: the wheel was once shown to be the configured one")
    fitted: i4 = means("turns in a row without a fault")
    looked: i8 = means("pulses that were looked at before")
    pairs: Pairs = means("intervals that alternate")
    unseen: f8 = means("pulses that no frame brought, lately")
    decided: i8 = means("pulse at which missed or added ones were last decided")
    burst_missed: i4 = means("pulses missed that were decided together")
    burst_added: i4 = means("pulses added that were decided together")
    burst_tooth: i4 = means("tooth of the first of these")
    unclean: i4 = means("revolutions in a row with a defect")
    doubted: i8 = means("pulse at which a proven place was doubted")
    uneven: i8 = means("pulse at which pulses were last found missed or added, since the cam told the place")
    speed_rpm: f8 = means("speed of the last turn", "rpm")
    slowest_rpm: f8 = means("slowest speed so far; 0: none", "rpm")
    fastest_rpm: f8 = means("fastest speed so far", "rpm")
    y1: f8 = means("interval before this one; 0: not known", "us")
    y2: f8 = means("interval before that; 0: not known", "us")
    reversal: Reversal = means("whether the engine may have turned back")
    anchor: anchor.State = means("the gap as an anchor")
    waiting: no_gap.Waiting = means("pulses without a proven place")
    law: Law = means("runout against torque")
    tracker: Tracker = means("hypotheses about the latest pulse")
    search: Search = means("which place the last intervals show")
    profile: Profile = means("pitches as the engine shows them")


def prepare(s: State, c: Const, wheel: Wheel, acceleration: float, runout: float, reversal_rpm: float) -> None:
    """Fill state and constants.

    Args:
        s: record of State.
        c: record of Const.
        wheel: the wheel.
        acceleration: that the engine can have [rpm/s].
        runout: variation of the pitch once a revolution that is a fault, amplitude as a share.
        reversal_rpm: below this speed the engine may have turned back [rpm].
    """
    laid = wheel.laid_out
    pitches = np.asarray(laid.pitches)
    count = len(pitches)
    c.pulses, c.teeth, c.turns, c.turn = count, wheel.pulses, wheel.tiles, wheel.turn
    c.even = wheel.even
    c.repeats = wheel.repeats
    c.acceleration = acceleration / 60 * wheel.turn
    few = wheel.tiles > 1
    c.ripple = RIPPLE * 2 * (wheel.turn / 2 if few else 2) * (2 * np.pi / wheel.turn)
    c.unlearned = _changes(UNLEARNED, UNLEARNED_ORDER, wheel)
    c.usual = _changes(RIPPLE, 2.0, wheel)
    c.unlearned_us = 60e6 / (UNLEARNED_RPM * wheel.turn)
    c.rest = _changes(1.0, REST_ORDER, wheel)
    c.proof_us = 60e6 / proof_rpm(wheel)
    c.runout = runout
    c.slowest_us = 60e6 / (reversal_rpm * wheel.turn)
    c.turn_us = min(1e6 / np.sqrt(KICK * c.acceleration), c.slowest_us)
    c.longest_us = c.turn_us
    c.gap = pitches.max()
    c.short = float(np.mean(pitches < SHORT * np.roll(pitches, 1)))
    c.firing_us = 60e6 / (FIRING_RPM * wheel.turn)
    c.turning_us = 1e6 / np.sqrt(2 * BRAKE * c.acceleration * 2.0)
    anchor.prepare(c.anchor, pitches)
    _prepare_polarity(c, pitches)
    if wheel.tiles == 1:
        candidate_wheels.prepare(c.made, wheel)
    c.seen = wheel.tiles == 1 and wheel.repeats >= LEAST_PULSES and bool(np.all(pitches * 2 % 1 == 0))
    c.logs[:count] = np.log(pitches)
    gap = (pitches > 1.3) | (pitches < 0.7)
    gap |= np.roll(gap, 1)
    c.slack[:count] = np.where(gap, GAP_ERROR**2, 0.0)
    wh = c.wheel
    wh.gap[:count] = gap
    wh.pulses, wh.whole = count, laid.turn
    wh.lone = wheel.lone
    wh.orders = 0 if few else min(MOST_ORDERS, count // 5)
    wh.nominal[:count] = pitches
    wh.place[:count] = laid.positions
    middle = 2 * np.pi * (np.asarray(laid.positions) + pitches / 2) / laid.turn
    harmonics(wh, middle)
    tr = s.tracker
    tr.pitches[:count] = pitches
    tr.slack[:] = c.slack
    tr.wander = c.unlearned
    s.held_fault = -1
    s.looks = 1
    s.placed = NOT_TOLD if wheel.even else BY_GAP
    s.rival.other = competing_hypothesis.NONE
    s.defects.next = -1
    s.doubted = NEVER
    s.uneven = NEVER
    s.burst.told = NEVER
    s.reversal.index = -1


def _prepare_polarity(c: Const, pitches: NDArray[np.float64]) -> None:
    """Fill what the sensor shows with its wires exchanged: pulses in the middle between teeth, not at their middle."""
    between = (pitches + np.roll(pitches, -1)) / 2
    anchor.prepare(c.turned, between)
    same = any(np.allclose(np.roll(between, k), pitches, atol=0.1) for k in range(len(pitches)))
    c.polar = c.turns == 1 and not c.even and not same


def _changes(amplitude: float, order: float, wheel: Wheel) -> float:
    """Return the process noise of the growth per pitch that a ripple of the speed needs.

    Between teeth the squared speed ``1 + 2 A sin(2 pi n k / S)`` grows by ``4 A sin(pi n / S) cos(..)``, which changes
    from one pitch to the next by up to ``8 A sin^2(pi n / S)``: most where a pitch is half a wave.

    Args:
        amplitude: A, of the speed.
        order: n, per turn.
        wheel: the wheel, of S pitches a turn; one of few pulses may have a wave of two pitches.
    """
    half = min(order / wheel.turn, 0.5) if wheel.tiles == 1 else 0.5
    return float((8.0 * amplitude * np.sin(np.pi * half) ** 2) ** 2)


def proof_rpm(wheel: Wheel) -> float:
    """Return the speed from which on the intervals of a wheel of few pulses prove a place [rpm]; 1: no limit.

    A place is mistaken for another one only if ripple changes the contrasts of the intervals by half of what tells the
    two apart. A ripple of amplitude A changes one by up to 2 A.
    """
    if wheel.even or wheel.tiles == 1:
        return 1.0
    logs = np.log(np.asarray(wheel.pitches))
    contrasts = logs - (np.roll(logs, 1) + np.roll(logs, -1)) / 2
    apart = min(float(np.abs(contrasts - np.roll(contrasts, k)).max()) for k in range(1, wheel.repeats))
    most = apart / CONTRASTS
    return 1.0 if most > MOST_RIPPLE else ALLOWED_RPM * float(np.sqrt(ALLOWED / most))


@kernel
def decides(s: State, c: Const) -> bool:
    """Return whether the engine is fast enough for the intervals to tell the place."""
    return bool(best(s.tracker).period * c.turn <= c.proof_us)


@kernel
def unlearned(c: Const, period: float) -> float:
    """Return the process noise of the growth that ripple needs while it is not learned, at a pitch time [us]."""
    share = min(period / c.unlearned_us, SLOWER)
    return float(max(c.unlearned * share * share * share * share, c.usual))


@kernel
def laid(s: State, c: Const) -> int:
    """Return the tooth of the latest pulse by the last turn, laid onto the wheel with its defects; NONE: not known."""
    period, variance = best(s.tracker).period, s.tracker.variance
    if s.phase == SEARCHING:
        period, variance = s.seen.pitch, s.seen.variance / 2.0
    if period == 0.0:
        return competing_hypothesis.NONE
    return competing_hypothesis.place(s.anchor, c.anchor.length, c.wheel, c.repeats, period, variance)


@kernel
def search(s: State, c: Const) -> None:
    """Give the place on the wheel up, and what was learned at it, and look for it again."""
    if s.phase == CONFIRMED:
        no_gap.clear(s.waiting)
    s.phase = SEARCHING
    displace(s)
    s.looks = 1
    s.doubted = NEVER
    competing_hypothesis.clear(s.rival)
    s.since = 0
    s.suspects = 0
    s.recurring = 0
    defects.clear(s.defects)
    s.held_fault = -1
    s.recent_missed = 0
    s.recent_added = 0
    s.doubled = 0
    s.doubling = 0
    s.hole = 0
    forget(s.profile, c.wheel, s.tracker.pitches)
    expect_less(s.tracker, AGAIN)
    s.tracker.wander = c.unlearned
    for i in range(c.pulses):
        s.tracker.slack[i] = c.slack[i]
    anchor.restart(s.anchor)
    restart(s.search)
    s.reversal.slow = 0


@kernel
def displace(s: State) -> None:
    """The place that the cam has told is not known any more."""
    if s.placed == BY_CAM:
        s.placed = NOT_TOLD


@kernel
def stand(s: State, c: Const) -> None:
    """The engine stands: no place, no speed, and nothing to wait for."""
    search(s, c)
    anchor.skip(s.anchor, c.anchor.length, c.pulses + anchor.EDGES)
    anchor.restart(s.anchor)
    no_gap.clear(s.waiting)
    skip(s.seen)
    skip_pairs(s.pairs)
    s.looked = 0
    s.wrong = 0
    s.filled = 0
    s.twice = 0
    s.y1 = 0.0
    s.y2 = 0.0
    s.reversal.index = -1
    s.reversal.stood = 0


@kernel
def doubt(s: State) -> None:
    """Ask for one more revolution as a proof of the place on the wheel, and forget its defects."""
    waver(s)
    defects.clear(s.defects)


@kernel
def waver(s: State) -> None:
    """Ask for one more revolution as a proof of the place on the wheel."""
    if s.phase == CONFIRMED:
        s.phase = TENTATIVE
        s.doubted = s.teeth
        no_gap.clear(s.waiting)
    displace(s)
    s.rival.turns = 0
    s.since = 0
    s.suspects = 0
    s.recurring = 0
    s.profile.clean = 0


@kernel
def proven(s: State) -> bool:
    """Tell whether the tooth of the latest pulse is proven: the place is, and no credible hypothesis has another.

    None is just behind a crowd of pulses, whose end may be yet to come, behind a gap that came too short, by a pulse
    that is believed missed or added before the next gap says so.
    """
    odd = s.anchor.short == 1 or s.anchor.unchecked == 1 or noise.crowd(s.burst, s.teeth) >= noise.BURST
    return bool(s.phase == CONFIRMED and s.placed > NOT_TOLD and not odd and unanimous(s.tracker))


@kernel
def shown(s: State) -> int:
    """Return what is told of synchronisation: SEARCHING, TENTATIVE, CONFIRMED, or SPEED_ONLY.

    Not CONFIRMED while the last turns speak for another place.
    """
    if s.phase != CONFIRMED or (proven(s) and s.anchor.against == 0.0 and s.anchor.wins == 0):
        return int(s.phase)
    return SPEED_ONLY if s.placed == NOT_TOLD else TENTATIVE


@kernel
def tooth_of(s: State, c: Const, index: int) -> int:
    """Return the tooth of a turn that a place of the wheel as it is laid out is; -1: no place is told."""
    return int(index % c.teeth) if s.placed > NOT_TOLD else -1


@kernel
def revolutions(s: State, c: Const) -> int:
    """Return how many turns the engine has made."""
    if c.turns == 1:  # a division takes as long as a tooth
        return int(s.revolutions)
    return int(s.revolutions * c.turns + s.index // c.teeth)


@kernel
def speed(s: State, c: Const) -> float:
    """Return the speed at the last tooth [rpm], 0 while it is not known."""
    if s.phase == SEARCHING:
        return 0.0
    return float(60e6 / (best(s.tracker).period * c.turn))


@kernel
def shape(s: State, c: Const, number: int, first: int, e: Shape) -> None:
    """Fill the evidence of missed or added pulses; ``first`` is the tooth concerned."""
    e.count = number
    e.tooth = tooth_of(s, c, first)
    e.speed = speed(s, c)
    for k in range(RESIDUALS):
        e.residual[k] = s.residuals[(s.teeth + 1 - RESIDUALS + k) & (RING - 1)]


@kernel
def tell_held(s: State, fault: int, out: Reports) -> None:
    """Report what was held as a fault."""
    e = report(out, fault, True, s.held.residual[RESIDUALS - 1], 0.5).pulses
    e.count, e.tooth, e.speed = s.held.count, s.held.tooth, s.held.speed
    for k in range(RESIDUALS):
        e.residual[k] = s.held.residual[k]


@kernel
def period(s: State) -> float:
    """Return the time of one pitch at the last tooth [us]."""
    return float(best(s.tracker).period)


@kernel
def angle(s: State, c: Const) -> float:
    """Return the angle of the last tooth [share of a revolution], tooth 0 at zero."""
    return float(c.wheel.place[s.index % c.teeth] / c.turn)
