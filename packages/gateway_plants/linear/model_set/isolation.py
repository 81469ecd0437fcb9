"""Isolation: which actuator or sensor is at fault, by the evidence of the hypotheses; or that none can be named.

A part (actuator or sensor; the better of its hypotheses) is named when its evidence is more than that of any other part
by :data:`SURE`, its own innovations are as small as they should be, and its fault has at least the size that counts. If
no hypothesis explains what came, or several do for longer than the patience, it is not isolated. Then the plant is
found anew, with the errors of its parameters as they were known before.

A plant that is not linear looks like faults of its actuators. So "its entries vary" is one more that is asked: where it
is ahead, or nearly as good as the best part when patience ends (an actuator's sooner), nobody is at fault, and from
then on entries vary. What begins at once is no such change: it has to explain each moment since the alarm, with errors
as small as they were told.

The fault of a named part is let go under each hypothesis, from its estimate on: a sensor tells nothing any more, what
an actuator does is followed. That it moves is one more hypothesis, which names nobody. So a second part is found beside
the first, by the same evidence; not a second sensor, and no third part. Where matrices are exact an actuator's fault
may have begun shortly before or behind a sensor's: the sensor's hypothesis then has the actuators jump, and once it is
named these are followed until one of them alone is surely at fault, or none. Where a fault is gone all begin again
without it; one that turns out smaller than what counts is taken into the estimate as an offset, and nobody is named.
"""

from __future__ import annotations

from math import sqrt

from gateway_fdi.isolation import fault_size
from gateway_fdi.jit import f8s, kernel
from gateway_fdi.linear_algebra import copy
from gateway_plants.linear.model_set import filters
from gateway_plants.linear.model_set.filters import GAIN, HEALTHY, OFFSET, SENSOR, SILENT, VARYING, slot
from gateway_plants.linear.model_set.records import NONE, PLANT, Const, State

#: Log of the odds by which a part must be ahead of the next.
SURE = 25.0
#: Evidence in levels that may go by while the healthy hypothesis explains all.
WEAK = 1.5
#: Samples behind an alarm in which one part is looked for, and no sensor with actuators.
SINGLY = 10
#: Standard deviations from which on an actuator's fault is sure, as it may have been found beside a sensor's.
BESIDE = 5.0
#: Standard deviations of another one's beyond which it is not.
AGAINST = 3.0
#: Samples until what no hypothesis explains is called so; and until an actuator is named beside a sensor.
PATIENCE = 25
#: Jumps of an actuator's fault since the alarm with which it may be named.
MOST_JUMPS = 1
#: Parts that are named at a time.
MOST_NAMED = 2
#: Alarms that nothing came of while the healthy hypothesis explained all, beyond which it is not isolated.
FORGIVEN = 4
#: Samples until a fault that is followed is no more taken to move.
MOVES = 20


@kernel
def sensors_of(s: State, c: Const, h: int) -> int:
    """Return of how many sensors a hypothesis takes what they tell."""
    count = c.filters.p - (1 if c.filters.kind[h] == SILENT else 0)
    for j in range(c.filters.p):
        count -= s.filters.silent[j]
    return int(max(count, 0))


@kernel
def _begin(s: State, c: Const) -> None:
    """Begin without evidence."""
    s.undecided = s.ahead = s.calm = s.waited[0] = 0
    s.first = NONE
    for h in range(c.filters.hypotheses):
        s.evidence[h] = 0.0
        s.misfits[h] = sensors_of(s, c, h)
        s.jumps[h] = 0


@kernel
def _own_slot(c: Const, part: int) -> int:
    """Return the slow state that is a part's offset."""
    m = c.filters.m
    return filters.slot_of(c.filters, OFFSET, part) if part < m else filters.slot_of(c.filters, SENSOR, part - m)


@kernel
def _release(s: State, c: Const, part: int) -> None:
    """Name a part no more."""
    s.parts -= s.named[part]
    s.named[part] = s.filters.followed[_own_slot(c, part)] = 0
    if part >= c.filters.m:
        s.filters.silent[part - c.filters.m] = 0
    fault_size.begin(s.suspects[part])


