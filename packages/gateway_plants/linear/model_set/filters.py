"""Kalman filters of one linear plant under different hypotheses, each with the plant's own errors as slow states.

State z = [x; theta; a; l; s; g; lag]: the plant's state; the errors of its uncertain entries; of each actuator an
offset a and a relative gain l; of each sensor an offset s and, where a sensor's accuracy is told so, by how much its
gain g is off, and by how many periods it is late (:mod:`.alignment`):

    x(k+1) = Phi(theta) x + Gamma(theta) (u + a + diag(l) u) + w,     y = (1 + diag(g)) C x + s + v

What is slow goes on as exp(-T/tau) of itself plus noise, so that its spread is its bound when nothing tells it. The
covariance

    P := F P F' + Q,   F_x,theta = dPhi/dtheta x + dGamma/dtheta u

grows with what the plant does: a plant that rests shows no error of its model, one that is moved hard shows much. The
innovation's variance C P C' + R is therefore a threshold that adapts itself to input and state, propagated with both;
and what the innovations tell of theta makes it shrink again. That is the difference to a larger ``state_noise``, which
hides faults at rest and in motion alike.

Hypotheses, by their place: 0: nothing is wrong; then of each actuator "its offset jumps or drifts", of each "its gain
does"; of each sensor "its offset does", of each "it tells nothing" (its reading is spread evenly over its range); the
last: nothing is wrong, but the plant is not linear: its entries vary within their bounds, as fast as its slowest mode
lets its state move, and do not only age. All predict the same numbers, so that the densities of what came can be
compared. An offset or gain that may jump is told so at a sample that is too far from what was expected: the jump may
have begun at that sample or before it (:data:`BEGINNINGS`). The fault of a part that is named (:mod:`.decision`) is let
go under each hypothesis: the sensor is ``silent``, the actuator's offset ``followed``.

What the derivatives leave out is of the second order: the share of a step's variance that comes from theta, times
theta's relative variance, is noise beside w.

While nothing is known of x (at the start, behind a gap) theta and what else is slow is considered, not corrected
(Schmidt): P has it, the gain does not.

Sources: Schmidt, "Application of state-space methods to navigation problems" (1966); Ljung, "Asymptotic behavior of the
extended Kalman filter as a parameter estimator" (1979); Blom and Bar-Shalom (1988) for banks by hypothesis.
"""

from __future__ import annotations

from math import log, pi
from typing import Annotated

from gateway_fdi.jit import Record, f8, f8s, i8, i8s, kernel, means
from gateway_fdi.linear_algebra import copy as copy_row
from gateway_fdi.linear_algebra import decompose, dot, plus, solve
from gateway_plants.linear.mathematics.plant import MOST_INPUTS, MOST_OUTPUTS, MOST_STATES
from gateway_plants.linear.model_set import alignment, matrices
from gateway_plants.linear.model_set.matrices import MOST_ENTRIES, MOST_HYPOTHESES

#: Slow states; all states.
MOST_SLOW = MOST_ENTRIES + 2 * MOST_INPUTS + 3 * MOST_OUTPUTS
MOST = MOST_STATES + MOST_SLOW
#: Kinds of hypotheses.
HEALTHY, OFFSET, GAIN, SENSOR, SILENT, VARYING = range(6)
#: Samples before the present one at which a jump may have begun: these, at most BACK.
BEGINNINGS = (0, 1, 2, 3, 5, 8, 13, 21, 34)
BACK = 34
#: Logarithm of the odds that a jump comes at a given sample.
JUMP = -10.0
#: Share of a begun fault's variance that one which is followed takes on in a sample, whatever it does.
LOOSELY = 1e-3
#: Change of an entry's estimate, in its bounds, from which on Phi(theta) is computed anew.
FRESH = 0.01
#: Change from which on the derivatives are, likewise.
DERIVED = 0.2
#: What the derivatives leave out, per relative uncertainty of the entries.
SECOND_ORDER = 4.0


