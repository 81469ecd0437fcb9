"""Which two faults fit, the second of which began later.

Beside the form of all blocks there are those of the blocks since some onsets, each some 4, 8, 16, 32 blocks back. A
first fault f that is there since the start, and a second one g since the onset t, have the form

    A = [A_ff(0)  A_fg(t)]      b = [b_f(0)]
        [A_gf(t)  A_gg(t)]          [b_g(t)]

with (0) for sums over all blocks and (t) for those since t, what may be off integrated out with A_xf(0) and A_xg(t).
Sizes are of least squares. Each gain u_i is known to a share: b := b - A u, u the sizes in their columns, and the
deviation from it, N(0, (error s)^2), is integrated out. One of the two is among the faults that fit best alone, or of
the two that did before.
"""

from __future__ import annotations

from math import inf, log
from typing import Annotated, Any

from gateway_fdi.evidence import model
from gateway_fdi.evidence.quadratic import blur
from gateway_fdi.jit import f8, f8s, i8, i8s, kernel, means
from gateway_fdi.linear_algebra import copy
from gateway_fdi.masks import clear, exclude, include

#: Logarithm of the likelihood by which a fault, or a pair of them, that fits less well is unlikely.
LESS = 6.0
#: Share of what is explained by which a fault is unlikely besides; and faults that take the place of some of a pair.
NEARLY, PAIR_NEARLY = 0.1, 0.005
#: Share of the best one's from which on a fault is not out of the question while sizes are not sure.
LEANS = 0.5
#: Share of what a block says that the next one leaves.
KEPT = 0.975
#: Onsets of a second fault that move, and blocks between two of the latest; one more stays where the best pair has it.
MOVING, FIRST = 4, 4
ONSETS = MOVING + 1
#: Lengths of the records. "joint": what may be off, and the gains twice.
LENGTHS = model.LENGTHS | {"joint": 3}


class State(model.State, lengths=LENGTHS):
    """State."""

    since_a: Annotated[f8s, "columns", "columns"] = means("A of all blocks, and of what was known before")
    since_b: Annotated[f8s, "columns"] = means("b of all blocks")
    squares: f8 = means("sum of squares of the residuals over their noise")
    looks: f8 = means("number of independent residuals")
    own_squares: f8 = means("squares of the block at hand")
    own_looks: f8 = means("independent residuals of the block at hand")
    alone: Annotated[f8s, "faults"] = means("logarithm of the likelihood ratio of each fault alone")
    excess: f8 = means("variance of what the best fault leaves, over that of the noise, 1 at least")
    both: Annotated[f8s, "faults", "faults"] = means("logarithm of the likelihood ratio of each pair")
    pair: Annotated[i8s, 2] = means("faults that were the best two; -1: none")
    two: f8 = means("logarithm of the likelihood ratio of the best two")
    count: i8 = means("blocks since the start")
    age: Annotated[i8s, ONSETS] = means("blocks since each onset")
    later_a: Annotated[f8s, ONSETS, "columns", "columns"] = means("A of the blocks since an onset")
    later_b: Annotated[f8s, ONSETS, "columns"] = means("b of the blocks since an onset")
    joint_a: Annotated[f8s, "joint", "joint"] = means("scratch: A of faults since the start, and since an onset")
    joint_b: Annotated[f8s, "joint"] = means("scratch: b likewise")


@kernel
def begin(s: Any) -> None:
    """Forget all blocks."""
    s.since_b[:] = 0.0
    s.since_a[:, :] = 0.0
    s.squares = s.looks = s.own_squares = s.own_looks = 0.0
    s.count = 0
    s.pair[:] = -1
    s.age[:] = 0
    s.later_b[:, :] = 0.0
    s.later_a[:, :, :] = 0.0


@kernel
def take(s: Any, n: int) -> None:
    """Take a block of so many columns into the sums since each onset; each onset moves to where the next one stood."""
    for k in range(MOVING - 1, -1, -1):
        if s.count % (FIRST << k) == 0 and k > 0:
            _move(s, k, k - 1)
        elif s.count % FIRST == 0 and k == 0:
            s.age[0] = 0
            s.later_b[0, :] = 0.0
            s.later_a[0, :, :] = 0.0
    s.count += 1
    for k in range(ONSETS):
        s.age[k] += 1
        for i in range(n):
            s.later_b[k, i] = KEPT * s.later_b[k, i] + s.b[i]
            for j in range(n):
                s.later_a[k, i, j] = KEPT * s.later_a[k, i, j] + s.a[i, j]


@kernel
def _move(s: Any, k: int, source: int) -> None:
    """Let an onset be where another one is."""
    n = len(s.b)
    s.age[k] = s.age[source]
    copy(s.later_b[k], s.later_b[source], n)
    for i in range(n):
        copy(s.later_a[k, i], s.later_a[source, i], n)


