"""By how much a filter delays one channel behind another, how sure that is, and what they may differ by meanwhile.

**The estimator.** Let channel 0 read x(t), and channel i the same behind a filter of first order with time constant
L [periods], slope 1 + g and offset o: y0 = yi + L yi' but for g and o. A delay, or a mean, is that up to the second
order. So the difference D = y0 - yi is a line in the level X and the rate R of the quantity, [%] and [% / period]:

    D = o + g X + L R + noise

Readings are gathered in blocks of some milliseconds; of a block D and X are means, R is the slope of the mean of both
channels, by least squares over the times that its samples have. A sample that was lost is not there, and a sample's
time comes from its number: neither makes a rate or a difference wrong. What is slow is taken off D, X and R by one and
the same linear filter, however far its blocks lie apart, so that the line stays true, o goes, and a drift of o hardly
matters. L and g are found by least squares over the blocks in which the quantity moves: with sums S over them

    L = (S_dr S_xx - S_dx S_xr) / (S_rr S_xx - S_xr^2),   var L = v S_xx / (S_rr S_xx - S_xr^2)

v [%^2] is what the line leaves of a block, or what the noise does if that is more. R has noise of its own, which makes
L too small by its share in S_rr: a block counts only if R is many times that. The rate is that of the mean of both
channels, not that of the slower one: that would be off by L x''/2, which is orthogonal to x' over a movement that
begins and ends at rest, and makes 1 / (1 + (L w)^2 / 4) of L, w^2 the mean square of x'' over that of x'.

**It goes on for ever.** When the quantity has moved up and down enough, that is one measurement of L with its variance.
It is put together with what was known as in a Kalman filter whose L wanders; one that contradicts what is known is
believed as soon as the next one says the same. Channels are compared as they are aligned by then: a measurement is of
what is left, so that an L that was wrong is put right, and what a filter of first order is unlike is measured as it
matters. Channels that differ by a gain that no sensor has tell nothing, and a lag beyond the largest is a fault.

**What is allowed for.** The quicker channels are filtered as the slowest one is. What may be left is allowed for, in
proportion to the rate; until the lag is known all that the largest would make.
"""

from __future__ import annotations

import math
from typing import Annotated

from gateway_fdi.jit import Record, f8, f8s, i8, i8s, kernel, means
from gateway_plants.pedal.voting.movement import MOST_LOST, bent, filtered
from gateway_plants.pedal.voting.simple import MOST_CHANNELS

#: From this period of the samples on no lag is looked for [ms].
COARSE_MS = 5.0
#: Length of a block [ms], least samples of one, and lengths that it may spread over if samples were lost.
BLOCK_MS, LEAST_SAMPLES, SPREAD = 8.0, 3, 3
#: What is slower is offset and mismatch, no lag [ms].
SLOW_MS = 60.0
#: Movement that tells lags apart: what a lag of this makes, squares over those of noise: in a block that counts, and
#: the sum that is enough, either way.
TELLING_MS, MOVES, TELLING = 0.5, 0.1, 40.0
#: Blocks that are enough; after so many the older ones count half.
ENOUGH, MANY = 16, 512
#: Neighbouring blocks err alike: their number counts as so many times less.
ALIKE = 3.0
#: Standard deviation with which a lag is known [ms], that by which it wanders from one measurement to the next, and
#: standard deviations, with a least way [ms], by which one contradicts what is known.
KNOWN_MS, WANDERS_MS, CONTRADICTS, LEAST_WAY_MS = 0.8, 0.05, 3.0, 0.4
#: Share of a measurement that leaves less than before in what is unlike a filter of first order.
EASES = 0.3
#: A difference of slopes that no two sensors have.
MOST_GAIN = 0.2
#: Less than this is no lag [ms].
LEAST_MS = 1.0
#: What is allowed for fades by this power of the filter's own: turns of the pedal go through no movement.
FADES = 0.33
#: A delay, or a mean, is most like a filter of first order with a time constant up to so many times as long.
LIKE = 1.6
#: Time constant of the quick filter that tells the rate; the slow one is so many times the largest lag, one of these.
QUICK_MS, WIDER, WIDE_MS = 1.0, 1.2, (2.0, 3.5, 5.5, 8.0, 11.5, 16.0)
#: What is allowed for until the lag is known, in units of what the largest makes; then, at least, at most, in units of
#: the error that was left, and in standard deviations of the lag.
UNKNOWN, LEFT_LEAST, LEFT_MOST, LEFT, DEVIATIONS = 1.5, 0.15, 2.0, 5.0, 2.0


