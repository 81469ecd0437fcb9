"""Communication checks of messages: tests of a frame, and of its absence."""

from __future__ import annotations

from typing import Any

import numpy as np

from gateway.bus.conditions import RUNNING
from gateway.engine.checks.activity import begin_to_come, is_gone, note_gap, waits_to_settle
from gateway.engine.checks.bus_health import SILENT
from gateway.engine.checks.bus_sleep import park
from gateway.engine.checks.communication import (
    ACCEPT,
    AGAINST,
    COMES,
    FIRST,
    IN_PART,
    MISFITS,
    MISSING,
    MOST_LOSSES,
    NOT_YET,
    PROVEN,
    REJECT,
    SAMPLES,
    SOON,
    STOPPED,
    WIDE,
)
from gateway.engine.checks.kinds import COUNTER, CRC, LENGTH, RULE, TIMEOUT, VALUE
from gateway.engine.checks.runs import begin_run, count_run, go_on
from gateway.engine.checks.secured_steps import FORGED, UNKNOWN, judge_secured, take_freshness
from gateway.engine.checks.senders_steps import (
    accuse,
    begin_window,
    clears_sender,
    follow,
    is_doubtful,
    is_lost_with_others,
    is_news,
    keep_stamp,
    may_lose,
)
from gateway.engine.checks.software import ENOUGH, is_other
from gateway.engine.gate import sleeps
from gateway.engine.results import not_tested, report_result, store_evidence
from gateway.engine.timers import arm
from gateway.monitors.contract import NOT_TESTED
from gateway.signals.decode import INVALID_VALUE, OK
from gateway.signals.protection.judge import FRAME_CHECKSUM, FRAME_OK, judge_frame
from gateway.signals.protection.protection import counter_of
from gateway_fdi.jit import kernel

#: States of E2E's state machine.
NO_DATA, STARTING, VALID, INVALID = range(4)
#: Result of a cycle that it takes (PRS_E2EProtocol): OK, ERROR, REPEATED or WRONGSEQUENCE, NONEWDATA.
RIGHT, WRONG, NEITHER, NOTHING = range(4)


@kernel
def end_run(T: Any, c: Any) -> None:
    """Tell of the run: a frame has come that is none of it, or none at all."""
    count_run(c, T.debounces, T.buckets)
    c.steady = 0


@kernel
def take_timeout(T: Any, due: int, c: Any) -> bool:
    """Take one elapsed timeout of a message; returns whether it is reported: others are heard, and none sleeps."""
    if park(T, due, c):
        return False
    if sleeps(T, T.debounces[c.fault[TIMEOUT]]):
        c.asleep = 1
    elif c.asleep == 1:  # it wakes
        c.asleep = 0
        c.deadline_ns = due + c.wake_ns
        c.silent_ns = 0
        c.coming = NOT_YET
        return False
    if waits_to_settle(T, due, c):
        return False
    report_timeout(T, due, c)
    return True


@kernel
def report_timeout(T: Any, due: int, c: Any) -> None:
    """Report one elapsed timeout of a message, and set its next deadline; also whether its bus is heard."""
    if c.bus < T.health.shape[0] - 1 and T.health[c.bus].fault[SILENT] >= 0:
        h = T.health[c.bus]
        if due - h.heard_ns < h.quiet_ns:  # it is heard
            report_result(T, due, h.fault[SILENT], False, (due - h.heard_ns) * 1e-6, h.quiet_ns * 1e-6)
    end_run(T, c)
    T.clock[0].timeouts += 1
    c.deadline_ns += c.timeout_ns
    c.silent_ns += c.timeout_ns
    place = report_result(T, due, c.fault[TIMEOUT], True, c.silent_ns * 1e-6, c.timeout_ns * 1e-6)
    store_evidence(T, c.fault[TIMEOUT], place, 0, c.silent_ns * 1e-6)
    if T.vectors[c.row].by_group == 1:
        store_evidence(T, c.fault[TIMEOUT], place, 1, float(T.vectors[c.row].source))


@kernel
def skip_settled_timeouts(T: Any, t_ns: int, c: Any) -> None:
    """Let the deadlines go by that can change nothing any more: the timeout is qualified already.

    A jump of the clock by years must not cost a step for each timeout in it.
    """
    d = T.debounces[c.fault[TIMEOUT]]
    settled = d.timed == 1 or d.counter == d.failed_after or d.last == NOT_TESTED
    if settled and c.deadline_ns <= t_ns:
        skipped = (t_ns - c.deadline_ns) // c.timeout_ns + 1
        T.clock[0].timeouts += skipped
        c.deadline_ns += skipped * c.timeout_ns
        c.silent_ns += skipped * c.timeout_ns


