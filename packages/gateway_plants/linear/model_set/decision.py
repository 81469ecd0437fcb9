"""Which actuator, which sensor, how large: evidence between the hypotheses of ``filters``.

Each hypothesis has a sum of evidence against "nothing is wrong", which does not fall below 0 (Page; CUSUM):

    g_h := max(0, g_h + log p_h(y) - log p_0(y))

Beyond the level of ``mtfa_s`` something is wrong, and nothing is judged until it is known what. A part (actuator or
sensor; the better of its hypotheses) is named when its evidence is more than that of any other part by :data:`SURE`,
its own innovations are as small as they should be, and its fault has at least the size that counts. If no hypothesis
explains what came, or several do for longer than the patience, it is not isolated. Then the plant is found anew, with
the errors of its parameters as they were known before.

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

from math import log, sqrt
from typing import Annotated

from gateway_fdi.isolation import fault_size
from gateway_fdi.jit import Record, f8, f8s, i8, i8s, kernel, means
from gateway_fdi.linear_algebra import copy
from gateway_fdi.quantiles import chi2_above
from gateway_plants.linear.mathematics.plant import MOST_INPUTS, MOST_OUTPUTS
from gateway_plants.linear.model_set import alignment, design, filters
from gateway_plants.linear.model_set.filters import (
    GAIN,
    HEALTHY,
    LOOSELY,
    MOST_SLOW,
    OFFSET,
    SENSOR,
    SILENT,
    VARYING,
    slot,
)
from gateway_plants.linear.model_set.matrices import MOST_HYPOTHESES

#: Log of the odds by which a part must be ahead of the next.
SURE = 25.0
#: Of the level over Wald's: errors of parameters are no white noise while they are being learned.
MARGIN = 2.0
#: Evidence in levels that may go by while the healthy hypothesis explains all.
WEAK = 1.5
#: Alarms that nothing came of while the healthy hypothesis explained all, beyond which it is not isolated; calm samples
#: that take one of them back.
FORGIVEN, CALM = 4, 1000
#: Samples in which a part has to be ahead: of a plant that is off, and of one that is exact.
LEAST = (4, 2)
#: Samples behind an alarm in which one part is looked for, and no sensor with actuators.
SINGLY = 10
#: Standard deviations from which on an actuator's fault is sure, as it may have been found beside a sensor's.
BESIDE = 5.0
#: Standard deviations of another one's beyond which it is not.
AGAINST = 3.0
#: Samples until what no hypothesis explains is called so.
PATIENCE = 25
#: Samples in which a fault has to be isolated where nothing is told: of a plant that is off, and of one that is exact.
USUAL = (200, 60)
#: Share of healthy plants within what was told whose errors would look larger than that, behind what was not isolated.
LARGER = 1e-3
#: Samples between two jumps that no single sample shows.
WAIT = 16
#: Jumps of an actuator's fault since the alarm with which it may be named.
MOST_JUMPS = 1
#: Parts that are named at a time.
MOST_NAMED = 2
#: Share of a begun fault's variance that one which is followed takes on in a sample, while it does not move; samples
#: until it is no more taken to move.
CALMLY, MOVES = 1e-5, 20
#: Share of a moving mean that a new sample is.
SHARE = 1.0 / 16.0
#: Calm samples between two estimates of the parameters that are kept for a new start; until the first two are there.
KEPT, FIRST = 2000, 250
#: What is done: a fault is isolated; the plant's errors are learned from healthy samples; the healthy hypothesis is
#: compared with what comes, and somebody else judges.
ISOLATING, LEARNING, WATCHING = range(3)
#: No part; the plant as a whole, that varies.
NONE, PLANT = -1, -2
#: Actuators, then sensors.
PARTS = MOST_INPUTS + MOST_OUTPUTS


class Const(Record):
    """Constants."""

    filters: filters.Const = means("filters of the plant under each hypothesis")
    level: f8 = means("evidence beyond which something is wrong")
    least: i8 = means("samples in which a part has to be ahead", "samples")
    fits: Annotated[f8s, MOST_OUTPUTS + 1] = means("largest mean e^T V^-1 e of a right hypothesis of so many sensors")
    bounds: f8 = means("bound of what is slow, squared")
    told: f8 = means("bound of what is slow, squared, behind what was not isolated")
    actuator: Annotated[f8s, MOST_INPUTS] = means("size of an actuator's fault that counts, in the command's unit")
    sensor: Annotated[f8s, MOST_OUTPUTS] = means("size of a sensor's fault that counts, in the reading's unit")
    task: i8 = means("ISOLATING, LEARNING or WATCHING")
    doubt: f8 = means("normalised innovation squared of a sample that is not learned from while watching")
    found: i8 = means("samples of the start after which x is known", "samples")
    start: i8 = means("samples in which nothing is judged", "samples")
    hold: i8 = means("samples after which a fault is gone", "samples")
    patience: i8 = means("samples in which a fault has to be isolated", "samples")


class State(Record):
    """State."""

    filters: filters.State = means("filters of the plant under each hypothesis")
    done: i8 = means("samples of the start", "samples")
    named: Annotated[i8s, PARTS] = means("1: the part is named")
    unsure: Annotated[i8s, PARTS] = means("1: it is followed, as a sensor's fault was named that it may hide beside")
    parts: i8 = means("parts that are named")
    moving: i8 = means("samples in which a fault that is followed is taken to move")
    evidence: Annotated[f8s, MOST_HYPOTHESES] = means("g_h of each hypothesis")
    misfits: Annotated[f8s, MOST_HYPOTHESES] = means("normalised innovation squared of each hypothesis, averaged")
    waited: Annotated[i8s, MOST_HYPOTHESES] = means("samples since the jump of each hypothesis", "samples")
    jumps: Annotated[i8s, MOST_HYPOTHESES] = means("jumps of each hypothesis, lately")
    undecided: i8 = means("samples since an alarm", "samples")
    ahead: i8 = means("samples of these in which first was named", "samples")
    first: i8 = means("part that was named last; NONE: none")
    suspects: Annotated[list[fault_size.State], PARTS] = means("whether the size of each named fault counts")
    unexplained: i8 = means("1: what came is not isolated")
    jolted: i8 = means("1: since the alarm VARYING has once not explained what came: it was no gradual change")
    agreed: i8 = means("samples since unexplained that a healthy plant explains, within what was told", "samples")
    astray: i8 = means("samples since unexplained that it explains, beyond what was told", "samples")
    tested: i8 = means("1: the last sample was judged")
    magnitude: Annotated[f8s, PARTS] = means("size of each named fault")
    fit: f8 = means("sum of normalised innovations squared of the healthy hypothesis while it alone runs")
    fitted: i8 = means("samples in that sum", "samples")
    forgiven: i8 = means("alarms that nothing came of")
    calm: i8 = means("samples without an alarm since slow states were kept", "samples")
    keeps: i8 = means("times that slow states were kept")
    kept: Annotated[f8s, 2, MOST_SLOW] = means("slow states of two calm times, the older at ``keeps % 2``")
    kept_cov: Annotated[f8s, 2, MOST_SLOW, MOST_SLOW] = means("their covariance")


def prepare(
    s: State,
    c: Const,
    told: design.Told,
    *,
    mtfa_s: float,
    start_s: float,
    hold_s: float,
    patience_s: float | None = None,
    task: int = ISOLATING,
) -> None:
    """Fill records of State and Const.

    Args:
        told: what the user tells of the plant.
        mtfa_s: mean time between false alarms that is asked for [s].
        start_s: time in which nothing is judged [s].
        hold_s: a fault is gone when it has been for so long [s].
        patience_s: time in which a fault has to be isolated [s]; None: 200 samples, of an exact plant 60.
        task: ISOLATING, LEARNING or WATCHING.

    Raises:
        ValueError: too many entries are uncertain.
    """
    design.prepare(c.filters, told)
    period, p, m = told.plant.period, told.plant.outputs, told.plant.inputs
    # Wald: evidence of e^level comes by chance once in e^level samples, for each hypothesis.
    c.level = MARGIN * log(max(mtfa_s / period, 1e3) * c.filters.hypotheses)
    spread = sqrt(SHARE / (2.0 - SHARE))
    c.fits[: p + 1] = [count + 8.0 * spread * sqrt(2.0 * max(count, 1)) for count in range(p + 1)]
    slow = c.filters.total - c.filters.n - m
    c.bounds, c.told = 2.0 * chi2_above(1e-6, slow), chi2_above(LARGER, slow)
    c.actuator[:m], c.sensor[:p] = told.actuator, told.sensor
    c.start = max(round(start_s / period), 4 * told.plant.states)
    c.found = c.start // 4
    c.task = task
    c.doubt = chi2_above(min(period / mtfa_s, 0.4), p)
    c.hold = max(round(hold_s / period), 1)
    exact = len(told.entries) == 0
    c.least = LEAST[exact]
    c.patience = USUAL[exact] if patience_s is None else max(round(patience_s / period), PATIENCE)
    filters.ignorant(s.filters, c.filters, 0)
    restart(s, c)


@kernel
def _sensors(s: State, c: Const, h: int) -> int:
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
        s.misfits[h] = _sensors(s, c, h)
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
def _keep(s: State, c: Const) -> None:
    """Keep what is slow, each KEPT calm samples, the first two sooner."""
    f = c.filters
    s.calm += 1
    if s.calm % CALM == 0 and s.forgiven > 0:
        s.forgiven -= 1
    if s.calm < (FIRST if s.keeps < 2 else KEPT):
        return
    s.calm = 0
    new = s.keeps % 2
    copy(s.kept[new], s.filters.z[0, f.n :], f.total - f.n)
    for k in range(f.total - f.n):
        copy(s.kept_cov[new, k], s.filters.cov[0, f.n + k, f.n :], f.total - f.n)
    s.keeps = s.keeps + 1 if s.keeps < 1000 else 2 + (s.keeps + 1) % 2


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
def _used(s: State, c: Const) -> int:
    """Return how many hypotheses are in use: once entries vary, they do under each, and the last one tells no more."""
    f = c.filters
    last = f.hypotheses - 1
    return int(last if s.filters.varies == 1 and f.kind[last] == VARYING else f.hypotheses)


@kernel
def _asked(s: State, c: Const, h: int) -> bool:
    """Tell whether a hypothesis says something: of a part that is named, that the fault which is followed moves."""
    part, k = part_of(c, h), slot(c.filters, h)
    return bool(part < 0 or s.named[part] == 0 or (k >= 0 and s.filters.followed[k] == 1))


@kernel
def _rival(s: State, c: Const, h: int) -> bool:
    """Tell whether a hypothesis may be what has happened: a sensor with actuators beside it once no single part is."""
    with_actuators = c.filters.kind[h] == SILENT and s.jumps[h] > 0
    return bool(_asked(s, c, h) and (s.undecided > SINGLY or not with_actuators))


@kernel
def _fits(s: State, c: Const, h: int) -> bool:
    """Tell whether a hypothesis explains what came lately."""
    return bool(s.misfits[h] <= c.fits[_sensors(s, c, h)])


@kernel
def _counts(c: Const, part: int, size: float) -> float:
    """Return a fault's size over the one that counts."""
    return float(abs(size) / (c.actuator[part] if part < c.filters.m else c.sensor[part - c.filters.m]))


