"""Pulses without a proven place: why there is none, told after a limit in turns."""

from __future__ import annotations

from gateway.monitors.contract import report
from gateway_fdi.jit import kernel
from gateway_plants.crank.monitor import defects, no_gap, runout, turns, wrong_wheel
from gateway_plants.crank.monitor.faults import ADDED, DOUBLED, MISSED, NO_GAP, UNWATCHED, Reports
from gateway_plants.crank.monitor.place_proof import TOLD, held_back
from gateway_plants.crank.monitor.sync_state import TENTATIVE, Const, State, shape, tell_held

#: Revolutions, and pulses beyond, without synchronisation after which the reason is named.
PATIENCE, PATIENCE_PULSES, LONG_PATIENCE = 4, 100, 10
#: Share of pulses without a frame, over about so many pulses, from which on nothing can be told.
MOST_UNSEEN, UNSEEN_PULSES = 0.4, 3000.0


@kernel
def unwatched(s: State, c: Const, number: int, out: Reports) -> None:
    """Count pulses that no frame brought; when they are too many to tell anything about the sensor, say so."""
    s.unseen += number * (1.0 - s.unseen / UNSEEN_PULSES)
    share = s.unseen / UNSEEN_PULSES
    if share > MOST_UNSEEN:
        e = report(out, UNWATCHED, True, share, MOST_UNSEEN).unwatched
        e.share, e.teeth = share, s.teeth


@kernel
def wait(s: State, c: Const, y: float, out: Reports) -> None:
    """Count pulses without a proven place on the wheel, and name the reason in the end.

    There may be none: an engine whose ripple hides the gap is no defect, so that only what speaks against the wheel
    counts, for :data:`LONG_PATIENCE` times as long, and for ever while the starter turns it.
    """
    wa = s.waiting
    if held_back(s, c):
        no_gap.clear(wa)  # the place may be known: it waits for the wheel, which is no reason to miss the gap
        return
    no_gap.note(wa, s.y2, s.y1, y)
    if c.even == 0:
        no_gap.look(wa, s.anchor, c.anchor, c.turned, c.polar == 1, c.pulses, c.repeats)
    patience = PATIENCE * c.pulses + PATIENCE_PULSES
    if wa.pulses < patience or (wa.pulses > patience and wa.pulses % c.pulses != 0):
        return
    share = wa.short / wa.pulses - c.short
    again = s.phase == TENTATIVE and s.recurring == 1  # a defect of each turn is about to be told
    fires = no_gap.turn_us(s.anchor, c.anchor.length, c.pulses) < 60e6 / runout.FIRING_RPM * c.turns
    if share > turns.DOUBLE_SHARE:
        d = report(out, DOUBLED, True, share, turns.DOUBLE_SHARE).doubled
        d.share, d.teeth = share, s.teeth
    elif c.even == 1:
        pass  # it has no gap that could be missing
    elif fires and c.polar == 1 and no_gap.polarity(wa):
        _tell_gap(s, c, out, 1.0)
    elif s.twice == TOLD:
        return  # it was told why there is none
    elif fires and again and s.defects.turns >= defects.SURE:
        number = defects.missing(s.defects)
        shape(s, c, number if number > 0 else s.defects.count, 0, s.held)
        s.held.tooth = -1  # every place that is left has it, each at another tooth
        if number > 0 or not defects.of_wheel(s.defects):
            tell_held(s, MISSED if number > 0 else ADDED, out)
        if number > 0:
            turns.tell_broken(-1, number, s.held.speed, out)
            return
        if defects.of_wheel(s.defects):
            turns.tell_bent(s, c, int(s.defects.teeth[0]), -1, out)
            return
    elif (again or wrong_wheel.expected(s) or wrong_wheel.unsure(s, c)) and wa.pulses < LONG_PATIENCE * patience:
        return
    elif no_gap.contradicts(wa, fires, c.teeth) or (fires and wa.pulses >= LONG_PATIENCE * patience):
        _tell_gap(s, c, out, 0.0)
        s.twice = max(s.twice, 1)
    else:
        return
    no_gap.clear(wa)


@kernel
def _tell_gap(s: State, c: Const, out: Reports, polarity: float) -> None:
    """Report that the gap never comes; 1: as reversed polarity makes it."""
    g = report(out, NO_GAP, True, s.waiting.widest, c.gap).no_gap
    g.teeth, g.widest, g.polarity = s.teeth, s.waiting.widest, polarity