@kernel(inlined=False)
def restart_supervision(T: Any, t_ns: int, bus: int, condition: int) -> None:
    """Forget what a gap in the frames of a bus would make look like a fault of the senders.

    Args:
        T: the tables.
        t_ns: when it ends.
        bus: whose frames were not heard.
        condition: RUNNING: there was nothing to hear; LOSS: some were lost here, so that a message that is not there
            again and again is missing all the same (:data:`MOST_LOSSES`). Told twice it is as told once.
    """
    for k in range(T.checks.shape[0]):
        c = T.checks[k]
        if c.bus != bus:
            continue
        c.seen = c.synced = 0
        begin_window(c)
        deadline_ns = t_ns + (c.wake_ns if condition == RUNNING and c.coming == NOT_YET else c.timeout_ns)
        if c.timeout_ns <= 0 or (condition != RUNNING and (c.deadline_ns >= deadline_ns or c.losses >= MOST_LOSSES)):
            continue
        c.losses = 0 if condition == RUNNING else c.losses + 1
        c.coming = c.coming if c.coming == NOT_YET else COMES
        c.deadline_ns = deadline_ns
        c.silent_ns = c.parked_ns = c.parks = 0
        arm(T, c.timer, c.deadline_ns)


@kernel
def checksum_fits(T: Any, t_ns: int, c: Any, words: Any, length: int) -> bool:
    """Test a frame's checksum, of SecOC MAC and freshness; returns whether its data may be used."""
    if c.protection.secured == 1:
        return is_authentic(T, t_ns, c, words, length)
    received, computed, verdict = judge_frame(words, length, c.protection, T.crc_tables)
    return take_checksum(T, t_ns, c, words, length, received, computed, verdict)


@kernel
def is_authentic(T: Any, t_ns: int, c: Any, words: Any, length: int) -> bool:
    """Test MAC and freshness value of a frame that SecOC secures; returns whether its data may be used."""
    verdict, received, computed, value = judge_secured(T, c, words)
    if verdict == UNKNOWN:
        T.clock[0].unsynchronised += 1
        return False
    wrong = FRAME_CHECKSUM if verdict == FORGED else FRAME_OK
    used = take_checksum(T, t_ns, c, words, length, received, computed, wrong)
    if verdict == FORGED:
        return False
    return take_freshness(T, t_ns, c, value, verdict) and used


@kernel
def take_checksum(
    T: Any, t_ns: int, c: Any, words: Any, length: int, received: Any, computed: Any, verdict: int
) -> bool:
    """Take a judgement of a frame's checksum; returns whether its data may be used.

    Until the rule is proven, wrong frames are rejected, but the sender is not accused: it is the rule that is doubted.
    """
    wrong = verdict != FRAME_OK
    if wrong:
        T.clock[0].crc_failed += 1
        c.unread += 1
        advance_window(T, c, WRONG)
    if c.proof < PROVEN:
        weigh_rule(c, words, wrong)
        if wrong:
            keep_misfit(T, t_ns, c, words, length, float(received), float(computed), verdict - FRAME_CHECKSUM)
            return False
        if c.proof < 0:  # right by chance, more likely: it tells nothing of the sender
            return True
    if not wrong and c.proof == PROVEN:
        if c.passed & 0xFF == 0:  # now and then is enough: it cannot change any more
            report_result(T, t_ns, c.fault[RULE], False, float(received), float(computed))
        c.passed += 1
    cleared = False
    if c.stride > 0 and c.protection.secured == 0:
        if wrong or c.blamed == 1:
            cleared = clears_sender(T, t_ns, c, wrong)
        c.last_ns = t_ns
    if cleared:
        not_tested(T, t_ns, c.fault[CRC])
        return False
    place = accuse(T, t_ns, c, CRC, wrong, float(received), float(computed))
    store_evidence(T, c.fault[CRC], place, 0, float(received))
    store_evidence(T, c.fault[CRC], place, 1, float(computed))
    store_evidence(T, c.fault[CRC], place, 2, float(max(verdict - FRAME_CHECKSUM, 0)))
    return not wrong


