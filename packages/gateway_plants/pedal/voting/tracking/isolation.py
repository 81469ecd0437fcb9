"""Which channels are held for failed, and when they are taken back."""

from __future__ import annotations

import numpy as np

from gateway_fdi.jit import f8s, kernel
from gateway_plants.pedal.voting.simple import MOST_CHANNELS
from gateway_plants.pedal.voting.tracking import channel_activity, mismatch, track
from gateway_plants.pedal.voting.tracking.channel_activity import FEW, SMOOTH
from gateway_plants.pedal.voting.tracking.scale import GATE
from gateway_plants.pedal.voting.tracking.shape import (
    COMMON,
    DRIFTED,
    FROZEN,
    IMPLAUSIBLE,
    ISOLATE,
    RELAPSE,
    RESTORE,
    SURE,
    TRUSTED,
    Const,
    State,
)

#: Samples on one line from which on a channel that goes slowly is a foot's way; likewise of one that has jumped.
STEADY, WILD = 40, 6


@kernel
def isolate(s: State, i: int, why: int) -> None:
    """Hold channel ``i`` for failed."""
    s.isolated |= 1 << i
    s.why[i] = why
    s.back[i] = 0
    if s.drift:
        mismatch.start(s.mismatch)  # it was this channel that drifted


@kernel
def restore(s: State, i: int) -> None:
    """Trust channel ``i`` again."""
    s.isolated &= ~(1 << i)
    s.why[i] = TRUSTED
    s.rejected[i] = 0


@kernel
def _frozen(s: State, c: Const, y: f8s, i: int, others: int) -> bool:
    """Tell whether channel ``i`` has stopped while one of the others goes on.

    It repeats itself while another moves away; or it is silent, as no live channel with noise is, while the others
    are not, and stray by more than resolution lets two live channels differ: noise may be less than the data sheet
    says. One that others stand still with is not frozen.
    """
    h = s.habits
    # A channel that has repeated itself before, in a quiet time or behind a filter, may do so again.
    patience = max(s.scale.silent, 2 * h.longest[i] + 2)
    company, silent = False, h.same[i] >= patience and c.floor < y[i] < c.ceiling
    for j in range(c.channels):
        if others & (1 << j):
            company = company or (h.same[j] >= FEW and abs(s.z[j] - s.z[i]) <= s.scale.agree + s.swing)
            k = i * MOST_CHANNELS + j
            comes = abs(y[j] - y[i]) < abs(h.anchor[k] - y[i])  # after it, as one that lags does
            lively = h.same[j] <= patience // 2 and h.strayed[k] >= s.scale.lively + s.swing and not comes
            # One that jumps often strays by that: beside it a quiet time has to be twice as long.
            silent = silent and lively and (h.rough[j] <= SMOOTH or h.same[i] >= 2 * patience)
    if company:
        return False
    # Against a track that is sure a few impulses in a row are not enough.
    smooth = 3 if s.sure >= SURE else 2
    # Where readings are so coarse that a line may jump farther than a foot moves, few samples prove none.
    smooth = int(smooth * max(2.0 * s.scale.straight / c.slew, 1.0))
    far = 2.0 * (s.scale.agree + s.swing)
    mover, moved = channel_activity.outrun(h, c.channels, i, y, smooth, far, c.creep)
    if mover < 0:
        mover, moved = channel_activity.outrun(h, c.channels, i, y, STEADY, far, c.amble)
    if mover < 0 or others & (1 << mover) == 0:
        return bool(silent)
    # One that has jumped as no foot moves, or jumps often, has to go on for longer, but beside one at a rail.
    torn = abs(h.torn[mover]) > s.scale.agree or h.rough[mover] > SMOOTH
    # So has one that has just left: a noise that begins may put a few samples on a line.
    short = (torn and h.line[mover] < WILD) or h.away[i * MOST_CHANNELS + mover] < WILD
    if short and c.floor < y[i] < c.ceiling:
        return bool(silent)
    # One that lags comes after a channel that has stopped, and ends beside it, however far its way was; from a frozen
    # one it goes away by all of that. Between the two is the half.
    away = (y[mover] - y[i]) / moved >= 0.5
    return bool(silent or away or abs(h.moved[i]) > s.scale.agree)


@kernel
def freeze(s: State, c: Const, y: f8s, trusted: int) -> int:
    """Isolate a frozen channel; returns the trusted ones that are left."""
    n, h = c.channels, s.habits
    for i in range(n):
        others = trusted & ~(1 << i)
        if h.same[i] < FEW or not trusted & (1 << i) or others == 0:
            continue
        if not _frozen(s, c, y, i, others):
            continue
        # What looked like a mismatch was the frozen channel, and the track went half its way.
        mismatch.forget(s.mismatch, n, i)
        isolate(s, i, FROZEN)
        trusted = others
        track.expect(s, c, y)
        for j in range(n):
            if others == 1 << j and h.line[j] >= 1:
                track.follow(s, c, j)
    return int(trusted)


