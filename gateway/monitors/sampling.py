"""From frames to samples: which sample a frame carries, the values missing in it, and the samples lost before it.

Frames wait for the bus, are overtaken and get lost, so that a frame's time of arrival says little about its time of
sampling. Where a message has a frame counter the number of a sample comes from that; the time only tells how often the
counter went round. A frame that was overtaken is older than what has been taken, and is no sample any more.

Signals that come in several messages make a sample together: **by set**, when each message has come once more, or **by
counter**, when all have come with the same counter, in whatever order. One that stays away is not waited for; its
values are missing (NaN) then.

**By the clock** each frame of one message is a sample; or there is one at each multiple of the period, with any times
of the messages (:mod:`gateway.monitors.ticks`).

The engine does this for a monitor with the capability :class:`gateway.monitors.contract.Sampled`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from gateway_fdi.jit import Record, f8, f8s, i8, i8s, kernel, means

#: Messages that a sample can come in, and sets of one counter that are collected at the same time.
MOST_MESSAGES, MOST_DEPTH = 52, 32
#: Samples whose values are kept on the line between two frames; a power of 2.
KEPT = 64
#: Time that does not pass [ns].
FOR_EVER = 2**62
#: Frames after which is known that a counter goes round sooner; least modulo that says something where frames get lost.
LEARNED, LEAST = 64, 8
#: A frame is early by no more than this share of a period; one that seems to be is an overtaken one.
EARLY = 0.5
#: Frames over which the least waiting is looked for.
WINDOW = 64
#: Frames after a beginning until one is thought to have waited for nothing.
SETTLES = 32
#: Number of frames in a row that seem to be overtaken: the sender has started again; so it has if, after DOUBT of them,
#: one seems to have waited for half as many periods.
ANEW, DOUBT = 16, 8
#: Periods that all frames of a window have waited from where on they may catch up soon.
ALL_LATE = 2.0
#: Number of frames in a row with one counter, and not just a repeated frame: it does not count.
STANDS = 3


#: Kinds of frames: older than the frames taken; a part of a sample; the last part of one.
OVERTAKEN, WAITS, SAMPLE = range(3)


@dataclass(frozen=True)
class Sampling:
    """How the frames of a monitor become samples.

    Attributes:
        by: "counter": one message with a frame counter, or several whose counters agree; "set": several messages,
            with counters of their own or without; "clock": messages whose time stamps, rounded to periods, are all
            there is: each frame is a sample, of several messages one without the others.
        period_ms: between two samples.
        window_ms: time that a sample waits for a message that has not come; inf: for ever, none is ever missing.
        oldest_ms: a sample later than this after the last one does not follow it: all starts again.
        counters: the frame counters, ``"Message.Signal"``.
        modulo: of these; one that counts to a multiple of it is well.
        depth: samples that are collected at the same time, of several messages by counter; the next power of 2.
        spare: whether a database need not have the counters.
        between: with "clock" and several messages, its value at a multiple of the period: "held", the newest one;
            "interpolated", on the line between two frames. None: each frame is a sample.
        age_ms: of the oldest value that is held, or of a part of a set; the longest time over which a line goes.
        cycles: with "held", of each message's usual time between two frames, the age of the oldest value as well, where
            that is more than three periods; inf: ``age_ms`` alone.
        ordered: of a set the message of its last input completes it; values that have not come by then are missing.
        inputs: fields of the inputs that make a sample; (): all whose signals trigger. A monitor can have several
            samplings, each of other fields.
    """

    by: Literal["counter", "set", "clock"]
    period_ms: float
    window_ms: float
    oldest_ms: float
    counters: tuple[str, ...] = ()
    modulo: int = 16
    depth: int = 4
    spare: bool = False
    between: Literal["held", "interpolated"] | None = None
    age_ms: float = math.inf
    cycles: float = math.inf
    ordered: bool = False
    inputs: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.between is not None and self.by != "clock":
            raise ValueError(f'between = "{self.between}": by the clock only')
        if self.between == "interpolated" and self.age_ms > (KEPT - 1) * self.period_ms:
            raise ValueError(f"age_ms = {self.age_ms:g}: a line goes over {KEPT - 1} periods at most")
        if not 1 <= self.depth <= MOST_DEPTH:
            raise ValueError(f"depth = {self.depth}: 1 to {MOST_DEPTH}")
        if self.modulo < 2:
            raise ValueError(f"modulo = {self.modulo}: 2 at least")


class Const(Record):
    """Constants."""

    messages: i8 = means("messages of a sample")
    period_ns: i8 = means(unit="ns")
    window_ns: i8 = means(unit="ns")
    oldest: i8 = means("samples further from each other do not follow each other", "periods")
    counted: i8 = means("1: counters are looked at")
    modulo: i8 = means("values that a counter has")
    every: i8 = means("bits of all messages")
    early_ns: f8 = means("a frame that follows the one before is looked at no further if it waits for no less", "ns")
    late_ns: f8 = means("and for less", "ns")
    grid: i8 = means("1: a sample at each multiple of the period")
    lines: i8 = means("1: of values on the line between two frames")
    age_ns: i8 = means("of the oldest value", "ns")
    cycles: f8 = means("of a message, the age of the oldest value; 0: age_ns alone")
    ordered: i8 = means("1: the last message completes a set")
    depth: i8 = means("sets that are collected at the same time; 0: a sample is what has come once more")


class Numbers(Record):
    """Which sample a message's newest frame carries."""

    seen: i8 = means("frames so far")
    number: i8 = means("number of that sample")
    date_ns: f8 = means("when it was due, by the frames that waited least", "ns")
    arrived_ns: i8 = means("when the frame came", "ns")
    counter: i8 = means("counter of the frame")
    top: i8 = means("largest counter so far")
    least: f8 = means("what frames of this window have waited at least", "ns")
    window: i8 = means("frames of this window")
    overtaken: i8 = means("frames in a row that were overtaken")
    stands: i8 = means("frames in a row that had the same counter")
    settled: i8 = means("frames since the periods were found anew")
    rounds: i8 = means("how often the counter seems to have gone round unseen")
    doubt_ns: i8 = means("when the frame came that rounds was counted at", "ns")