class Const(Record):
    """Constants."""

    samples: i8 = means("samples of a block")
    slow: f8 = means("share of a new block in what is slow")
    most: f8 = means("largest lag that is none", "periods")
    least: f8 = means("smallest lag that is one", "periods")
    telling: f8 = means("lag whose effect, beside noise, tells lags apart", "periods")
    known: f8 = means("standard deviation with which a lag is known", "periods")
    wanders: f8 = means("standard deviation by which a lag wanders from one measurement to the next", "periods")
    way: f8 = means("least way by which a measurement contradicts what is known", "periods")
    quick: f8 = means("pole of the quick filter that tells the rate")
    wide: f8 = means("pole of the slow filter that tells the rate")
    apart: f8 = means("difference of their time constants", "periods")
    fade: f8 = means("share of what is allowed for that is left a period later")
    none: f8 = means("so little of it is nothing", "%")


class Block(Record):
    """Sums over samples that are gathered; of each channel where they are arrays."""

    count: i8 = means("samples")
    age: f8 = means("time since the first", "periods")
    t: f8 = means("times", "periods")
    tt: f8 = means("squares of times", "periods^2")
    y: Annotated[f8s, MOST_CHANNELS] = means("readings", "%")
    ty: Annotated[f8s, MOST_CHANNELS] = means("readings by times", "% periods")


class State(Record):
    """State; of each channel where it is an array. Its differences D are those to the first one."""

    block: Block = means("samples that are gathered")
    since: f8 = means("time since the last block; 0: none yet", "periods")
    slow_d: Annotated[f8s, MOST_CHANNELS] = means("what is slow of D", "%")
    slow_x: Annotated[f8s, MOST_CHANNELS] = means("what is slow of X", "%")
    slow_r: Annotated[f8s, MOST_CHANNELS] = means("what is slow of R", "%/period")
    dd: Annotated[f8s, MOST_CHANNELS] = means("sum of D^2 over blocks", "%^2")
    dx: Annotated[f8s, MOST_CHANNELS] = means("sum of D X", "%^2")
    dr: Annotated[f8s, MOST_CHANNELS] = means("sum of D R", "%^2/period")
    xx: Annotated[f8s, MOST_CHANNELS] = means("sum of X^2", "%^2")
    xr: Annotated[f8s, MOST_CHANNELS] = means("sum of X R", "%^2/period")
    rr: Annotated[f8s, MOST_CHANNELS] = means("sum of R^2", "%^2/period^2")
    blocks: i8 = means("blocks in these sums")
    up: f8 = means("movement upwards, squares over those of noise")
    down: f8 = means("movement downwards, likewise")
    rate: f8 = means("rate of the last block", "%/period")
    behind: Annotated[f8s, MOST_CHANNELS] = means("lag behind the first channel", "periods")
    variance: Annotated[f8s, MOST_CHANNELS] = means("variance of behind", "periods^2")
    doubt: Annotated[f8s, MOST_CHANNELS] = means("a measurement of behind that contradicted it", "periods")
    doubted: i8 = means("1: there is one")
    found: Annotated[f8s, MOST_CHANNELS] = means("behind as measured last", "periods")
    found_variance: Annotated[f8s, MOST_CHANNELS] = means("variance of found", "periods^2")
    known: i8 = means("1: lags are known")
    tau: Annotated[f8s, MOST_CHANNELS] = means("lag behind the quickest channel", "periods")
    delay: Annotated[f8s, MOST_CHANNELS] = means("delay of the filter that brings it to the slowest channel", "periods")
    pole: Annotated[f8s, MOST_CHANNELS] = means("pole of that filter; 0: there is none")
    aligned: Annotated[f8s, MOST_CHANNELS] = means("output of that filter", "%")
    begun: Annotated[i8s, MOST_CHANNELS] = means("1: that filter has begun")
    unlike: f8 = means("what a measurement left", "periods")
    left: f8 = means("share of the movement that the alignment leaves")
    allowed: f8 = means("movement that is allowed for if nothing is aligned", "periods")
    slack: f8 = means("what is allowed for at present", "%")
    swing: f8 = means("what one channel may still move when another stands", "%")
    last: Annotated[f8s, MOST_CHANNELS] = means("last reading", "%")
    older: Annotated[f8s, MOST_CHANNELS] = means("reading before that", "%")
    gap: Annotated[f8s, MOST_CHANNELS] = means("time since the last reading", "periods")
    before: Annotated[f8s, MOST_CHANNELS] = means("time between these two", "periods")
    moved: Annotated[i8s, MOST_CHANNELS] = means("1: there is a new reading")
    quick: Annotated[f8s, MOST_CHANNELS] = means("behind the quick filter that tells the rate", "%")
    wide: Annotated[f8s, MOST_CHANNELS] = means("behind the slow filter that tells the rate", "%")