@kernel(inlined=False)
def restart(s: State, c: Const) -> None:
    """Begin anew: nothing is known of the plant's state; of its parameters what was in a calm time."""
    f = c.filters
    slow = f.total - f.n
    if s.keeps >= 2:
        old = s.keeps % 2
        copy(s.filters.z[0, f.n :], s.kept[old], slow)
        for k in range(slow):
            copy(s.filters.cov[0, f.n + k, f.n :], s.kept_cov[old, k], slow)
        filters.derive(s.filters, f, 0)
    else:
        filters.ignorant(s.filters, f, 0)
    filters.unknown(s.filters, f, 0)
    s.done = s.unexplained = s.agreed = s.astray = s.tested = s.forgiven = 0
    for part in range(f.m + f.p):
        _release(s, c, part)
    _begin(s, c)


@kernel
def part_of(c: Const, h: int) -> int:
    """Return the part of a hypothesis: actuators from 0, sensors behind them; NONE or PLANT."""
    f = c.filters
    if f.kind[h] == HEALTHY:
        return NONE
    if f.kind[h] == VARYING:
        return PLANT
    if f.kind[h] in (OFFSET, GAIN):
        return int(f.place[h])
    return int(f.m + f.place[h])


@kernel
def at_fault(s: State, part: int) -> bool:
    """Tell whether a part is named, and its fault has had a size that counts."""
    return bool(s.named[part] == 1 and s.suspects[part].confirmed == 1)


@kernel
def hypotheses_in_use(s: State, c: Const) -> int:
    """Return how many hypotheses are in use: once entries vary, they do under each, and the last one tells no more."""
    f = c.filters
    last = f.hypotheses - 1
    return int(last if s.filters.varies == 1 and f.kind[last] == VARYING else f.hypotheses)


@kernel
def is_asked(s: State, c: Const, h: int) -> bool:
    """Tell whether a hypothesis says something: of a part that is named, that the fault which is followed moves."""
    part, k = part_of(c, h), slot(c.filters, h)
    return bool(part < 0 or s.named[part] == 0 or (k >= 0 and s.filters.followed[k] == 1))


@kernel
def _rival(s: State, c: Const, h: int) -> bool:
    """Tell whether a hypothesis may be what has happened: a sensor with actuators beside it once no single part is."""
    with_actuators = c.filters.kind[h] == SILENT and s.jumps[h] > 0
    return bool(is_asked(s, c, h) and (s.undecided > SINGLY or not with_actuators))


@kernel
def fits(s: State, c: Const, h: int) -> bool:
    """Tell whether a hypothesis explains what came lately."""
    return bool(s.misfits[h] <= c.fits[sensors_of(s, c, h)])


@kernel
def _counts(c: Const, part: int, size: float) -> float:
    """Return a fault's size over the one that counts."""
    return float(abs(size) / (c.actuator[part] if part < c.filters.m else c.sensor[part - c.filters.m]))


@kernel(inlined=False)
def adopt(s: State, c: Const, source: int) -> None:
    """Let all hypotheses begin again from one's estimate."""
    f, x = c.filters, s.filters
    filters.copy(x, f, source, 0)
    filters.separate(x, f)
    _begin(s, c)


@kernel
def _best(s: State, c: Const) -> tuple[int, float]:
    """Return the hypothesis with most evidence, and by how much its part is ahead of the next."""
    best = 1
    for h in range(1, hypotheses_in_use(s, c)):
        if _rival(s, c, h) and s.evidence[h] > s.evidence[best]:
            best = h
    next_one = 0.0
    for h in range(1, hypotheses_in_use(s, c)):
        if _rival(s, c, h) and part_of(c, h) != part_of(c, best):
            next_one = max(next_one, s.evidence[h])
    return best, float(s.evidence[best] - next_one)