@kernel(inlined=False)
def _adopt(s: State, c: Const, source: int) -> None:
    """Let all hypotheses begin again from one's estimate."""
    f, x = c.filters, s.filters
    filters.copy(x, f, source, 0)
    filters.separate(x, f)
    _begin(s, c)


@kernel
def _best(s: State, c: Const) -> tuple[int, float]:
    """Return the hypothesis with most evidence, and by how much its part is ahead of the next."""
    best = 1
    for h in range(1, _used(s, c)):
        if _rival(s, c, h) and s.evidence[h] > s.evidence[best]:
            best = h
    next_one = 0.0
    for h in range(1, _used(s, c)):
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
    _adopt(s, c, best)


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
    for h in range(1, _used(s, c)):
        if not (_accuses_nobody(s, c, h) and _asked(s, c, h) and s.evidence[h] > s.evidence[best] - SURE):
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
    _adopt(s, c, h)


@kernel
def _may_be_named(s: State, c: Const, h: int) -> bool:
    """Tell whether the part of a hypothesis may be named beside those that are: at most one of them is a sensor."""
    sensors = 0
    for j in range(c.filters.p):
        sensors += s.named[c.filters.m + j]
    return bool(s.parts < MOST_NAMED and (sensors == 0 or part_of(c, h) < c.filters.m))