class Const(Record):
    """Constants."""

    n: i8 = means("states")
    m: i8 = means("inputs")
    p: i8 = means("outputs")
    q: i8 = means("uncertain entries")
    total: i8 = means("states with slow ones")
    gains: i8 = means("1: with the sensors' gains")
    lag: i8 = means("place of the first sensor's lag; 0: none is late")
    alignment: alignment.Const = means("lags of the sensors")
    plant: matrices.Const = means("the plant's matrices")
    hypotheses: i8 = means("number of hypotheses")
    kind: Annotated[i8s, MOST_HYPOTHESES] = means("what each hypothesis says")
    place: Annotated[i8s, MOST_HYPOTHESES] = means("actuator or sensor that each hypothesis is of")
    relative: Annotated[f8s, MOST_ENTRIES] = means("1 over the square of each entry")
    c: Annotated[f8s, MOST_OUTPUTS, MOST_STATES] = means("C")
    noise: Annotated[f8s, MOST_STATES] = means("variance of w")
    r: Annotated[f8s, MOST_OUTPUTS] = means("variance of v")
    unknown: Annotated[f8s, MOST_STATES] = means("variance of x while nothing is known of it")
    keep: Annotated[f8s, MOST_SLOW] = means("what a sample leaves of each slow state")
    vary: f8 = means("what a sample leaves of entries that vary")
    prior: Annotated[f8s, MOST_SLOW] = means("variance of each slow state")
    drive: Annotated[f8s, MOST_SLOW] = means("variance of a sample's change of a slow state that a hypothesis lets go")
    free: Annotated[f8s, MOST_SLOW] = means("variance of a jump of a slow state that a hypothesis lets go")
    command: Annotated[f8s, MOST_INPUTS] = means("variance of a command that is not known")
    gate: f8 = means("normalised innovation squared of one sample, beyond which something jumped")
    range: Annotated[f8s, MOST_OUTPUTS] = means("density of a silent sensor's reading, as logarithm")


class State(Record):
    """State of all filters; ``own`` and ``square`` are of the filter that was asked last."""

    aligned: alignment.State = means("samples brought to one time")
    z: Annotated[f8s, MOST_HYPOTHESES, MOST] = means("z of each hypothesis")
    cov: Annotated[f8s, MOST_HYPOTHESES, MOST, MOST] = means("P of each hypothesis")
    plant: matrices.State = means("[Phi, Gamma] of each, and what derives from them")
    jumped: Annotated[i8s, MOST_HYPOTHESES] = means("1: it jumped at the newest sample")
    left: Annotated[f8s, MOST_HYPOTHESES] = means("normalised innovation squared of the newest sample")
    told: Annotated[f8s, MOST_HYPOTHESES] = means("log density of the newest sample")
    e: Annotated[f8s, MOST_HYPOTHESES, MOST_OUTPUTS] = means("innovations of the newest sample")
    own: Annotated[f8s, MOST_OUTPUTS] = means("variance of each innovation by itself")
    square: f8 = means("normalised innovation squared")
    varies: i8 = means("1: the plant's entries vary, under every hypothesis")
    followed: Annotated[i8s, MOST_SLOW] = means("1: the slow state is a known fault, let go under every hypothesis")
    silent: Annotated[i8s, MOST_OUTPUTS] = means("1: the sensor's fault is known: it tells nothing, likewise")
    loose: f8 = means("share of free that it changes by in a sample")
    past: Annotated[f8s, BACK, MOST_INPUTS] = means("commands of the samples before, newest first")
    work: Annotated[f8s, MOST_STATES, MOST] = means("scratch")
    by_slow: Annotated[f8s, MOST_STATES, MOST_SLOW] = means("derivatives of the next x by the slow states")
    second: Annotated[f8s, MOST_STATES] = means("variance of the next x that errors of the entries make")
    gain: Annotated[f8s, MOST] = means("covariance of z and the sensor at hand; of a jump, what it has done to z")
    spread: Annotated[f8s, MOST_OUTPUTS, MOST_OUTPUTS] = means("covariance of the innovations, decomposed")
    rest: Annotated[f8s, MOST_OUTPUTS] = means("innovations, solved by spread")


@kernel
def slot(c: Const, h: int) -> int:
    """Return the slow state that a hypothesis lets go; -1: none."""
    return slot_of(c, c.kind[h], c.place[h])


@kernel
def slot_of(c: Const, kind: int, place: int) -> int:
    """Return the slow state that is a fault of a kind; -1: none."""
    if kind == OFFSET:
        return int(c.q + place)
    if kind == GAIN:
        return int(c.q + c.m + place)
    if kind == SENSOR:
        return int(c.q + 2 * c.m + place)
    return -1


@kernel
def derive(s: State, c: Const, h: int) -> None:
    """Compute the matrices of a filter and their derivatives from its estimate of the entries."""
    matrices.derive(s.plant, c.plant, h, s.z[h, c.n :])


@kernel
def forget(s: State, c: Const, h: int, i: int, variance: float) -> None:
    """Forget one state of a filter: it is 0 with a variance, without ties to the others."""
    s.z[h, i] = 0.0
    for j in range(c.total):
        s.cov[h, i, j] = s.cov[h, j, i] = 0.0
    s.cov[h, i, i] = variance