class State(Record, lengths={"messages": 1}):
    """State. By counter: ``have`` to ``apart``; by the clock: ``tick_ns``, ``known``, ``more``."""

    numbers: Annotated[list[Numbers], "messages"] = means("which sample each message's newest frame carries")
    taken: Annotated[i8s, "messages"] = means("number that each message had in the last sample")
    came_ns: Annotated[i8s, "messages"] = means("when each message came last; 0: never", "ns")
    usual_ns: Annotated[f8s, "messages"] = means("usual time between two frames of each message", "ns")
    heard_ns: i8 = means("when any message came last", "ns")
    begun_ns: i8 = means("when the first frame came; 0: none has", "ns")
    last_ns: i8 = means("when the last sample was taken", "ns")
    fresh: i8 = means("bits of the messages that have come since the last sample")
    missing: i8 = means("bits of the messages that are missing in the sample")
    away: i8 = means("bits of missing messages, until they come again")
    gap: i8 = means("periods from the sample before to this one")
    samples: i8 = means("samples so far")
    overtaken: i8 = means("frames that came too late to be one")
    have: Annotated[i8s, MOST_DEPTH] = means("bits of the messages that have come of each set")
    number: Annotated[i8s, MOST_DEPTH] = means("number of each set")
    place: i8 = means("place of the frame's set among them")
    last: i8 = means("number of the newest sample")
    begun: i8 = means("1: there is a set")
    newest: i8 = means("number of the newest of all frames")
    shift: i8 = means("a number less its counter")
    turned_ns: i8 = means("when the first message came after the last silence of half a turn of the counter", "ns")
    turns: i8 = means("turns that the counter made in it, by that message")
    apart: i8 = means("sets that were given up")
    tick_ns: i8 = means("next tick; 0: the clock stands", "ns")
    at_ns: i8 = means("time of the sample", "ns")
    known: Annotated[i8s, "messages"] = means("bits of the ticks at which each message has a value")
    more: i8 = means("1: another sample may be due at once")


def prepare(c: Const, sampling: Sampling, messages: int) -> None:
    """Fill the constants.

    Args:
        c: record of Const.
        sampling: as asked for.
        messages: that carry the inputs.
    """
    c.messages, c.counted, c.every = messages, sampling.by != "clock", (1 << messages) - 1
    c.period_ns = round(sampling.period_ms * 1e6)
    c.window_ns, c.age_ns = _ns(sampling.window_ms), _ns(sampling.age_ms)
    c.ordered = sampling.ordered
    c.cycles = 0.0 if math.isinf(sampling.cycles) else sampling.cycles
    c.grid, c.lines = sampling.between is not None, sampling.between == "interpolated"
    c.oldest = max(round(sampling.oldest_ms / sampling.period_ms), 1)
    c.modulo = sampling.modulo
    c.depth = 1 << (sampling.depth - 1).bit_length() if sampling.by == "counter" and messages > 1 else 0
    c.early_ns = -EARLY * c.period_ns
    c.late_ns = (min(LEAST - EARLY, c.oldest - 1) if c.modulo >= LEAST else -1.0) * c.period_ns