@kernel
def _isolate(s: State, c: Const) -> None:
    """Name a part, or say that none can be named."""
    s.undecided += 1
    last = _used(s, c) - 1
    if not _fits(s, c, last):
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
    if ahead >= SURE and may_be and _fits(s, c, best) and s.evidence[best] >= c.level:
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
    for h in range(_used(s, c)):
        if _rival(s, c, h) and _fits(s, c, h):
            none_fits = False
    weak = s.evidence[best] < WEAK * c.level and _fits(s, c, 0)
    if s.undecided > c.patience and weak and s.forgiven < FORGIVEN:
        s.forgiven += 1
        _adopt(s, c, 0)
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
    return found if s.waited[0] > SINGLY else NONE


@kernel
def _judge_named(s: State, c: Const, y: f8s) -> None:
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
            _adopt(s, c, 0)


@kernel
def _recover(s: State, c: Const) -> None:
    """Go on with the healthy hypothesis until it has explained all for long enough.

    It learns from sensors of which several may be wrong: what they say is explained by errors of the plant that are
    larger than was told. So these have to be as small as they were told, and for as long as it would take to tell that
    something is wrong. What was learned while it was is not forgotten soon: where all is explained, but by more than
    that, the plant is found once more.
    """
    well = s.done >= c.start and _fits(s, c, 0) and _as_told(s, c, 0)
    s.agreed = s.agreed + 1 if well else 0
    s.astray = 0 if well else s.astray + 1
    if s.astray >= max(c.hold, c.patience):
        restart(s, c)
        s.unexplained = 1
    elif s.agreed >= max(c.hold, c.patience):
        s.unexplained = 0
        _adopt(s, c, 0)