@kernel(inlined=False)
def unknown(s: State, c: Const, h: int) -> None:
    """Forget a filter's x; what is slow stays, without its ties to x."""
    for i in range(c.n):
        forget(s, c, h, i, c.unknown[i])


@kernel(inlined=False)
def ignorant(s: State, c: Const, h: int) -> None:
    """Set what is slow to its prior."""
    for i in range(c.n, c.total):
        forget(s, c, h, i, c.prior[i - c.n])
    derive(s, c, h)


@kernel(inlined=False)
def copy(s: State, c: Const, source: int, target: int) -> None:
    """Let a filter go on from another one's estimate."""
    if source == target:
        return
    copy_row(s.z[target], s.z[source], c.total)
    for i in range(c.total):
        copy_row(s.cov[target, i], s.cov[source, i], c.total)
    matrices.copy(s.plant, c.plant, source, target)


@kernel
def separate(s: State, c: Const) -> None:
    """Let all hypotheses begin from the first one's estimate."""
    for h in range(1, c.hypotheses):
        copy(s, c, 0, h)


@kernel
def _tells(s: State, c: Const, h: int, j: int) -> bool:
    """Tell whether a filter takes what a sensor tells."""
    return bool(s.silent[j] == 0 and not (c.kind[h] == SILENT and c.place[h] == j))


@kernel
def _add_jumps(s: State, c: Const, h: int) -> None:
    """Let what a hypothesis is of jump; where a sensor tells nothing, what actuators may do beside."""
    if c.kind[h] == SILENT:
        for i in range(c.m):
            add_jump(s, c, h, OFFSET, i)
    else:
        add_jump(s, c, h, c.kind[h], c.place[h])


@kernel(inlined=False)
def add_jump(s: State, c: Const, h: int, kind: int, i: int) -> None:
    """Let a slow state of a filter jump, at this sample or up to BACK samples before."""
    k = slot_of(c, kind, i)
    if kind == SENSOR:
        s.cov[h, c.n + k, c.n + k] += c.free[k]
        return
    for r in range(c.n):
        s.gain[r] = 0.0  # what the fault has done to x by now
        s.work[0, r] = s.plant.now[h, r, c.n + i]  # what one sample of it has done so many samples later
    seen = 0.0  # energy of what one unit of it has shown in the samples before this one
    for back in range(BACK + 1):
        if back > 0:
            by = 1.0 if kind == OFFSET else s.past[back - 1, i]
            for r in range(c.n):
                s.gain[r] += s.work[0, r] * by
                s.work[1, r] = dot(s.plant.now[h, r], s.work[0], c.n)
            copy_row(s.work[0], s.work[1], c.n)
        # A fault that began then would have been seen since, if it were larger than this.
        share = min(c.free[k] / len(BEGINNINGS), c.gate / max(seen, 1e-300))
        for j in range(c.p):
            shows = dot(c.c[j], s.gain, c.n)
            seen += shows * shows / (4.0 * c.r[j])
        if back not in BEGINNINGS:
            continue
        for r in range(c.n):
            for j in range(c.n):
                s.cov[h, r, j] += share * s.gain[r] * s.gain[j]
            s.cov[h, r, c.n + k] += share * s.gain[r]
            s.cov[h, c.n + k, r] += share * s.gain[r]
        s.cov[h, c.n + k, c.n + k] += share


@kernel
def _expected(s: State, c: Const, h: int, j: int) -> float:
    """Return what a filter expects of a sensor."""
    place = c.n + c.q + 2 * c.m + j
    shown = _shown(s, c, h, j)
    if c.gains == 1:
        shown *= 1.0 + s.z[h, place + c.p]
    if c.lag > 0:
        shown += (s.aligned.point[j] - s.z[h, c.lag + j]) * s.aligned.slope[j]
    return float(s.z[h, place] + shown)


@kernel
def _shown(s: State, c: Const, h: int, j: int) -> float:
    """Return what a sensor would show if it were exact, C x."""
    return float(dot(c.c[j], s.z[h], c.n))


@kernel
def _seen(s: State, c: Const, h: int, j: int) -> float:
    """Return H of a sensor times the vector in ``gain``."""
    place = c.n + c.q + 2 * c.m + j
    by_state = dot(c.c[j], s.gain, c.n)
    if c.gains == 1:
        by_state = by_state * (1.0 + s.z[h, place + c.p]) + s.gain[place + c.p] * _shown(s, c, h, j)
    if c.lag > 0:
        by_state -= s.gain[c.lag + j] * s.aligned.slope[j]
    return float(by_state + s.gain[place])