@kernel
def _common(s: State, c: Const, i: int, j: int) -> float:
    """Return by how much a supply moves channel ``j`` where it moves channel ``i`` by one; 0: there is no such supply.

    A share s of it makes s (a + b x) of a reading a + b x, and moves the position by (s - 1) (a / b + x): from where
    channel ``i`` jumped.
    """
    of_i = c.lean[i] + s.habits.origin[i]
    if c.common == 0 or of_i == 0.0:
        return 0.0
    return float((c.lean[j] + s.habits.origin[i]) / of_i)


@kernel
def witnessed(s: State, c: Const, trusted: int, i: int) -> bool:
    """Tell whether another channel that goes on bears witness that it is ``i`` that is wrong.

    Of three the track is what two say. Of two that part smoothly, as a foot could move, either may be the one that
    does not: a track that stands still with a stuck channel rejects the one that moves. The one that has jumped is
    wrong; if there is none, nobody can tell.

    Args:
        trusted: bits of the channels that are not held for failed.
        i: the channel.
    """
    n, count = c.channels, 0
    for j in range(n):
        if trusted & (1 << j):
            count += 1
    for j in range(n):
        if j == i or trusted & s.used & (1 << j) == 0:
            continue
        if s.habits.same[j] >= ISOLATE and (count > 2 or abs(s.habits.torn[i]) <= s.scale.agree):
            continue  # a frozen channel is none, but where the other one of two did what the quantity cannot
        if count == 2 and s.drift == 1 and abs(s.habits.torn[i]) <= s.scale.agree:
            continue  # of two that have parted smoothly before nobody can tell, but by what no quantity does
        if count > 2 or channel_activity.jumped(s.habits, i, j, s.scale.agree, _common(s, c, i, j)):
            return True
    return False


@kernel
def judge(s: State, c: Const, trusted: int) -> None:
    """Isolate what was rejected too often or drifts; restore what follows the track again."""
    n, m, h = c.channels, s.motion, s.habits
    for i in range(n):
        bit = 1 << i
        if s.isolated & bit == 0:
            if s.rejected[i] >= ISOLATE and witnessed(s, c, trusted, i):
                isolate(s, i, IMPLAUSIBLE)
            continue
        if s.used == 0:
            continue
        off = s.z[i] - m.x
        gate = GATE * np.sqrt(m.p00 + 2.0 * s.scale.variance)
        inside = abs(off) <= gate
        if not inside and abs(off) <= gate + s.slack:
            continue  # it may be a lag, or what it was isolated for
        if s.why[i] == DRIFTED:
            if inside:
                mismatch.learn(s.mismatch, i, off, 1.0, False)
            inside = inside and abs(s.mismatch.level[i] - mismatch.centre(s.mismatch, n)) < (c.tolerance / 2.0)
        if inside and not (s.why[i] == FROZEN and h.same[i] >= FEW):
            s.back[i] += 1
        else:
            s.back[i] = max(s.back[i] - RELAPSE, 0)
        if s.back[i] >= RESTORE:
            restore(s, i)


@kernel
def reconcile(s: State, c: Const) -> None:
    """Restore isolated channels when nothing else is believed and all agree with each other again."""
    n = c.channels
    low, high, count = np.inf, -np.inf, 0
    for i in range(n):
        if s.z[i] == s.z[i] and not (s.why[i] == FROZEN and s.habits.same[i] >= FEW):
            low, high, count = min(low, s.z[i]), max(high, s.z[i]), count + 1
    s.accord = s.accord + 1 if count >= 2 and high - low <= s.scale.agree else 0
    if s.accord >= COMMON:
        for i in range(n):
            if s.isolated & (1 << i):
                restore(s, i)


@kernel
def _undecided(s: State, c: Const) -> bool:
    """Tell whether a channel repeats itself while another goes faster than a drift: it may be frozen."""
    h = s.habits
    for i in range(c.channels):
        if s.isolated & (1 << i) or h.same[i] < FEW:
            continue
        for j in range(c.channels):
            k = i * MOST_CHANNELS + j
            if j != i and h.away[k] > 0.0 and abs(h.last[j] - h.anchor[k]) >= c.amble * h.away[k]:
                return True
    return False


@kernel
def drifting(s: State, c: Const) -> None:
    """Look at the slow mismatch: of three channels the one that drifts can be named, of two it cannot."""
    n, b = c.channels, s.mismatch
    s.spread = mismatch.spread(b, n, s.isolated)
    # A lag that is small, and the steps of the readings, are learned as a mismatch for a while.
    usual = c.tolerance + s.scale.step + (s.slack if n < MOST_CHANNELS else 0.0)
    s.slow_limit = 0.8 * c.tolerance if s.drift else usual
    if s.drift == 0 and (s.slack >= s.scale.agree or (n < MOST_CHANNELS and _undecided(s, c))):
        return  # it may be a lag: at rest it goes, a drift stays
    s.drift = 1 if s.spread > s.slow_limit else 0
    if n < MOST_CHANNELS or s.drift == 0 or s.isolated != 0:
        return
    middle = mismatch.centre(b, n)
    worst, most, second = 0, 0.0, 0.0
    for i in range(n):
        off = abs(b.level[i] - middle)
        if off > most:
            worst, most, second = i, off, most
        else:
            second = max(second, off)
    if most > c.tolerance > 2.0 * second:
        s.drift = 0
        isolate(s, worst, DRIFTED)
