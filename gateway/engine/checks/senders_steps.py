"""Tests of a message's senders: the rate over a window, and an alive counter that runs twice."""

from __future__ import annotations

from typing import Any

from gateway.engine.checks.activity import is_lossy, lost_share
from gateway.engine.checks.kinds import COUNTER, CRC, EARLY, SECOND
from gateway.engine.checks.software import FIRST_NS, is_other
from gateway.engine.debounce import is_settled
from gateway.engine.results import not_tested, report_result, store_evidence
from gateway_fdi.jit import kernel

#: Most evidence of a frame that continues the other count [bit]; one that continues its own takes 1 back. A frame after
#: a loss continues the other count by chance, once in the counter's modulus: the bits of that it says.
CHANGE = 8
#: Evidence of two senders [bit]. From half of it on values are doubtful.
TWO = 4 * CHANGE
#: Frames of a window are fewer than one sender's where it is longer by this part of it (the cycle is not known better).
PART = 50
#: Share of the windows on a bus that hold too few frames, from which on it, or its recorder, loses them; how many
#: windows it is taken of. A lone sender that skips makes its own thin, a late host one before a crowded one.
MOST_THIN, WINDOWS = 0.55, 32.0
#: Counters of two messages that jump within this time have one reason: frames of the bus are missing [ns].
TOGETHER_NS = 1_000_000_000
#: Frames for which the other count is remembered.
REMEMBERED = 64


@kernel
def is_doubtful(c: Any) -> bool:
    """Return whether a message may have two senders, so that its values are not used."""
    if c.protection.secured == 1:  # its MAC says whose they are
        return False
    if c.twice >= TWO // 2:
        return True
    return bool(c.crowded == 1 and (c.fault[COUNTER] < 0 or c.odd > 0))


@kernel
def accuse(T: Any, t_ns: int, c: Any, kind: int, failed: bool, value: float, limit: float) -> int:
    """Report a result of a check as ``report_result`` does; while the sender is doubtful a failure is not tested."""
    if failed and is_doubtful(c):
        not_tested(T, t_ns, c.fault[kind])
        return -1
    return int(report_result(T, t_ns, c.fault[kind], failed, value, limit))


@kernel
def clears_sender(T: Any, t_ns: int, c: Any, failed: bool) -> bool:
    """Return whether a wrong checksum is not the sender's. A right one may take the blame of the last one back.

    A wrong frame between two right ones that are one cycle apart is another sender's. It comes soon after the first, or
    the second comes soon after it.
    """
    early = t_ns - c.last_ns < c.apart_ns
    d = T.debounces[c.fault[CRC]]
    if c.blamed == 1 and early and not failed and d.timed == 0 and d.active == 0:
        d.counter = c.before
    c.blamed, c.before = failed and not early, d.counter
    return bool(failed and early)


@kernel
def begin_window(c: Any) -> None:
    """Begin the window again: frames were not heard, or came late together."""
    c.left, c.at, c.filled = 1, 0, 0
    c.other_seen, c.odd, c.twice = 0, 0, 0


@kernel
def is_news(c: Any, words: Any) -> bool:
    """Return whether a frame has another content than the one before: then it may come at any time."""
    news = False
    for k in range(8):
        news |= words[k] != c.content[k]
        c.content[k] = words[k]
    return bool(news)