@kernel(inlined=False)
def _take(s: State, c: Const, h: int, y: f8s, known: bool) -> None:
    """Take a sample with one filter, and its share in the moving mean."""
    # What a sample alone does not show the mean of some does; then some have to tell of the jump before the next one.
    s.waited[h] += 1
    # At an alarm each is asked at once, so that none is ahead only because its fault was let go first.
    at_alarm = s.undecided == 1 and s.waited[h] > LEAST[0] and c.filters.kind[h] != SILENT
    restless = known and ((s.waited[h] >= WAIT and not _fits(s, c, h)) or at_alarm)
    filters.correct(s.filters, c.filters, h, y, known, restless)
    if s.filters.jumped[h] == 1:
        s.waited[h] = 0
        s.jumps[h] = 1 if at_alarm else s.jumps[h] + 1
    elif s.undecided == 0 and s.waited[h] > WAIT:
        s.jumps[h] = 0
    s.misfits[h] += SHARE * (s.filters.left[h] - s.misfits[h])


@kernel
def _alone(s: State, c: Const, y: f8s) -> None:
    """Take a sample with the healthy hypothesis alone.

    While watching, what is slow is learned only from samples that it explains: otherwise a fault would be learned as an
    error of the plant, and be gone.
    """
    filters.innovate(s.filters, c.filters, 0, y)
    expected = s.filters.square < c.doubt
    _take(s, c, 0, y, expected or c.task == LEARNING)
    s.fit += s.filters.left[0]
    s.fitted += 1
    if c.task == WATCHING:
        s.tested = 1
        if expected:
            _keep(s, c)
        else:
            s.calm = 0