@kernel
def _show(s: State, c: Const, h: int, j: int) -> float:
    """Put P H' of a sensor into ``gain``; returns H P H' + R."""
    place = c.n + c.q + 2 * c.m + j
    scale, shown = 1.0, 0.0
    if c.gains == 1:
        scale, shown = 1.0 + s.z[h, place + c.p], _shown(s, c, h, j)
    for r in range(c.total):
        value = dot(s.cov[h, r], c.c[j], c.n) * scale + s.cov[h, r, place]
        if c.gains == 1:
            value += s.cov[h, r, place + c.p] * shown
        if c.lag > 0:
            value -= s.cov[h, r, c.lag + j] * s.aligned.slope[j]
        s.gain[r] = value
    return float(c.r[j] + s.aligned.extra[j] + _seen(s, c, h, j))


@kernel(inlined=False)
def _squared(s: State, c: Const, h: int) -> float:
    """Return the normalised innovation squared of the innovations in ``e``; one of a silent sensor is 0 there."""
    p = c.p
    for j in range(p):
        size = _show(s, c, h, j)
        for i in range(j + 1):
            s.spread[j, i] = _seen(s, c, h, i) if _tells(s, c, h, i) and _tells(s, c, h, j) else 0.0
        s.spread[j, j] = s.own[j] = size
    decompose(s.spread, s.spread, p)
    return float(solve(s.spread, s.e[h], s.rest, p))


@kernel
def innovate(s: State, c: Const, h: int, y: f8s) -> None:
    """Compute what a sample has beyond what a filter expects; sets ``e``, ``own`` and ``square``."""
    for j in range(c.p):
        s.e[h, j] = y[j] - _expected(s, c, h, j)
    s.square = _squared(s, c, h)


@kernel(inlined=False)
def correct(s: State, c: Const, h: int, y: f8s, known: bool, restless: bool) -> None:
    """Take a sample of the outputs with one filter; sets ``e``, ``left`` and ``told``.

    Args:
        h: the filter.
        y: outputs.
        known: x is known; otherwise what is slow is considered only, and nothing jumps.
        restless: something may have jumped, though this sample alone does not show it.
    """
    may_jump = known and (slot(c, h) >= 0 or (c.kind[h] == SILENT and c.q == 0))
    told, left = 0.0, 0.0
    for j in range(c.p):
        s.e[h, j] = y[j] - _expected(s, c, h, j) if _tells(s, c, h, j) else 0.0
    s.jumped[h] = 0
    if may_jump and (restless or _squared(s, c, h) > c.gate):
        _add_jumps(s, c, h)
        s.jumped[h] = 1
        told += JUMP
    for j in range(c.p):
        if not _tells(s, c, h, j):
            told += c.range[j]
            continue
        size = _show(s, c, h, j)
        rest = y[j] - _expected(s, c, h, j)
        share = rest / size
        most = c.total if known else c.n
        for r in range(most):
            s.z[h, r] += s.gain[r] * share
        for r in range(most):
            weight = s.gain[r] / size
            for k in range(r, c.total):
                s.cov[h, r, k] -= weight * s.gain[k]
                s.cov[h, k, r] = s.cov[h, r, k]
        told -= 0.5 * (log(2.0 * pi * size) + rest * share)
        left += rest * share
    s.told[h], s.left[h] = told, left


@kernel
def _columns_of_slow(s: State, c: Const, h: int, u: f8s) -> None:
    """Compute the columns of F of the slow states into ``by_slow``."""
    n, m, q = c.n, c.m, c.q
    for r in range(n):
        for k in range(q):
            value = dot(s.plant.by_entry[h, k, r], s.z[h], n)
            s.by_slow[r, k] = plus(value, s.plant.by_entry[h, k, r, n:], u, m)
        for i in range(m):
            s.by_slow[r, q + i] = s.plant.now[h, r, n + i]
            s.by_slow[r, q + m + i] = s.plant.now[h, r, n + i] * u[i]