def _ns(ms: float) -> int:
    return FOR_EVER if math.isinf(ms) else round(ms * 1e6)


@kernel
def _begin(s: Numbers, arrived_ns: int) -> None:
    """Let the periods lie where this frame came."""
    s.date_ns = float(arrived_ns)
    s.window = s.overtaken = s.stands = s.settled = 0


@kernel
def periods_in(apart_ns: int, period_ns: int) -> int:
    """Return how many periods a time is, rounded; one, as nearly always, without a division."""
    if period_ns <= 2 * apart_ns < 3 * period_ns:
        return 1
    return int((2 * apart_ns + period_ns) // (2 * period_ns))


@kernel
def _by_clock(s: Numbers, arrived_ns: int, period_ns: int) -> int:
    """Return the periods from the frame before to this one, by their times alone: at least one."""
    steps = max(periods_in(arrived_ns - s.arrived_ns, period_ns), 1)
    _begin(s, arrived_ns)
    return int(steps)


@kernel
def _wait(s: Numbers, arrived_ns: int, period_ns: int) -> None:
    """Take a frame's waiting: the periods lie where frames waited least."""
    if s.date_ns - arrived_ns > EARLY * period_ns or (s.window == WINDOW - 1 and s.least > ALL_LATE * period_ns):
        s.settled = 0  # all before had waited, or wait now: who catches up comes too early
    s.date_ns = min(s.date_ns, float(arrived_ns))
    waited = arrived_ns - s.date_ns
    s.least = waited if s.window == 0 else min(s.least, waited)
    s.window += 1
    s.settled += 1
    if s.window >= WINDOW:
        s.date_ns += s.least
        s.window = 0


@kernel
def _steps(s: Numbers, c: Const, arrived_ns: int, counter: float) -> int:
    """Return by how many periods a frame's sample is newer than the newest before; not positive: it is older."""
    count, period_ns = int(counter), c.period_ns
    s.top = max(s.top, count)
    modulo = c.modulo
    if c.depth == 0 and s.seen >= LEARNED and s.top + 1 < modulo:
        modulo = s.top + 1
    if modulo < LEAST:
        return _by_clock(s, arrived_ns, period_ns)
    steps = (count - s.counter) % modulo
    s.stands = s.stands + 1 if steps == 0 else 0
    if s.stands >= STANDS and arrived_ns - s.arrived_ns > EARLY * period_ns:
        passed = _by_clock(s, arrived_ns, period_ns)
        s.stands = STANDS
        return passed
    # Of the samples with this counter the newest that can have been sent by now.
    waited = arrived_ns - s.date_ns - steps * period_ns
    rounds = math.floor((waited / period_ns + EARLY) / modulo)
    in_order = 0 if 2 * steps <= modulo else -1
    if rounds < 0 < s.rounds:  # frames that seemed lost had only waited for long: they come now
        s.date_ns -= s.rounds * modulo * period_ns
        s.rounds, rounds = 0, in_order
    elif rounds < 0 and s.settled < SETTLES:  # it is the first frames that waited
        rounds = in_order
    elif rounds > in_order and 2 * (arrived_ns - s.arrived_ns) < modulo * period_ns:
        rounds = in_order  # frames keep coming: they have all waited for long, or been swapped meanwhile
    steps += modulo * rounds
    if rounds > in_order:
        s.rounds, s.doubt_ns = rounds - in_order, arrived_ns
    elif arrived_ns - s.doubt_ns > modulo * period_ns:
        s.rounds = 0
    if steps <= 0:
        s.overtaken += 1
        if s.overtaken >= ANEW:
            return _by_clock(s, arrived_ns, period_ns)
        return int(steps)
    if s.overtaken >= DOUBT and 2.0 * (arrived_ns - s.date_ns - steps * period_ns) > s.overtaken * period_ns:
        return _by_clock(s, arrived_ns, period_ns)
    s.overtaken = 0
    s.date_ns += steps * period_ns
    _wait(s, arrived_ns, period_ns)
    return int(steps)


@kernel
def _follows(s: Numbers, c: Const, counter: float) -> bool:
    """Return whether a counter is the next one."""
    return bool(counter - s.counter == 1.0 or (counter == 0.0 and s.counter == c.modulo - 1))


@kernel
def _next(s: Numbers, c: Const, arrived_ns: int, counter: float) -> bool:
    """Take a frame that comes next and in time, as nearly all do; returns whether it does: else nothing changes."""
    if s.settled < SETTLES or s.rounds != 0 or s.top < LEAST - 1 or not _follows(s, c, counter):
        return False
    due_ns = s.date_ns + c.period_ns
    if not c.early_ns <= arrived_ns - due_ns < c.late_ns:
        return False
    s.seen += 1
    s.top = max(s.top, int(counter))
    s.stands = s.overtaken = 0
    s.date_ns = due_ns
    _wait(s, arrived_ns, c.period_ns)
    s.number += 1
    s.arrived_ns, s.counter = arrived_ns, int(counter)
    return True


@kernel
def number(s: Numbers, c: Const, arrived_ns: int, counter: float) -> int:
    """Take a frame: number its sample; returns by how much that is newer than the newest before, if it is positive.

    Let the counter be n modulo M, and a frame wait for w >= 0 until it arrives. Sample n was due at d(n), one period T
    after d(n - 1), so that arrival - d(n) = w, and arrival - d(n + M) = w - M T: n is the newest one with this counter
    that was due before the arrival, for all w < M T. d is where the frames of the last window waited least.

    Args:
        s: of the frame's message.
        c: constants.
        arrived_ns: when the frame came.
        counter: of the frame; NaN: it has none.
    """
    uncounted = c.counted == 0 or math.isnan(counter)
    if not uncounted and _next(s, c, arrived_ns, counter):
        return 1
    s.seen += 1
    if s.seen == 1:
        _begin(s, arrived_ns)
        steps = 1
    elif uncounted or arrived_ns - s.arrived_ns > c.oldest * c.period_ns:
        steps = _by_clock(s, arrived_ns, c.period_ns)
    else:
        steps = _steps(s, c, arrived_ns, counter)
    if steps > 0:
        s.number += steps
        s.arrived_ns = arrived_ns
        if not math.isnan(counter):
            s.counter = int(counter)
    return int(steps)


@kernel
def number_all(s: Numbers, c: Const, arrived_ns: Any, counters: Any, numbers: Any) -> None:
    """Number all frames of a message, shape (frames,); -1: it was overtaken."""
    for k in range(len(numbers)):
        newer = number(s, c, arrived_ns[k], counters[k])
        numbers[k] = s.number if newer > 0 else -1


@kernel
def _gap(s: Any, c: Const, t_ns: int) -> int:
    """Return the periods from the sample before, by a message that both have; else by their times."""
    if s.samples == 0:
        return 1
    gap = 0
    for k in range(c.messages):
        if s.fresh & ~s.missing & (1 << k):
            gap = max(gap, s.numbers[k].number - s.taken[k])
    if gap == 0:
        gap = periods_in(t_ns - s.last_ns, c.period_ns)
    return int(max(gap, 1))


@kernel
def is_awaited(s: Any, c: Const, t_ns: int, have: int) -> bool:
    """Return whether a message is waited for: it has not come, but did within the window, or may come yet."""
    missing = c.every & ~have
    if missing == 0:
        return False
    if c.window_ns == FOR_EVER:
        return True
    for k in range(c.messages):
        last_ns = s.came_ns[k] if s.came_ns[k] > 0 else s.begun_ns
        if missing & (1 << k) and t_ns - last_ns <= c.window_ns:
            return True
    return False


@kernel
def _agree(s: Any, c: Const, n: Numbers, counter: float) -> None:
    """Have the numbers of a message agree with those of the others where the counters do.

    Far ahead of all others there is nothing to agree with: the others follow from there.
    """
    off = (int(counter) + s.shift - s.newest) % c.modulo
    if s.begun == 0 or (n.seen > 1 and 2 * (n.number - s.newest) > c.modulo):
        s.shift = (n.number - int(counter)) % c.modulo
    elif n.seen == 1 or (n.number - int(counter) - s.shift) % c.modulo != 0:
        n.number = s.newest + (off if 2 * off <= c.modulo else off - c.modulo)
    s.newest = n.number if s.begun == 0 else max(s.newest, n.number)
    s.begun = 1


@kernel
def _share_turns(s: Any, c: Const, message: int, t_ns: int, steps: int) -> int:
    """Return a message's steps with as many turns of the counter as the first of all took after a common silence."""
    came_ns = s.came_ns[message]
    if came_ns == 0 or 2 * (t_ns - came_ns) < c.modulo * c.period_ns:
        return steps
    turns = (steps - 1) // c.modulo
    if s.turned_ns <= came_ns:
        s.turned_ns, s.turns = t_ns, turns
    return int(steps + c.modulo * (s.turns - turns))


@kernel
def _take_of_set(s: Any, c: Const, message: int, t_ns: int, counter: float) -> int:
    """Take a frame of one of several messages whose counters agree; see :func:`take`."""
    n, bit = s.numbers[message], 1 << message
    if math.isnan(counter):
        return OVERTAKEN
    agrees = s.begun == 1 and n.seen > 0 and _follows(n, c, counter)
    steps = number(n, c, t_ns, counter)
    if steps > 0:
        shared = _share_turns(s, c, message, t_ns, steps)
        n.number += shared - steps
        steps = shared
    if agrees and steps == 1:
        s.newest = max(s.newest, n.number)
    elif steps > 0:
        _agree(s, c, n, counter)
    s.came_ns[message] = t_ns
    mine = n.number + min(steps, 0)
    if s.samples > 0 and mine <= s.last:
        s.overtaken += 1
        return OVERTAKEN
    place = mine & (c.depth - 1)
    if s.number[place] != mine:
        if s.have[place] != 0:
            s.apart += 1
        s.have[place], s.number[place] = 0, mine
    s.have[place] |= bit
    s.place = place
    if is_awaited(s, c, t_ns, s.have[place]):
        return WAITS
    s.gap = mine - s.last if s.samples > 0 else 1
    s.missing = c.every & ~s.have[place]
    for k in range(c.depth):  # older ones come too late from here on
        if s.have[k] != 0 and s.number[k] < mine:
            s.apart += 1
            s.have[k] = 0
    s.have[place], s.last, s.last_ns, s.at_ns = 0, mine, t_ns, t_ns
    s.samples += 1
    return SAMPLE


@kernel
def _belongs_to_the_next(s: Any, c: Const, t_ns: int) -> bool:
    """Return whether an absent message came after its sample was taken: its next frame belongs to this one."""
    back = s.away & s.fresh
    s.away = 0
    for k in range(c.messages):
        if back & (1 << k) and 2 * (t_ns - s.came_ns[k]) > c.period_ns:
            return True
    return False


@kernel
def _waits(s: Any, c: Const, message: int, t_ns: int) -> bool:
    """Return whether what has come of a set is not yet a sample."""
    if c.ordered == 1:
        return bool(message < c.messages - 1)
    return bool(is_awaited(s, c, t_ns, s.fresh) or _belongs_to_the_next(s, c, t_ns))


@kernel
def take(s: Any, c: Const, message: int, t_ns: int, counter: float) -> int:
    """Take a frame; returns OVERTAKEN, WAITS for others, or SAMPLE: one is there, with ``s.gap`` and ``s.missing``.

    Args:
        s: record of State.
        c: record of Const.
        message: index of the frame's message, from 0.
        t_ns: when it came.
        counter: its frame counter, NaN: none.
    """
    if s.begun_ns == 0:
        s.begun_ns = max(t_ns, 1)
    if c.depth > 0:
        return int(_take_of_set(s, c, message, t_ns, counter))
    if number(s.numbers[message], c, t_ns, counter) <= 0:
        s.overtaken += 1
        return OVERTAKEN
    s.came_ns[message] = t_ns
    s.fresh |= 1 << message
    if c.age_ns != FOR_EVER:
        for k in range(c.messages):
            if t_ns - s.came_ns[k] > c.age_ns:
                s.fresh &= ~(1 << k)  # it is of the sample before
    if c.messages > 1 and c.counted == 1 and _waits(s, c, message, t_ns):
        return WAITS
    s.gap = _gap(s, c, t_ns)
    for k in range(c.messages):
        if s.fresh & (1 << k):
            s.taken[k] = s.numbers[k].number
    s.missing = s.away = c.every & ~s.fresh
    s.last_ns = s.at_ns = t_ns
    s.fresh = 0
    s.samples += 1
    return SAMPLE


@kernel
def waited(s: Any, c: Const, message: int, t_ns: int) -> float:
    """Return how long ago what a sample has of a message was due, by the frames that waited least [s]; NaN: missing."""
    if s.missing & (1 << message):
        return math.nan
    if c.grid == 1:
        return float((s.at_ns - s.came_ns[message]) * 1e-9)
    n = s.numbers[message]
    newer = n.number - s.last if c.depth > 0 else 0
    return float((t_ns - n.date_ns + newer * c.period_ns) * 1e-9)