def prepare(c: Const, *, period_ms: float, most_ms: float) -> None:
    """Fill the constants.

    Args:
        period_ms: of the samples [ms].
        most_ms: largest lag between channels that is no fault [ms]; 0: there is none.
    """
    c.samples = max(round(BLOCK_MS / period_ms), LEAST_SAMPLES)
    c.slow = 1.0 - math.exp(-c.samples * period_ms / SLOW_MS)
    # Between samples that are far from each other nobody sees a lag.
    c.most, c.least = most_ms / period_ms if period_ms <= COARSE_MS else 0.0, LEAST_MS / period_ms
    c.telling, c.known = TELLING_MS / period_ms, KNOWN_MS / period_ms
    c.wanders, c.way = WANDERS_MS / period_ms, LEAST_WAY_MS / period_ms
    wide = next((tau for tau in WIDE_MS if tau >= WIDER * most_ms), WIDE_MS[-1])
    c.quick, c.wide = math.exp(-period_ms / QUICK_MS), math.exp(-period_ms / wide)
    c.apart = (wide - QUICK_MS) / period_ms
    c.none = 1e-3
    c.fade = c.wide**FADES


@kernel
def smooth(s: State, n: int, y: f8s, absent: int, straight: float, dt: float) -> int:
    """Return the bits of the channels that go on along a line, second differences up to ``straight``.

    Args:
        n: channels.
        y: readings, NaN: none that is one.
        absent: bits of the channels of which nothing has come.
        straight: largest second difference, of samples one period apart.
        dt: time since the last sample, in periods.
    """
    bits = 0
    for i in range(n):
        s.gap[i] += dt
        s.moved[i] = 0
        if absent & (1 << i):
            continue
        if s.before[i] > 0.0 and abs(bent(y[i], s.last[i], s.older[i], s.gap[i], s.before[i])) <= straight:
            bits |= 1 << i
        s.older[i], s.last[i] = s.last[i], y[i]
        s.before[i], s.gap[i] = s.gap[i], 0.0
        s.moved[i] = 1
    return bits


@kernel
def _rate(s: State, c: Const, n: int, smooth: int) -> float:
    """Follow the two filters that tell the rate; return the largest of a channel [% / period]."""
    most = 0.0
    for i in range(n):
        if s.moved[i] == 0:
            continue
        y, gap, last = s.last[i], s.before[i], s.older[i]
        if not math.isfinite(y - last) or not math.isfinite(s.wide[i]) or gap > MOST_LOST:
            s.quick[i] = s.wide[i] = y
            continue
        # What a channel jumps by is no movement.
        jump = 0.0 if smooth & (1 << i) else y - last
        s.quick[i] = filtered(s.quick[i] + jump, last + jump, y, c.quick, gap)
        s.wide[i] = filtered(s.wide[i] + jump, last + jump, y, c.wide, gap)
        if smooth & (1 << i):
            most = max(most, abs(s.quick[i] - s.wide[i]) / c.apart)
    return float(most)