@kernel(inlined=False)
def predict(s: State, c: Const, h: int, u: f8s, unsure: i8s) -> None:
    """Take one filter to the next sample, the commands ``u`` held till then.

    Args:
        h: the filter.
        u: commands.
        unsure: of each command, 1: its frame did not come, it may be another.
    """
    n, m, q, size = c.n, c.m, c.q, c.total
    moved, far, relative = 0.0, 0.0, 0.0
    for k in range(q):
        apart = s.z[h, n + k] - s.plant.at[h, k]
        moved = max(moved, apart * apart / c.prior[k])
        apart = s.z[h, n + k] - s.plant.derived[h, k]
        far = max(far, apart * apart / c.prior[k])
        relative = max(relative, s.cov[h, n + k, n + k] * c.relative[k])
    if far > DERIVED * DERIVED:
        derive(s, c, h)
    elif moved > FRESH * FRESH:
        matrices.refresh(s.plant, c.plant, h, s.z[h, n:])
    relative *= SECOND_ORDER * SECOND_ORDER
    _columns_of_slow(s, c, h, u)
    slow = q + 2 * m
    for r in range(n):
        value = dot(s.plant.now[h, r], s.z[h], n)
        for i in range(m):
            acts = u[i] * (1.0 + s.z[h, n + q + m + i]) + s.z[h, n + q + i]
            value += s.plant.now[h, r, n + i] * acts
        # What the estimate of the entries has moved by since the matrices were computed: once it is well known even a
        # hundredth of what was told is many of its standard deviations.
        for k in range(q):
            value += s.by_slow[r, k] * (s.z[h, n + k] - s.plant.at[h, k])
        s.gain[r] = value
        for k in range(size):
            total = 0.0
            for i in range(n):
                total += s.plant.now[h, r, i] * s.cov[h, i, k]
            for i in range(slow):
                total += s.by_slow[r, i] * s.cov[h, n + i, k]
            s.work[r, k] = total
        s.second[r] = 0.0
        for k in range(q):
            for i in range(q):
                s.second[r] += s.by_slow[r, k] * s.cov[h, n + k, n + i] * s.by_slow[r, i]
    _spread(s, c, h, unsure, relative)


@kernel
def _kept(s: State, c: Const, h: int, k: int) -> float:
    """Return what a sample leaves of a slow state, under a hypothesis."""
    if k == slot(c, h) or s.followed[k] == 1:
        return 1.0
    if k < c.q and (s.varies == 1 or c.kind[h] == VARYING):
        return float(c.vary)
    return float(c.keep[k])


@kernel
def _spread(s: State, c: Const, h: int, unsure: i8s, relative: float) -> None:
    """Take covariance and slow states to the next sample, from what :func:`predict` has left in the scratch."""
    n, m, size = c.n, c.m, c.total
    slow, free = c.q + 2 * m, slot(c, h)
    copy_row(s.z[h], s.gain, n)
    for r in range(n):
        for k in range(r, n):
            total = dot(s.work[r], s.plant.now[h, k], n)
            total = plus(total, s.work[r, n:], s.by_slow[k], slow)
            for i in range(m):
                if unsure[i] == 1:
                    total += s.plant.now[h, r, n + i] * s.plant.now[h, k, n + i] * c.command[i]
            s.cov[h, r, k] = s.cov[h, k, r] = total
        s.cov[h, r, r] += c.noise[r] + relative * s.second[r]
        for k in range(size - n):
            s.cov[h, r, n + k] = s.cov[h, n + k, r] = s.work[r, n + k] * _kept(s, c, h, k)
    for k in range(size - n):
        own = _kept(s, c, h, k)
        s.z[h, n + k] *= own
        for i in range(k, size - n):
            s.cov[h, n + k, n + i] *= own * _kept(s, c, h, i)
            s.cov[h, n + i, n + k] = s.cov[h, n + k, n + i]
        if s.followed[k] == 1:
            s.cov[h, n + k, n + k] += c.free[k] * (LOOSELY if k == free else s.loose)
        elif k == free:
            s.cov[h, n + k, n + k] += c.drive[k]
        else:
            s.cov[h, n + k, n + k] += (1.0 - own * own) * c.prior[k]


@kernel
def remember(s: State, c: Const, u: f8s) -> None:
    """Keep the commands of a sample."""
    for back in range(BACK - 1, 0, -1):
        copy_row(s.past[back], s.past[back - 1], c.m)
    copy_row(s.past[0], u, c.m)


@kernel
def size_of(s: State, c: Const, part: int, y: f8s) -> float:
    """Return the size of a part's fault that is followed, in the unit of its signal; actuators first, then sensors."""
    if part < c.m:
        return float(s.z[0, c.n + slot_of(c, OFFSET, part)])
    j = part - c.m
    return float(y[j] - _expected(s, c, 0, j) if s.silent[j] == 1 else s.z[0, c.n + slot_of(c, SENSOR, j)])


@kernel
def off_the_bounds(s: State, c: Const, h: int) -> float:
    """Return the sum of squares of what is slow over its bounds: how far the plant is from what was told."""
    total = 0.0
    for k in range(c.total - c.n):
        if c.prior[k] > 0.0 and s.followed[k] == 0:
            total += s.z[h, c.n + k] * s.z[h, c.n + k] / c.prior[k]
    return float(total)