@kernel
def second(s: Any, c: Any, own: Any, left: float, best: float) -> float:
    """Return by how much two faults fit better than one: the logarithm of the likelihood ratio.

    Leaves the faults of all pairs that fit in ``own.paired``, and those that each of these pairs has in ``own.sure``.

    Args:
        s: record of State; its scratch has the form of all blocks, what may be off integrated out.
        c: record of the constants.
        own: record of the decision's state.
        left: sum of squares over what noise leaves of it.
        best: likelihood of the best fault, over the excess.
    """
    p, n = c.slow, c.slow + c.first[c.faults]
    s.two, onset = -inf, -1
    one, other = s.pair[0], s.pair[1]
    s.both[:, :] = -inf
    for k in range(-1, ONSETS):
        if k >= 0 and s.age[k] < s.count:
            _join(s, c, k)
        for f in range(c.faults):
            for g in range(c.faults if k >= 0 else f):
                leans = f in (one, other) or g in (one, other) or max(s.alone[f], s.alone[g]) >= LEANS * best * s.excess
                if f == g or not leans:
                    continue
                if k < 0:
                    value = _both(s, c, s.work_a, s.work_b, p + c.first[f], p + c.first[g], f, g)
                elif s.age[k] < s.count:
                    value = _both(s, c, s.joint_a, s.joint_b, p + c.first[f], n + c.first[g], f, g)
                else:
                    continue
                if value > s.two:
                    s.two, onset, s.pair[0], s.pair[1] = value, k, f, g
                s.both[f, g] = s.both[g, f] = max(s.both[f, g], value)
    if 0 <= onset < MOVING:
        _move(s, MOVING, onset)
    clear(own.sure)
    clear(own.paired)
    if s.two == -inf:
        return -inf  # no two can be told apart
    _list(s, c, own, max((left + s.looks - 2.0 * s.two) / s.looks, 1.0))
    return _likelihood(s, left - 2.0 * s.two) - _likelihood(s, left - 2.0 * best * s.excess)


@kernel
def _likelihood(s: Any, left: float) -> float:
    """Return the logarithm of the likelihood of what is left of the squares: the noise's variance may be any from 1 on.

    Its largest value over the variance v, of -(left + looks) / 2 v - looks / 2 log v.
    """
    excess = max(left / s.looks + 1.0, 1.0)
    return float(-0.5 * (left + s.looks) / excess - 0.5 * s.looks * log(excess))


@kernel
def _list(s: Any, c: Any, own: Any, excess: float) -> None:
    """List the faults of all pairs that fit, and those that each of these pairs has."""
    include(own.sure, s.pair[0])
    include(own.sure, s.pair[1])
    for f in range(c.faults):
        for g in range(f):
            if s.two - s.both[f, g] > LESS * excess + PAIR_NEARLY * _at_stake(s, f, g):
                continue
            include(own.paired, f)
            include(own.paired, g)
            for k in s.pair:
                if k not in (f, g):
                    exclude(own.sure, k)


@kernel
def _at_stake(s: Any, f: int, g: int) -> float:
    """Return what the best pair explains by the faults that two others take the place of."""
    kept = 0.0
    for k in s.pair:
        kept += s.alone[k] if k in (f, g) else 0.0
    return float(max(s.two - kept, 0.0))


@kernel
def _join(s: Any, c: Any, k: int) -> None:
    """Leave the form of faults since the start and since an onset, what may be off integrated out."""
    p, n = c.slow, c.slow + c.first[c.faults]
    many = n + c.first[c.faults]
    a, b, later_a, later_b = s.joint_a, s.joint_b, s.later_a[k], s.later_b[k]
    for i in range(n):
        copy(a[i], s.since_a[i], n)
        b[i] = s.since_b[i]
        for j in range(n, many):
            a[i, j] = a[j, i] = later_a[i, j - n + p]
    for i in range(n, many):
        b[i] = later_b[i - n + p]
        for j in range(n, many):
            a[i, j] = later_a[i - n + p, j - n + p]
    for i in range(p):
        blur(a, b, many, i, 0.0)


@kernel
def _both(s: Any, c: Any, a: Any, b: Any, one: int, other: int, f: int, g: int) -> float:
    """Return the logarithm of the likelihood ratio of two faults by a form, from the rows of their first gains."""
    m = c.first[f + 1] - c.first[f]
    both = m + c.first[g + 1] - c.first[g]
    y, z, aa, ab, bb = 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(both):
        row = one + i if i < m else other + i - m
        s.one_b[i] = b[row]
        y += s.one_b[i] if i < m else 0.0
        z += 0.0 if i < m else s.one_b[i]
        for j in range(both):
            s.one_a[i, j] = a[row, one + j if j < m else other + j - m]
            aa += s.one_a[i, j] if i < m and j < m else 0.0
            ab += s.one_a[i, j] if i < m <= j else 0.0
            bb += s.one_a[i, j] if i >= m and j >= m else 0.0
    area = aa * bb - ab * ab
    if not area > 1e-9 * aa * bb:
        return -inf
    first, later = (bb * y - ab * z) / area, (aa * z - ab * y) / area
    if first == 0.0 or later == 0.0:
        return -inf  # one of no size is not there
    value = 0.5 * (first * y + later * z)
    for i in range(both):
        for j in range(both):
            s.one_b[i] -= s.one_a[i, j] * (first if j < m else later)
    for i in range(both):
        value += blur(s.one_a, s.one_b, both, i, (c.error * (first if i < m else later)) ** -2)
    return float(value)