@kernel
def align(s: State, c: Const, n: int, y: f8s, smooth: int, rate: float, out: f8s) -> None:
    """Bring all channels to the time of the slowest; sets ``s.slack`` and ``s.swing``.

    Args:
        s: record of State, which :func:`smooth` has told of the sample.
        n: channels.
        y: readings, NaN: none.
        smooth: bits of the channels that do not jump.
        rate: at which the quantity is thought to move [% / period].
        out: receives them, aligned.
    """
    s.slack = s.slack * c.fade if s.slack > c.none else 0.0
    s.swing = s.swing * c.fade if s.swing > c.none else 0.0
    if c.most == 0.0 or s.known == 0 or s.left == 0.0:
        for i in range(n):
            out[i] = y[i]
        if c.most > 0.0:
            periods = s.allowed if s.known == 1 else UNKNOWN * c.apart
            s.slack = max(s.slack, periods * _rate(s, c, n, smooth))
            s.swing = s.slack
        return
    moving = 0.0
    for i in range(n):
        out[i] = y[i]
        if s.pole[i] == 0.0:
            continue
        if math.isnan(y[i]):
            s.begun[i] = 0
            continue
        if s.begun[i] == 0 or s.before[i] > MOST_LOST or math.isnan(s.older[i]):
            s.aligned[i] = y[i] - s.delay[i] * rate
            s.begun[i] = 1
        elif smooth & (1 << i):
            s.aligned[i] = filtered(s.aligned[i], s.older[i], y[i], s.pole[i], s.before[i])
            moving = max(moving, abs(y[i] - s.aligned[i]))
        else:  # a jump is no movement: it shows as it is
            s.aligned[i] += y[i] - s.older[i]
            s.aligned[i] = y[i] + s.pole[i] * (s.aligned[i] - y[i])
        out[i] = s.aligned[i]
    s.slack = max(s.slack, s.left * moving)
    s.swing = max(s.swing, UNKNOWN * moving)


@kernel
def _empty(b: Block, n: int) -> None:
    b.count, b.age, b.t, b.tt = 0, 0.0, 0.0, 0.0
    for i in range(n):
        b.y[i] = b.ty[i] = 0.0


@kernel
def _restart(s: State, n: int) -> None:
    """Forget the sums: a measurement begins."""
    s.blocks, s.up, s.down = 0, 0.0, 0.0
    for i in range(n):
        s.dd[i] = s.dx[i] = s.dr[i] = s.xx[i] = s.xr[i] = s.rr[i] = 0.0


@kernel
def _take_block(s: State, c: Const, n: int, variance: float) -> None:
    """Take a whole block: what is slow, and the sums if the quantity moves."""
    b = s.block
    count = float(b.count)
    spread = count * b.tt - b.t * b.t
    s.rate = 0.0
    for i in range(n):
        s.rate += (count * b.ty[i] - b.t * b.y[i]) / spread / n
    told = s.rate * c.telling
    first = s.since == 0.0 or s.since > 2 * SPREAD * c.samples
    counts = not first and told * told > MOVES * variance
    slope0 = (count * b.ty[0] - b.t * b.y[0]) / spread
    for i in range(1, n):
        r = 0.5 * (slope0 + (count * b.ty[i] - b.t * b.y[i]) / spread)
        x, d = 0.5 * (b.y[0] + b.y[i]) / count, (b.y[0] - b.y[i]) / count
        share = 1.0 if first else c.slow
        s.slow_d[i] += share * (d - s.slow_d[i])
        s.slow_x[i] += share * (x - s.slow_x[i])
        s.slow_r[i] += share * (r - s.slow_r[i])
        if counts:
            d, x, r = d - s.slow_d[i], x - s.slow_x[i], r - s.slow_r[i]
            s.dd[i] += d * d
            s.dx[i] += d * x
            s.dr[i] += d * r
            s.xx[i] += x * x
            s.xr[i] += x * r
            s.rr[i] += r * r
    s.since = 1.0
    if not counts:
        return
    s.blocks += 1
    if s.rate > 0.0:
        s.up += told * told * count
    else:
        s.down += told * told * count


@kernel
def _measure(s: State, c: Const, n: int, variance: float) -> bool:
    """Solve for each channel's lag, ``s.found``, and its variance; tells whether it is a measurement."""
    noise = 2.0 * variance / c.samples
    worst = 0.0
    s.found[0] = s.found_variance[0] = 0.0
    for i in range(1, n):
        size = s.rr[i] * s.xx[i] - s.xr[i] * s.xr[i]
        if size <= 0.0:
            return False
        lag = (s.dr[i] * s.xx[i] - s.dx[i] * s.xr[i]) / size
        gain = (s.dx[i] * s.rr[i] - s.dr[i] * s.xr[i]) / size
        rest = max(s.dd[i] - lag * s.dr[i] - gain * s.dx[i], 0.0)
        each = max(rest / (s.blocks - 2), noise)
        # What is measured is what the alignment has left.
        s.found[i], s.found_variance[i] = s.delay[0] - s.delay[i] + lag, ALIKE * each * s.xx[i] / size
        if abs(gain) > MOST_GAIN or s.found_variance[i] > c.known * c.known:
            return False
        worst = max(worst, math.sqrt(max(rest - noise * s.blocks, 0.0) / s.rr[i]))
    s.unlike = worst if s.known == 0 or worst > s.unlike else s.unlike + EASES * (worst - s.unlike)
    return True


