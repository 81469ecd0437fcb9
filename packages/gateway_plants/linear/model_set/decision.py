"""The course of a sample through the hypotheses of ``filters``, and the evidence between them.

Each hypothesis has a sum of evidence against "nothing is wrong", which does not fall below 0 (Page; CUSUM):

    g_h := max(0, g_h + log p_h(y) - log p_0(y))

Beyond the level of ``mtfa_s`` something is wrong, and nothing is judged until it is known what:
:mod:`~gateway_plants.linear.model_set.isolation`.
"""

from __future__ import annotations

from math import log, sqrt

from gateway_fdi.jit import f8s, i8s, kernel
from gateway_fdi.linear_algebra import copy
from gateway_fdi.quantiles import chi2_above
from gateway_plants.linear.model_set import alignment, design, filters, isolation
from gateway_plants.linear.model_set.filters import LOOSELY, SILENT
from gateway_plants.linear.model_set.isolation import PATIENCE
from gateway_plants.linear.model_set.records import ISOLATING, LEARNING, WATCHING, Const, State

#: Of the level over Wald's: errors of parameters are no white noise while they are being learned.
MARGIN = 2.0
#: Samples in which a part has to be ahead: of a plant that is off, and of one that is exact.
LEAST = (4, 2)
#: Samples in which a fault has to be isolated where nothing is told: of a plant that is off, and of one that is exact.
USUAL = (200, 60)
#: Share of healthy plants within what was told whose errors would look larger than that, behind what was not isolated.
LARGER = 1e-3
#: Samples between two jumps that no single sample shows.
WAIT = 16
#: Share of a moving mean that a new sample is.
SHARE = 1.0 / 16.0
#: Calm samples between two estimates of the parameters that are kept for a new start; until the first two are there.
KEPT, FIRST = 2000, 250
#: Calm samples that take back an alarm that nothing came of.
CALM = 1000
#: Share of a begun fault's variance that one which is followed takes on in a sample, while it does not move.
CALMLY = 1e-5


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
    isolation.restart(s, c)


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


@kernel(inlined=False)
def _take(s: State, c: Const, h: int, y: f8s, known: bool) -> None:
    """Take a sample with one filter, and its share in the moving mean."""
    # What a sample alone does not show the mean of some does; then some have to tell of the jump before the next one.
    s.waited[h] += 1
    # At an alarm each is asked at once, so that none is ahead only because its fault was let go first.
    at_alarm = s.undecided == 1 and s.waited[h] > LEAST[0] and c.filters.kind[h] != SILENT
    restless = known and ((s.waited[h] >= WAIT and not isolation.fits(s, c, h)) or at_alarm)
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
    for h in range(isolation.hypotheses_in_use(s, c)):
        if isolation.is_asked(s, c, h):
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
            isolation.adopt(s, c, 0)
        _advance(s, c, u, unsure)
        return
    if c.task != ISOLATING:
        _alone(s, c, y)
    elif s.unexplained == 1:
        _take(s, c, 0, y, True)
        isolation.recover(s, c)
    else:
        most = _compare(s, c, y)
        if s.undecided > 0 or most > c.level:
            if most < 0.5 * c.level:
                s.undecided = s.ahead = 0
            else:
                isolation.isolate(s, c)
        else:
            s.tested = 1
            if s.parts > 0:
                isolation.follow_named(s, c, y)
            elif filters.off_the_bounds(s.filters, f, 0) > c.bounds:
                s.unexplained, s.tested = 1, 0
            elif most < 0.5 * c.level:
                _keep(s, c)
    if s.unexplained == 1 and s.parts + s.undecided > 0:
        again = s.unexplained
        isolation.restart(s, c)
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
        for h in range(isolation.hypotheses_in_use(s, c)):
            if isolation.is_asked(s, c, h):
                filters.predict(s.filters, f, h, u, unsure)