@kernel
def weigh_rule(c: Any, words: Any, wrong: bool) -> None:
    """Count what a frame says of the checksum's rule, before it is proven.

    A sequential probability ratio test: a wrong rule passes one frame in ``2**width`` by chance, a right one passes
    half of them at least (with a single bit: three quarters). The logarithm of the ratio is summed, rounded so that
    less speaks for the rule. By Ville's inequality a wrong rule comes from zero to the limit once in
    ``2**(PROVEN / 2)`` tries at most, however many frames come; from the lower end, where the sum stops, once in the
    square of that. This holds for payloads that differ.

    The payload of the right frame before, sent again, is right again. With few bits it says nothing new, and only takes
    back what wrong ones said. With more it counts: many messages have no counter, and stand still while they are right.
    Once the rule is doubted it does not: a doubt ends when chance is refuted, by payloads that differ.
    """
    if wrong:
        c.proof = max(c.proof - AGAINST, -PROVEN)
        return
    width = int(c.protection.checksum.width)
    more = c.proof + max(2 * (width - 1), 1)
    payload = np.uint64(1)
    for k in range(8):
        payload = (payload << np.uint64(7) | payload >> np.uint64(57)) ^ words[k]
    again = payload == c.weighed and (width < WIDE or c.misfits >= MISFITS)
    c.proof = max(c.proof, min(more, 0)) if again else min(more, PROVEN)
    c.weighed = payload


@kernel
def keep_misfit(
    T: Any, t_ns: int, c: Any, words: Any, length: int, received: float, computed: float, constant: int
) -> None:
    """Keep a frame that does not fit the rule; where all speaks against the rule, it is reported."""
    at = c.misfits % SAMPLES
    for k in range(8):
        c.samples[at, k] = words[k]
    c.lengths[at] = length
    c.misfits = min(c.misfits + 1, 1 << 20)
    if c.proof == -PROVEN and c.misfits >= MISFITS:
        if c.protection.secured == 0 and is_other(T, t_ns, c, RULE, ENOUGH, received, computed):
            not_tested(T, t_ns, c.fault[RULE])
            return
        place = report_result(T, t_ns, c.fault[RULE], True, received, computed)
        store_evidence(T, c.fault[RULE], place, 0, float(c.misfits))
        store_evidence(T, c.fault[RULE], place, 1, received)
        store_evidence(T, c.fault[RULE], place, 2, computed)
        store_evidence(T, c.fault[RULE], place, 3, float(constant))


@kernel
def counter_fits(T: Any, t_ns: int, c: Any, words: Any) -> bool:
    """Test a frame's alive counter; returns whether its data may be used.

    A repeated frame's may not. One out of sequence is reported; its data are used (AUTOSAR E2E: OK_SOME_LOST), but not
    where the protection is strict, as E2E's profiles are beyond their largest step (WRONG_SEQUENCE).
    """
    p = c.protection
    if p.secured == 1:  # its freshness was tested with the MAC
        return True
    received = counter_of(words, p)
    step = counter_step(c, received)
    if c.stride > 0:
        step = follow(T, t_ns, c, received, step)
    # The counters of rejected frames went by unread; those frames were not lost.
    jumped = step < 0 or step > p.max_step + c.unread
    wrong = jumped or step == 0
    if not wrong and c.seen == 1:
        c.counts = 1
    never = wrong and c.counts == 0 and not may_lose(T, t_ns, c)
    # One that stands still is no sign: a fault of before the start does that, too.
    other = never and is_other(T, t_ns, c, COUNTER, 1 if jumped else 0, float(step), float(p.max_step))
    lost = wrong and step >= 0 and is_lost_with_others(T, t_ns, c, step)
    T.clock[0].missed += max(step - 1, 0) if lost else 0
    if other or lost:
        not_tested(T, t_ns, c.fault[COUNTER])
    else:
        place = accuse(T, t_ns, c, COUNTER, wrong, float(step), float(p.max_step))
        store_evidence(T, c.fault[COUNTER], place, 0, float(step))
        store_evidence(T, c.fault[COUNTER], place, 1, float(c.last_counter))
        store_evidence(T, c.fault[COUNTER], place, 2, float(received))
    take_counter(c, received)
    if step == 0:
        T.clock[0].repeated += 1
        advance_window(T, c, NEITHER)
        return False
    if jumped and p.strict == 1:
        T.clock[0].wrong_sequence += 1
        advance_window(T, c, NEITHER)
        return False
    return advance_window(T, c, RIGHT)