@kernel
def _span(lag: f8s, n: int) -> float:
    """Return how far the slowest channel is behind the quickest."""
    low, high = 0.0, 0.0
    for i in range(1, n):
        low, high = min(low, lag[i]), max(high, lag[i])
    return float(high - low)


@kernel
def _believe(s: State, c: Const, n: int) -> bool:
    """Put a measurement together with what is known; tells whether that has changed."""
    new = s.known == 0
    if not new and _span(s.found, n) > LIKE * c.most:
        return False  # it is a fault
    against, again = False, s.doubted == 1
    for i in range(1, n):
        s.variance[i] += c.wanders * c.wanders
        off = abs(s.found[i] - s.behind[i])
        against = against or off > CONTRADICTS * math.sqrt(s.variance[i] + s.found_variance[i]) + c.way
        off = abs(s.found[i] - s.doubt[i])
        again = again and off <= CONTRADICTS * math.sqrt(2.0 * s.found_variance[i]) + c.way
    if against and not new and not again:
        s.doubted = 1
        for i in range(1, n):
            s.doubt[i] = s.found[i]
        return False
    s.doubted, s.known = 0, 1
    for i in range(1, n):
        anew = new or against
        share = 1.0 if anew else s.variance[i] / (s.variance[i] + s.found_variance[i])
        s.behind[i] += share * (s.found[i] - s.behind[i])
        s.variance[i] = s.found_variance[i] if anew else (1.0 - share) * s.variance[i]
    return True


@kernel
def _decide(s: State, c: Const, n: int) -> None:
    """Align the channels by the lags that are known: a filter of first order with the pole d / (1 + d) delays by d."""
    slowest, sd, most = 0.0, 0.0, _span(s.behind, n)
    for i in range(1, n):
        slowest, sd = max(slowest, s.behind[i]), max(sd, math.sqrt(s.variance[i]))
    aligned = c.least <= most <= LIKE * c.most
    s.left, s.allowed = 0.0, min(most, c.least) + DEVIATIONS * sd
    if aligned:
        s.left = min(max((LEFT * s.unlike + DEVIATIONS * sd) / most, LEFT_LEAST), LEFT_MOST)
    for i in range(n):
        s.tau[i] = s.delay[i] = s.pole[i] = 0.0
        ahead = slowest - s.behind[i]
        if not aligned:
            continue
        if most > ahead:
            s.tau[i] = 1.0 / math.log1p(1.0 / (most - ahead))
        if ahead > 0.3 * c.least:
            s.delay[i], s.pole[i] = ahead, ahead / (1.0 + ahead)
            s.aligned[i] = s.last[i] - ahead * s.rate
            s.begun[i] = 1


@kernel
def learn(s: State, c: Const, n: int, y: f8s, fine: int, smooth: int, dt: float, variance: float) -> None:
    """Take the readings of one sample as :func:`align` leaves them; puts right what is known of the lags.

    Args:
        n: channels.
        y: readings, aligned.
        fine: bits of the channels whose reading is one.
        smooth: bits of the channels that do not jump.
        dt: time since the last sample, in periods.
        variance: of a reading.
    """
    if c.most == 0.0:
        return
    b, every = s.block, (1 << n) - 1
    b.age += dt
    if s.since > 0.0:
        s.since += dt
    if fine & smooth != every or b.age > SPREAD * c.samples:
        _empty(b, n)
        if fine & smooth != every:
            return
    if b.count == 0:
        b.age = 0.0
    b.count += 1
    b.t += b.age
    b.tt += b.age * b.age
    for i in range(n):
        b.y[i] += y[i]
        b.ty[i] += b.age * y[i]
    if b.count < c.samples:
        return
    _take_block(s, c, n, variance)
    _empty(b, n)
    if s.blocks < ENOUGH or min(s.up, s.down) < TELLING * 2.0 * variance:
        return
    if _measure(s, c, n, variance):
        if _believe(s, c, n):
            _decide(s, c, n)
        _restart(s, n)
    elif s.blocks >= MANY:
        _restart(s, n)