@kernel
def _follow(s: State, c: Const, part: int) -> None:
    """Name a part: its offset is let go under each hypothesis."""
    s.named[part] = s.filters.followed[_own_slot(c, part)] = 1
    s.parts += 1
    s.unsure[part] = 0
    fault_size.begin(s.suspects[part])


@kernel
def _name(s: State, c: Const, best: int) -> None:
    """Let the fault of a hypothesis go under each, from its estimate on, once its part is named.

    A sensor's: that it tells nothing, where the others show the plant without it; an actuator's: its offset.
    """
    f, x = c.filters, s.filters
    part, k, own = part_of(c, best), slot(f, best), _own_slot(c, part_of(c, best))
    _follow(s, c, part)
    may_be_silent = f.kind[best] == SILENT
    for h in range(f.hypotheses):
        may_be_silent = may_be_silent or (f.kind[h] == SILENT and part_of(c, h) == part)
    if may_be_silent:
        x.silent[part - f.m], x.followed[own] = 1, 0
        if k >= 0:
            filters.forget(x, f, best, f.n + k, f.prior[k])
        for i in range(f.m):  # what actuators may have done beside is to be confirmed
            if f.q == 0 and s.named[i] == 0:
                _follow(s, c, i)
                s.unsure[i] = 1
                filters.add_jump(x, f, best, OFFSET, i)
    elif k != own:
        size, place = x.z[best, f.n + k] * x.past[0, f.place[best]], f.n + own
        filters.forget(x, f, best, f.n + k, f.prior[k])
        x.z[best, place], x.cov[best, place, place] = size, f.free[own]
    adopt(s, c, best)


@kernel
def _as_told(s: State, c: Const, h: int) -> bool:
    """Tell whether what is slow is as small as it was told, under a hypothesis."""
    return bool(filters.off_the_bounds(s.filters, c.filters, h) < c.told)


@kernel
def _accuses_nobody(s: State, c: Const, h: int) -> bool:
    """Tell whether a hypothesis names no further part: that entries vary, or that a fault which is followed moves."""
    part = part_of(c, h)
    return bool(part == PLANT or (part >= 0 and s.named[part] == 1))


@kernel
def _would_do(s: State, c: Const, best: int) -> int:
    """Return the hypothesis that names no further part and explains what came nearly as well as the best; 0: none."""
    for h in range(1, hypotheses_in_use(s, c)):
        if not (_accuses_nobody(s, c, h) and is_asked(s, c, h) and s.evidence[h] > s.evidence[best] - SURE):
            continue
        if part_of(c, h) != PLANT or (s.jolted == 0 and _as_told(s, c, h)):
            return h
    return 0


@kernel
def _go_on(s: State, c: Const, h: int) -> None:
    """Go on from a hypothesis that names no further part: from now on entries vary, or the fault is taken to move."""
    if part_of(c, h) == PLANT:
        s.filters.varies = 1
    else:
        s.moving = MOVES
    adopt(s, c, h)


@kernel
def _may_be_named(s: State, c: Const, h: int) -> bool:
    """Tell whether the part of a hypothesis may be named beside those that are: at most one of them is a sensor."""
    sensors = 0
    for j in range(c.filters.p):
        sensors += s.named[c.filters.m + j]
    return bool(s.parts < MOST_NAMED and (sensors == 0 or part_of(c, h) < c.filters.m))