@kernel
def take_counter(c: Any, received: int) -> None:
    """Keep an alive counter for the next frame."""
    c.last_counter = received
    c.seen = 1
    c.unread = 0


@kernel
def counter_step(c: Any, received: int) -> int:
    """Return by how much the alive counter rose since the last frame: 1 at the first, -1 for a value it cannot have."""
    p = c.protection
    if received < p.first or received >= p.first + p.modulus:
        return -1
    if c.seen == 0 or c.last_counter < p.first or c.last_counter >= p.first + p.modulus:
        return 1
    step = received - int(c.last_counter)
    return step if step >= 0 else step + int(p.modulus)


@kernel
def advance_window(T: Any, c: Any, status: int) -> bool:
    """Take a cycle into E2E's state machine (PRS_E2EProtocol, 6.14); returns whether its frame's data may be used.

    Args:
        T: the tables.
        c: its record of CHECK.
        status: RIGHT, WRONG, NEITHER, or NOTHING: no frame came.
    """
    p, ok = c.protection, status == RIGHT
    if p.windowed == 0:
        return ok
    if c.window == NO_DATA:
        if status in (RIGHT, NEITHER):  # which is not counted yet
            c.window = STARTING
            T.clock[0].window_rejected += ok
        return False
    one = np.uint64(1)
    c.ok = (c.ok << one) | (one if ok else np.uint64(0))
    c.wrong = (c.wrong << one) | (one if status == WRONG else np.uint64(0))
    before, at = c.window, c.window - 1
    seen = (~np.uint64(0)) >> np.uint64(64 - p.window[at])
    right, errors = bits_set(c.ok & seen), bits_set(c.wrong & seen)
    if right >= p.min_ok[at] and errors <= p.max_error[at]:
        c.window = VALID
    elif c.window != STARTING or errors > p.max_error[at]:
        c.window = INVALID
    if c.window != before:  # a larger window than the one before begins with what that has seen (PRS_E2E_00607)
        c.ok &= seen
        c.wrong &= seen
    if ok and c.window != VALID:
        T.clock[0].window_rejected += 1
    return ok and c.window == VALID