@kernel
def is_thin(t_ns: int, c: Any) -> bool:
    """Return whether fewer frames come than one sender sends, or it is not seen yet."""
    if c.one_ns == 0 or c.crowded == 1:
        return False
    return bool(c.filled < c.slots or t_ns - c.stamps[c.at] > c.one_ns + c.one_ns // PART)


@kernel
def note_window(T: Any, c: Any, span_ns: int) -> None:
    """Count whether a window of a message holds fewer frames than its sender sends."""
    if c.one_ns > 0 and c.bus < T.health.shape[0] - 1:
        h = T.health[c.bus]
        thin = 1.0 if span_ns > c.one_ns + c.one_ns // PART else 0.0
        h.thin += (thin - h.thin) / WINDOWS


@kernel
def lost_of(T: Any, c: Any) -> float:
    """Return the share of the frames of a message's bus that are told to get lost; 0: they do not."""
    if c.bus >= T.health.shape[0] - 1 or T.health[c.bus].lossy == 0:
        return 0.0
    return float(lost_share(T.health[c.bus]))


@kernel
def is_new(T: Any, t_ns: int, c: Any) -> bool:
    """Return whether a message's bus has just begun, so that nobody knows whether it loses frames."""
    if c.bus >= T.health.shape[0] - 1:
        return False
    h = T.health[c.bus]
    return bool(h.settle_ns > 0 and t_ns < h.joined_ns + FIRST_NS)


@kernel
def may_lose(T: Any, t_ns: int, c: Any) -> bool:
    """Return whether frames of a message's bus get lost, or nobody knows yet."""
    return bool(c.bus < T.health.shape[0] - 1 and (is_new(T, t_ns, c) or is_lossy(t_ns, T.health[c.bus])))


@kernel
def is_lost_with_others(T: Any, t_ns: int, c: Any, step: int) -> bool:
    """Note that a counter jumped; returns whether frames of other messages of the bus are missing, too.

    Then they were lost on the bus, or by who recorded it, and its sender is not accused. Where frames get lost all the
    time a counter may come round, too (step 0). In the first time of a bus that sleeps nobody knows.
    """
    if c.bus >= T.health.shape[0] - 1:
        return False
    h = T.health[c.bus]
    if step == 0 or may_lose(T, t_ns, c):
        return bool(may_lose(T, t_ns, c))
    if h.jumper != c.row:
        h.others_ns, h.jumper = h.jumped_ns, c.row
    h.jumped_ns = t_ns
    return bool(h.thin > MOST_THIN or (h.others_ns > 0 and t_ns - h.others_ns < TOGETHER_NS))


@kernel
def keep_stamp(T: Any, t_ns: int, c: Any) -> None:
    """Keep a stamp, and judge the window that ends with it.

    The oldest stamp is that of the frame ``stride * slots`` before this one. If both lie in one window, it has one
    frame more than the limit. A pass is reported once a turn of the stamps. Where passes change nothing any more each
    eighth turn is enough: a healthy message must cost little.
    """
    at = c.at
    span_ns = t_ns - c.stamps[at]
    c.stamps[at] = t_ns
    c.left = c.stride
    at += 1
    if at == c.slots:
        at = 0
    c.at = at
    if c.filled < c.slots:
        c.filled += 1
    elif span_ns < c.most_ns:
        judge_rate(T, t_ns, c, span_ns)
    elif at == 0:
        if not is_new(T, t_ns, c) and span_ns * (1.0 - lost_of(T, c)) >= c.most_ns:
            c.wraps += 1  # it had its rate
        note_window(T, c, span_ns)
        d = T.debounces[c.fault[EARLY]]
        if c.crowded == 1 or c.wraps & 7 == 0 or T.clock[0].held == 1 or d.gated == 1 or not is_settled(d):
            judge_rate(T, t_ns, c, span_ns)


@kernel(inlined=False)
def judge_rate(T: Any, t_ns: int, c: Any, span_ns: int) -> None:
    """Report the result of a window; ``span_ns`` is the time that its frames took."""
    most = c.stride * c.slots
    failed = span_ns < c.most_ns
    c.crowded = failed
    if failed:  # the next window has no frame of this one
        c.steady, c.filled = 0, 1
        c.stamps[0], c.at = t_ns, 1 if c.slots > 1 else 0
    rate = most * (c.most_ns / max(span_ns, 1))
    other = failed and c.wraps == 0 and is_other(T, t_ns, c, EARLY, 1, rate, float(most))
    if other or (failed and (c.repeats == 1 or c.wraps == 0) and lost_of(T, c) > 0.0):
        not_tested(T, t_ns, c.fault[EARLY])  # one behind a lost one may repeat what was before; or it never fitted
        return
    place = report_result(T, t_ns, c.fault[EARLY], failed, rate, float(most))
    store_evidence(T, c.fault[EARLY], place, 0, float(most + 1))
    store_evidence(T, c.fault[EARLY], place, 1, span_ns * 1e-6)
    if c.fault[SECOND] >= 0 and c.twice == 0:
        report_result(T, t_ns, c.fault[SECOND], False, 0.0, float(TWO))


@kernel
def goes_on(c: Any, before: int, received: int) -> int:
    """Return the step of a counter from a value before; 0: a step that it may not make."""
    p = c.protection
    step = (received - before) % p.modulus
    return int(step) if step <= p.max_step + c.unread else 0


@kernel
def weight(c: Any) -> int:
    """Return what it says that a frame continues the other count [bit]."""
    left, said = c.protection.modulus // (c.protection.max_step + c.unread), 0
    while left > 1 and said < CHANGE:
        left, said = left >> 1, said + 1
    return said


@kernel
def follow(T: Any, t_ns: int, c: Any, received: int, step: int) -> int:
    """Tell two counts apart; returns the step of the counter on the count that the frame continues.

    Args:
        T: the tables.
        t_ns: now.
        c: its record of CHECK.
        received: alive counter of the frame.
        step: its step since the last frame.
    """
    if step < 0 or c.seen == 0:
        return step
    if is_thin(t_ns, c):
        c.other_seen, c.odd, c.twice = 0, 0, 0
        return step
    own = goes_on(c, c.last_counter, received)
    other = goes_on(c, c.other_counter, received) if c.other_seen == 1 and c.odd > 0 else 0
    if other > 0 and (own == 0 or other < own):
        c.other_counter, c.odd = c.last_counter, REMEMBERED
        c.twice = min(c.twice + weight(c), TWO)
        if c.twice == TWO:
            place = report_result(T, t_ns, c.fault[SECOND], True, float(TWO), float(TWO))
            store_evidence(T, c.fault[SECOND], place, 0, float(received))
            store_evidence(T, c.fault[SECOND], place, 1, float(c.other_counter))
        return other
    if own > 0:
        c.twice, c.odd = max(c.twice - 1, 0), max(c.odd - 1, 0)
    else:
        c.odd = REMEMBERED
        if step != 0:
            c.other_counter, c.other_seen = c.last_counter, 1
    return step