@kernel
def isolate(s: State, c: Const) -> None:
    """Name a part, or say that none can be named."""
    s.undecided += 1
    last = hypotheses_in_use(s, c) - 1
    if not fits(s, c, last):
        s.jolted = 1
    elif s.undecided == 1:
        s.jolted = 0
    best, ahead = _best(s, c)
    nobody = _would_do(s, c, best)
    # What acts through the plant's dynamics begins once; one that had to jump again and again only follows what it is
    # not.
    acts = c.filters.kind[best] in (OFFSET, GAIN, SILENT)
    new = not _accuses_nobody(s, c, best)
    may_be = not new or (_may_be_named(s, c, best) and (not acts or s.jumps[best] <= MOST_JUMPS))
    if ahead >= SURE and may_be and fits(s, c, best) and s.evidence[best] >= c.level:
        s.ahead = s.ahead + 1 if part_of(c, best) == s.first else 1
        s.first = part_of(c, best)
        if s.ahead < c.least:
            return
        if new:
            _name(s, c, best)
        elif nobody > 0 and (s.first != PLANT or s.undecided > PATIENCE):
            _go_on(s, c, nobody)
        elif s.undecided > c.patience:
            s.unexplained = 1
        return
    s.ahead, s.first = 0, NONE
    none_fits = True
    for h in range(hypotheses_in_use(s, c)):
        if _rival(s, c, h) and fits(s, c, h):
            none_fits = False
    weak = s.evidence[best] < WEAK * c.level and fits(s, c, 0)
    if s.undecided > c.patience and weak and s.forgiven < FORGIVEN:
        s.forgiven += 1
        adopt(s, c, 0)
    elif s.undecided > (PATIENCE if acts else c.patience) and nobody > 0:
        _go_on(s, c, nobody)
    elif s.undecided > c.patience or (s.undecided > PATIENCE and none_fits):
        s.unexplained = 1


@kernel
def _beside(s: State, c: Const) -> int:
    """Return the only actuator that has surely done something beside a sensor that is named; NONE: none or several.

    Where several seem to have, it is another sensor.
    """
    found = NONE
    for i in range(c.filters.m):
        place = c.filters.n + _own_slot(c, i)
        if s.suspects[i].confirmed == 0 and s.named[i] == 1:
            sizes = abs(s.filters.z[0, place]) / sqrt(s.filters.cov[0, place, place])
            if sizes > BESIDE and found == NONE:
                found = i
            elif sizes > AGAINST:
                return NONE
    return found if s.waited[0] > PATIENCE else NONE


@kernel
def follow_named(s: State, c: Const, y: f8s) -> None:
    """Follow the faults of the named parts: how large they are, and whether they are gone."""
    f, x = c.filters, s.filters
    beside = _beside(s, c)
    for part in range(f.m + f.p):
        if s.named[part] == 0:
            continue
        s.magnitude[part] = filters.size_of(x, f, part, y)
        share = _counts(c, part, s.magnitude[part])
        counts = share >= 1.0 and (s.unsure[part] == 0 or part == beside)
        came = fault_size.follow(s.suspects[part], counts, share < 0.5, c.patience, c.hold)
        if came != fault_size.STANDS:
            k = _own_slot(c, part)
            _release(s, c, part)
            if came == fault_size.GONE or f.prior[k] == 0.0 or f.q == 0:
                filters.forget(x, f, 0, f.n + k, f.prior[k])
            for i in range(f.m):
                if part >= f.m and s.named[i] == 1 and s.suspects[i].confirmed == 0:
                    _release(s, c, i)
                    filters.forget(x, f, 0, f.n + _own_slot(c, i), f.prior[_own_slot(c, i)])
            adopt(s, c, 0)


@kernel
def recover(s: State, c: Const) -> None:
    """Go on with the healthy hypothesis until it has explained all for long enough.

    It learns from sensors of which several may be wrong: what they say is explained by errors of the plant that are
    larger than was told. So these have to be as small as they were told, and for as long as it would take to tell that
    something is wrong. What was learned while it was is not forgotten soon: where all is explained, but by more than
    that, the plant is found once more.
    """
    well = s.done >= c.start and fits(s, c, 0) and _as_told(s, c, 0)
    s.agreed = s.agreed + 1 if well else 0
    s.astray = 0 if well else s.astray + 1
    if s.astray >= max(c.hold, c.patience):
        restart(s, c)
        s.unexplained = 1
    elif s.agreed >= max(c.hold, c.patience):
        s.unexplained = 0
        adopt(s, c, 0)