@kernel
def _start(s: State, c: Const, y: f8s) -> None:
    """Take a sample of the start.

    Where matrices are exact what is slow is learned only from samples that it explains: a fault is none of it.
    """
    known = s.done >= c.found
    if known and c.filters.q == 0:
        filters.innovate(s.filters, c.filters, 0, y)
        known = s.filters.square < c.doubt
    filters.correct(s.filters, c.filters, 0, y, known, False)
    s.done += 1
    if s.done >= c.start:
        s.misfits[0] = c.filters.p


@kernel
def step(s: State, c: Const, y: f8s, u: f8s, unsure: i8s) -> bool:
    """Take one sample of outputs ``y``, NaN: it did not come, with the commands ``u`` that hold from it on.

    Returns:
        whether the sample that is taken now did come: the same one, or one some periods ago.
    """
    f, x = c.filters, s.filters.aligned
    s.tested = 0
    if not alignment.align(x, f.alignment, y, u, unsure):
        _advance(s, c, x.u, x.unsure)
        return False
    if f.lag > 0:
        for j in range(f.p):
            k = f.lag + j
            if s.undecided + s.parts + s.unexplained == 0:
                alignment.move(x, j, s.filters.z[0, k])
            alignment.doubt(x, f.alignment, j, s.filters.z[0, k], s.filters.cov[0, k, k])
    _sample(s, c, x.y, x.u, x.unsure)
    return True


@kernel
def _compare(s: State, c: Const, y: f8s) -> float:
    """Take a sample with each hypothesis; returns the most evidence of one."""
    most = 0.0
    for h in range(_used(s, c)):
        if _asked(s, c, h):
            _take(s, c, h, y, True)
            s.evidence[h] = max(0.0, s.evidence[h] + s.filters.told[h] - s.filters.told[0])
            most = max(most, s.evidence[h])
    return most


@kernel
def _sample(s: State, c: Const, y: f8s, u: f8s, unsure: i8s) -> None:
    """Take one sample whose outputs are of one time."""
    f = c.filters
    if s.done < c.start:
        _start(s, c, y)
        if s.done >= c.start and s.unexplained == 0 and c.task == ISOLATING:
            _adopt(s, c, 0)
        _advance(s, c, u, unsure)
        return
    if c.task != ISOLATING:
        _alone(s, c, y)
    elif s.unexplained == 1:
        _take(s, c, 0, y, True)
        _recover(s, c)
    else:
        most = _compare(s, c, y)
        if s.undecided > 0 or most > c.level:
            if most < 0.5 * c.level:
                s.undecided = s.ahead = 0
            else:
                _isolate(s, c)
        else:
            s.tested = 1
            if s.parts > 0:
                _judge_named(s, c, y)
            elif filters.off_the_bounds(s.filters, f, 0) > c.bounds:
                s.unexplained, s.tested = 1, 0
            elif most < 0.5 * c.level:
                _keep(s, c)
    if s.unexplained == 1 and s.parts + s.undecided > 0:
        again = s.unexplained
        restart(s, c)
        s.unexplained = again
        for h in range(f.hypotheses):
            s.misfits[h] = 2.0 * c.fits[f.p]
    _advance(s, c, u, unsure)


@kernel(inlined=False)
def _advance(s: State, c: Const, u: f8s, unsure: i8s) -> None:
    """Take the filters in use to the next sample; also over a sample that did not come."""
    f = c.filters
    filters.remember(s.filters, f, u)
    s.moving = max(s.moving - 1, 0)
    s.filters.loose = LOOSELY if s.moving > 0 else CALMLY
    if s.done < c.start or s.unexplained == 1 or c.task != ISOLATING:
        filters.predict(s.filters, f, 0, u, unsure)
    else:
        for h in range(_used(s, c)):
            if _asked(s, c, h):
                filters.predict(s.filters, f, h, u, unsure)