@kernel
def advance_missed_cycles(T: Any, t_ns: int, c: Any) -> None:
    """Take the cycles in which no frame came into E2E's state machine, before the frame that ends them."""
    if c.cycle_ns > 0 and c.came_ns > 0:
        for _ in range(min((t_ns - c.came_ns - 1) // c.cycle_ns, 64)):  # by then nothing else is remembered
            advance_window(T, c, NOTHING)
    c.came_ns = t_ns


@kernel
def bits_set(value: Any) -> int:
    """Return how many bits of a uint64 are set."""
    count = 0
    while value != np.uint64(0):
        value &= value - np.uint64(1)
        count += 1
    return count


@kernel
def report_arrival(T: Any, t_ns: int, c: Any, length: int) -> None:
    """Report that a message has come, and whether it is long enough."""
    if c.fault[TIMEOUT] >= 0 and c.silent_sources == 0:
        report_result(T, t_ns, c.fault[TIMEOUT], False, 0.0, c.timeout_ns * 1e-6)
    if c.fault[LENGTH] >= 0:
        wrong = is_odd_length(c, length)
        if not wrong:
            c.fitted = 1
        elif c.only_length > 0 and c.fitted == 0 and is_other(T, t_ns, c, LENGTH, ENOUGH, length, c.only_length):
            not_tested(T, t_ns, c.fault[LENGTH])
            return
        place = accuse(T, t_ns, c, LENGTH, wrong, length, c.only_length if c.only_length > 0 else c.length)
        store_evidence(T, c.fault[LENGTH], place, 0, length)


@kernel
def is_odd_length(c: Any, length: int) -> bool:
    """Return whether a frame has another length than the one that it may have, or is cut off.

    A sender whose frames always were shorter than the database says is not accused: it is the database that is wrong.
    """
    if c.only_length > 0:
        return bool(length != c.only_length)
    return bool(c.fault[LENGTH] >= 0 and length < min(c.length, c.longest))


@kernel
def lost_protection(c: Any, length: int) -> bool:
    """Return whether a frame ends before its checksum or counter, and may not be used without.

    Of a sender whose frames never had them they are not tested; SecOC and E2E's state machine are not to be evaded.
    """
    return bool(length < c.need and (c.longest >= c.need or c.protection.secured == 1 or c.protection.windowed == 1))


@kernel
def is_usual(T: Any, c: Any, words: Any, length: int, status: int) -> bool:
    """Return whether a frame passes as those of the run before it, as far as can be seen without its checksum."""
    clock = T.clock[0]
    if c.steady == 0 or status != OK or length != c.usual_length:
        return False
    if clock.held == 1 or clock.gate_changes != c.gate_changes:
        return False
    return bool(c.counted == 0 or counter_step(c, counter_of(words, c.protection)) == c.usual_step)


@kernel(inlined=False)
def come(T: Any, t_ns: int, c: Any) -> None:
    """Take the first frame of a message after it did not come; those that were missing alone are told before."""
    if begin_to_come(T, t_ns, c):
        for k in range(T.checks.shape[0]):
            o = T.checks[k]
            if o.bus == c.bus and o.coming == STOPPED and is_gone(T, t_ns, o):
                o.coming = MISSING
                o.silent_ns += max(t_ns - o.overdue_ns, 0)
                o.deadline_ns = t_ns
                report_timeout(T, t_ns, o)
                arm(T, o.timer, o.deadline_ns)
        c.coming = COMES


@kernel
def note_arrival(T: Any, t_ns: int, c: Any, words: Any) -> None:
    """Take that a frame of a message has come: its time starts again, and it counts for its rate."""
    if c.timeout_ns > 0:
        if c.bus < T.health.shape[0] - 1:
            T.health[c.bus].watched += 1
        deadline_ns, before_ns = t_ns + c.timeout_ns, c.deadline_ns
        moved_ns = deadline_ns - before_ns
        if c.coming != COMES:
            come(T, t_ns, c)
        elif moved_ns > c.wide_ns or moved_ns < c.wide_ns // SOON or c.first < FIRST:
            note_gap(T, t_ns, c, moved_ns)
        c.deadline_ns = deadline_ns
        c.silent_ns = 0
        c.losses = 0
        c.parks = 0
        if deadline_ns < before_ns:  # after a late frame; the noted time is never later than the deadline
            arm(T, c.timer, deadline_ns)
    if c.stride > 0 and not (c.repeats == 1 and is_news(c, words)):
        c.left -= 1
        if c.left <= 0:
            keep_stamp(T, t_ns, c)


@kernel
def check_message(T: Any, t_ns: int, c: Any, words: Any, length: int, status: int, bad: int) -> int:
    """Communication check of one frame: reports each test, returns ACCEPT, REJECT or IN_PART.

    Args:
        T: the tables.
        t_ns: the frame's time.
        c: its record of CHECK.
        words: payload, 8 little-endian uint64.
        length: payload length [byte].
        status: of the decoder.
        bad: place of a signal that carries no value, -1: none.
    """
    note_arrival(T, t_ns, c, words)
    usual = is_usual(T, c, words, length, status)
    if not usual:
        end_run(T, c)
        c.longest = max(c.longest, length)
        report_arrival(T, t_ns, c, length)
        if is_odd_length(c, length) or lost_protection(c, length):
            c.unread += 1
            return REJECT
    if usual or (length >= c.need and (c.presence < 0 or T.present[c.presence] == 1)):
        if not usual and c.protection.windowed == 1:
            advance_missed_cycles(T, t_ns, c)
        if (c.summed == 1 if usual else c.fault[CRC] >= 0) and not checksum_fits(T, t_ns, c, words, length):
            if usual:  # it has come, and is long enough; its counter is not read
                end_run(T, c)
                report_arrival(T, t_ns, c, length)
            return REJECT
        if usual:
            if c.counted == 1:
                take_counter(c, counter_of(words, c.protection))
            go_on(T, t_ns, c)
            return ACCEPT
        if c.fault[COUNTER] >= 0 and not counter_fits(T, t_ns, c, words):
            return REJECT
    if is_doubtful(c):
        T.clock[0].doubtful += 1
        return REJECT
    if c.fault[VALUE] >= 0:
        value = T.values[bad] if bad >= 0 else 0.0
        place = report_result(T, t_ns, c.fault[VALUE], bad >= 0, value, 0.0)
        store_evidence(T, c.fault[VALUE], place, 0, bad)
        store_evidence(T, c.fault[VALUE], place, 1, value)
    if status == INVALID_VALUE:
        return IN_PART
    if status == OK and c.silent_sources == 0:
        begin_run(T, c, length)
    return ACCEPT
