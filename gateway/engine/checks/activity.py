"""Activity of a bus as a whole: it is asleep, waking, running or falling asleep; and what timeouts wait for meanwhile.

A bus wakes with the first frame after it was silent as a whole, and at a start: each message has its time to come, and
only then may be missing. It runs when all have come, or had their time.

A bus that may sleep (``[bus.health] sleeps``) falls asleep as a car does that is parked: senders stop one after the
other, some run on for a while, then it is silent. So one that stops there is judged when the bus has *settled*: no
other has stopped for a while. Senders that stop at one time, and are few, are at fault then. Those that stop at several
times, or are many, have been switched off. All is judged at once where ``[power]`` says that the vehicle is awake.
"""

from __future__ import annotations

import math
from typing import Any

from gateway.common.times import NEVER
from gateway.engine.checks.bus_health import ASLEEP, AWAITED, AWAKE, FALLING, PART, WAKING
from gateway.engine.checks.communication import COMES, FIRST, MISSES, MISSING, NOT_YET, SOON, STOPPED
from gateway.engine.checks.kinds import TIMEOUT
from gateway.engine.checks.software import ENOUGH, FIRST_NS, is_other
from gateway.engine.events import ACTIVITY, LOSSY
from gateway.engine.gate import moves, said_awake
from gateway.engine.results import announce
from gateway.engine.timers import arm
from gateway_fdi.jit import kernel

#: How often it is looked whether a bus is awake, and how long none may have begun to come then, at least [ns].
_LOOK_NS, _LEAST_NS = 500_000_000, 1_000_000_000
#: Where one frame in the first number does not come, the bus is taken to lose them; in the second, that is told.
#: Frames, and time [ns], that are weighed.
_LOSSY, _TOLD, _WEIGHED, _WEIGHED_NS = 50, 25, 100, FIRST_NS
#: While frames get lost, a message is missing after this number of times its timeout more, at least; and so many that
#: a row of losses takes so long once in RARE times, where a share of at most MOST is lost, some TOGETHER. From the
#: share HALF on it is known by the rate of those that come.
_LONGER, _RARE, _MOST, _TOGETHER, _HALF = 3, 1e10, 0.98, 3.0, 0.5
#: A message stopped before half of its timeout was over, which a gap between two frames seldom takes, or before as many
#: frames were due as get lost in a row once in the first number of times. The second share is lost at least.
_ROW, _LEAST = 1e4, 1e-3
#: Gaps in a row of one message that count at most, when another message has one; with so few messages each gap counts.
_MOST_ALONE, _TWO = 8, 2
#: A message that comes again after less than the first time was not missing: the supply dips while an engine is cranked
#: (ISO 16750-2, starting profile), and its ECU starts again. So does one after the second time (0.97 s in a drive of a
#: Durango) while the engine is cranked, which takes the third time, and not again before the fourth has passed [ns].
_DIP_NS, _START_NS, _CRANKED_NS, _AGAIN_NS = 250_000_000, 1_000_000_000, 5_000_000_000, 600_000_000_000
#: A bus sleeps after this time without a frame [ns].
_ASLEEP_NS = 1_000_000_000
#: A gap between two frames of a bus is unusual from the shortest timeout / UNUSUAL on: then the next frame decides. It
#: matters to a message from its own timeout / UNUSUAL on.
UNUSUAL = 3
#: Senders that stop at one time are switched off, not at fault, from this number on, a message whose sender nobody
#: names being half of one; and from this share of the messages of the bus on (its numerator and denominator). A parked
#: car's bus wakes in part, for a door: of those that do not come then the last share is enough.
_MANY, _PART, _OF, _PARKED = 3, 2, 5, 1
#: A bus that falls asleep is silent after this time, or those that have stopped are at fault [ns].
_AFTER_RUN_NS = 300_000_000_000


@kernel
def set_activity(T: Any, t_ns: int, bus: int, activity: int) -> None:
    """Note what a bus does, tell it unless it is its first time, and look again while that may change."""
    h = T.health[bus]
    before = h.activity
    h.activity = activity
    if before != activity and h.begun == 1:
        announce(T, t_ns, ACTIVITY, bus, bus, float(activity), float(before))
    if activity in (AWAKE, PART):
        h.begun = 1
    h.look_ns = t_ns + _LOOK_NS if activity in (WAKING, FALLING) else NEVER
    h.deadline_ns = min(h.deadline_ns, h.look_ns)


@kernel
def look_at_activity(T: Any, t_ns: int, bus: int) -> None:
    """Look whether a bus that wakes or falls asleep is awake: all messages come, or for a while none has begun to.

    One on which nobody is heard is asleep; that changes nothing for its messages before it is silent as a whole.
    """
    h = T.health[bus]
    awaited = h.silence == AWAITED and h.activity != ASLEEP
    if awaited:
        h.look_ns = NEVER
        watch_silence(h)
        if h.look_ns <= t_ns:
            set_activity(T, t_ns, bus, ASLEEP)
        if h.activity not in (WAKING, FALLING):
            return
    settled = h.activity == WAKING and t_ns - h.joined_ns >= max(h.settle_ns, _LEAST_NS)
    for k in range(T.checks.shape[0]):
        c = T.checks[k]
        if c.bus == bus and c.timeout_ns > 0 and c.coming in (NOT_YET, STOPPED) and not settled:
            set_activity(T, t_ns, bus, h.activity)
            return
    set_activity(T, t_ns, bus, AWAKE)
    if awaited:
        watch_silence(h)


@kernel
def begin_waking(T: Any, t_ns: int, bus: int) -> None:
    """Take the first frame of a bus that was asleep: none of its messages has come yet."""
    h = T.health[bus]
    h.weighed_ns = 0
    for k in range(T.checks.shape[0]):
        c = T.checks[k]
        if c.bus == bus and c.timeout_ns > 0:
            c.coming = NOT_YET
            c.seen, c.silent_ns, c.parked_ns, c.parks, c.asleep = 0, 0, 0, 0, 0
            c.deadline_ns = t_ns + c.wake_ns
            arm(T, c.timer, c.deadline_ns)
    set_waking(T, t_ns, bus)


@kernel
def set_waking(T: Any, t_ns: int, bus: int) -> None:
    """Note that a bus is heard again."""
    h = T.health[bus]
    h.joined_ns = t_ns
    set_activity(T, t_ns, bus, WAKING)
    arm(T, h.timer, h.deadline_ns)


@kernel
def watch_silence(h: Any) -> None:
    """Look at a bus on which messages wait for a frame of anybody: it sleeps, after a while without one."""
    h.look_ns = min(h.look_ns, h.heard_ns + max(_ASLEEP_NS, UNUSUAL * h.gap_ns))
    h.deadline_ns = min(h.deadline_ns, h.look_ns)


@kernel(inlined=False)
def waits_to_settle(T: Any, due: int, c: Any) -> bool:
    """Return whether a message whose time is over is not judged yet; its next deadline is set then.

    Args:
        T: the tables.
        due: when its time was over [ns].
        c: its record of Check.
    """
    if c.bus >= T.health.shape[0] - 1:
        return False
    h = T.health[c.bus]
    waits = False
    if h.settle_ns > 0 and not said_awake(T, T.debounces[c.fault[TIMEOUT]]):
        if c.coming in (COMES, STOPPED):
            waits = _settles(T, due, h, c)
        elif c.coming == NOT_YET:
            part = _are_many(T, due, c.bus, NOT_YET, False)
            waits = (
                part
                or (h.activity == FALLING and due < h.fell_ns + _AFTER_RUN_NS)
                or (is_lossy(due, h) and (h.share > _HALF or _lost_ns(h, c) > c.wake_ns))
                or (h.signs >= ENOUGH and is_other(T, due, c, TIMEOUT, 0, 0.0, 1.0))
            )
            if part and h.activity in (WAKING, AWAKE):
                set_activity(T, due, c.bus, PART)
            if waits:
                c.deadline_ns = due + max(c.wake_ns, c.timeout_ns)
    if not waits and c.coming == STOPPED:
        c.silent_ns += due - c.overdue_ns
        c.deadline_ns = due
    if not waits:
        c.coming = MISSING
    return waits


@kernel
def _settles(T: Any, due: int, h: Any, c: Any) -> bool:
    """Return whether it is to be seen first whether others stop, too."""
    lossy = is_lossy(due, h)
    if c.coming == COMES:
        c.coming, c.overdue_ns = STOPPED, due
        if not lossy and due - c.timeout_ns > h.stopped_ns + h.settle_ns:
            h.stopped_ns = due - c.timeout_ns
    until_ns = h.stopped_ns + h.settle_ns
    many = _are_many(T, due, c.bus, STOPPED, False)
    falls = (many and due >= until_ns) or stopped_apart(T, due, c.bus) or other_falls(T, c.bus)
    if h.activity in (AWAKE, PART) and falls:
        _fall(T, due, c.bus)
    elif h.activity == FALLING and not (falls or many or lossy):  # another that had stopped was only late
        set_activity(T, due, c.bus, AWAKE)
    if h.activity == FALLING or (h.activity == ASLEEP and h.fell_ns > h.joined_ns):
        until_ns = h.fell_ns + _AFTER_RUN_NS
        if moves(T, due) and not (many or lossy):
            until_ns = c.overdue_ns + h.settle_ns  # those that are few, and do not come while it drives on
    elif _is_parked(T, due, c.bus):
        until_ns = due + h.settle_ns
    elif due < h.joined_ns + _WEIGHED_NS:
        until_ns = max(until_ns, h.joined_ns + _WEIGHED_NS)
    elif lossy:
        until_ns = max(until_ns, c.overdue_ns + max(_lost_ns(h, c), h.settle_ns))
    if due >= until_ns:
        apart = h.activity != FALLING and stopped_apart(T, due, c.bus)  # while it still wakes, too
        if h.activity == FALLING or not (apart or _are_many(T, due, c.bus, STOPPED, True)):
            return False
        if apart:
            _fall(T, due, c.bus)
        until_ns = due + (_AFTER_RUN_NS if apart else h.settle_ns)
    c.deadline_ns = min(until_ns, due + max(h.settle_ns, c.timeout_ns))
    return True


@kernel
def other_falls(T: Any, bus: int) -> bool:
    """Return whether another bus falls asleep, or did: the vehicle is switched off."""
    for k in range(T.health.shape[0] - 1):
        o = T.health[k]
        if k != bus and (o.activity == FALLING or (o.activity == ASLEEP and o.fell_ns > o.joined_ns)):
            return True
    return False


@kernel
def _is_parked(T: Any, t_ns: int, bus: int) -> bool:
    """Return whether a bus that fell asleep before is awake in part: who stops then falls asleep again."""
    return bool(T.health[bus].fell_ns > 0 and _are_many(T, t_ns, bus, NOT_YET, False))


@kernel(inlined=False)
def note_gap(T: Any, t_ns: int, c: Any, gap_ns: int) -> None:
    """Take a gap of more than one and a half cycles of a message, or of less than a third of one, or one of its first.

    Where too many frames do not come, the bus, the host or the recorder loses them; those that come late, together, are
    none of these. That is told when it begins and ends. Gaps of one message count when another has one: a sender that
    skips alone is at fault itself.
    """
    if c.bus >= T.health.shape[0] - 1:
        return
    h = T.health[c.bus]
    if c.first < FIRST:
        c.first, c.span_ns = c.first + 1, c.span_ns + gap_ns
        if c.first == FIRST:
            c.wide_ns = max(c.wide_ns, int(MISSES * c.span_ns / FIRST))
    elif gap_ns <= c.wide_ns // SOON:
        h.gaps = max(h.gaps - (1 - c.repeats), 0)  # one that is sent at a change, too, was not late
    elif h.gapped == c.row + 1 and _has_others(T, c):
        h.alone += 1
    else:
        h.gaps += min(h.alone, _MOST_ALONE)
        h.gapped, h.alone = c.row + 1, 1
    if h.weighed_ns == 0:
        h.watched, h.gaps, h.weighed_ns = 0, 0, t_ns
    share = _lost_share(T, t_ns, c.bus) if t_ns - h.weighed_ns >= _WEIGHED_NS else -1.0
    if share >= 0.0:
        h.share = max(h.gaps / max(h.watched, 1), share)
        lossy = h.share * (_LOSSY if h.lossy == 1 else _TOLD) > 1.0
        if lossy != (h.lossy == 1):
            announce(T, t_ns, LOSSY, c.bus, c.bus, h.share, 1.0 / _LOSSY)
        h.lossy = 1 if lossy else 0
        h.watched, h.gaps, h.weighed_ns = 0, 0, t_ns


@kernel
def _has_others(T: Any, c: Any) -> bool:
    """Return whether more than TWO messages of the bus of a message are watched, and come."""
    count = 0
    for k in range(T.checks.shape[0]):
        o = T.checks[k]
        if o.bus == c.bus and o.timeout_ns > 0 and o.coming in (COMES, STOPPED):
            count += 1
            if count > _TWO:
                return True
    return False


@kernel
def _lost_share(T: Any, t_ns: int, bus: int) -> float:
    """Return the share of the frames that did not come of the messages that come; 0: less than half; -1: too few.

    A recorder that takes frames for a moment, and none for the next, has few gaps, and long ones. A message that
    has stopped for longer than frames are known to get lost does not come.
    """
    h, one = T.health[bus], 0.0
    for k in range(T.checks.shape[0]):
        c = T.checks[k]
        may_come = h.lossy == 0 or h.share > _HALF or t_ns < c.overdue_ns + _lost_ns(h, c)
        comes = c.coming == COMES or (c.coming == STOPPED and may_come)
        if c.bus == bus and comes and c.one_ns > 0:
            one += c.stride * c.slots * ((t_ns - h.weighed_ns) / c.one_ns)
    if max(one, h.watched) < _WEIGHED:
        return -1.0
    share = 1.0 - h.watched / max(one, 1.0)
    return share if share > _HALF else 0.0


@kernel
def is_lossy(t_ns: int, h: Any) -> bool:
    """Return whether frames of a bus get lost now; where most do, they come in bursts without a gap."""
    lately = h.watched < _WEIGHED or (h.share > _HALF and t_ns < h.weighed_ns + 2 * _WEIGHED_NS)
    return bool(h.gaps * _LOSSY > max(h.watched, _WEIGHED) or (h.lossy == 1 and lately))


@kernel
def lost_share(h: Any) -> float:
    """Return the share of the frames of a bus that get lost, as far as it is seen now."""
    return float(min(max(h.share if h.lossy == 1 else 0.0, h.gaps / max(h.watched, _WEIGHED)), _MOST))


@kernel
def _lost_ns(h: Any, c: Any) -> int:
    """Return how long behind its timeout frames of a message may be missing that were lost on the way [ns].

    Where each is lost with the probability p, and none knows of another, n of them are with p^n.
    """
    share = lost_share(h)
    together = _TOGETHER if share > _HALF else 1.0
    return int(max(_LONGER * c.timeout_ns, together * math.log(_RARE) / (1.0 - share) * c.wide_ns / MISSES))


@kernel
def is_gone(T: Any, t_ns: int, c: Any) -> bool:
    """Return whether a message whose time is over is missing, not lost on the way."""
    h = T.health[c.bus]
    gap_ns = t_ns - c.overdue_ns + c.timeout_ns
    if t_ns < h.joined_ns + _WEIGHED_NS or gap_ns < _DIP_NS:
        return False  # a bus that has just begun may lose frames
    if gap_ns < _START_NS:
        since_ns = t_ns - h.dipped_ns
        first = h.dipped_ns == 0 or since_ns >= _AGAIN_NS
        if first or since_ns < _CRANKED_NS:
            h.dipped_ns = t_ns if first else h.dipped_ns
            T.clock[0].timeouts += 1
            return False
    return _is_not_lost(t_ns, h, c)


@kernel
def _is_not_lost(t_ns: int, h: Any, c: Any) -> bool:
    """Return whether a message that has stopped is away for longer than a row of lost frames is."""
    return bool(not is_lossy(t_ns, h) or t_ns >= c.overdue_ns + _lost_ns(h, c))


@kernel
def _fall(T: Any, t_ns: int, bus: int) -> None:
    h = T.health[bus]
    h.fell_ns = t_ns
    set_activity(T, t_ns, bus, FALLING)
    arm(T, h.timer, h.deadline_ns)


@kernel
def _last_ns(c: Any) -> int:
    """Return when the last frame of a message came that comes, or has stopped: silences were added to its time."""
    return int((c.overdue_ns if c.coming == STOPPED else c.deadline_ns) - c.timeout_ns - c.silent_ns)


@kernel
def _stopped_by(h: Any, c: Any) -> int:
    """Return before which time a message stopped, if it did: its next frames were late, or lost, too seldom."""
    share = min(max(lost_share(h), h.share, _LEAST), _MOST)
    row_ns = (MISSES - math.log(_ROW) / math.log(share)) * c.wide_ns / MISSES
    return _last_ns(c) + int(max(c.timeout_ns / 2, row_ns))


@kernel
def _is_away(now: int, h: Any, c: Any) -> bool:
    """Return whether a message has stopped, and was not only lost, though its time may not be over."""
    return bool(
        (c.coming == COMES and c.parked_ns == 0 and now > _stopped_by(h, c))
        or (c.coming == STOPPED and _is_not_lost(now, h, c))
    )


@kernel
def _first_stop(T: Any, now: int, bus: int) -> int:
    """Return the place of the message that stopped first of those that have; -1: none has."""
    h, first, first_ns = T.health[bus], -1, NEVER
    for k in range(T.checks.shape[0]):
        c = T.checks[k]
        if c.bus == bus and c.timeout_ns > 0 and _is_away(now, h, c) and _stopped_by(h, c) < first_ns:
            first, first_ns = k, _stopped_by(h, c)
    return first


@kernel
def stopped_apart(T: Any, now: int, bus: int) -> bool:
    """Return whether senders stopped at several times: one after its last frame, others before that.

    An ECU that dies stops all of its messages at one time, which lies between these of each of them.
    """
    h, first = T.health[bus], _first_stop(T, now, bus)
    if first < 0:
        return False
    sender, by_ns = T.checks[first].sender, _stopped_by(h, T.checks[first])
    for k in range(T.checks.shape[0]):
        c = T.checks[k]
        other = c.bus == bus and c.timeout_ns > 0 and (c.sender < 0 or c.sender != sender)
        if other and _last_ns(c) > by_ns and _is_away(now, h, c):
            return True
    return False


@kernel
def _are_many(T: Any, due: int, bus: int, coming: int, doubt: bool) -> bool:
    """Return whether the senders that have stopped, or not come yet, are more than are at fault at one time.

    ``doubt``: or would be, if those had stopped, too, of which that is not known yet.
    """
    h = T.health[bus]
    away = on = halves = 0
    first = _first_stop(T, due, bus) if coming == STOPPED else -1
    by_ns = _stopped_by(h, T.checks[first]) if first >= 0 else due
    for k in range(T.checks.shape[0]):
        c = T.checks[k]
        if c.bus != bus or c.timeout_ns <= 0:
            continue
        comes = c.coming == COMES and (coming == NOT_YET or c.timeout_ns <= due - by_ns)
        if c.coming == coming and (coming == NOT_YET or doubt or _is_not_lost(due, h, c)):
            away += 1
            halves += 1 if c.sender < 0 else 2 * _is_first(T, k)
        elif comes:
            on += 1
    part = _PARKED if coming == NOT_YET and h.fell_ns > 0 else _PART
    return bool(halves >= 2 * _MANY and away * _OF >= (away + on) * part)


@kernel
def _is_first(T: Any, k: int) -> bool:
    """Return whether a message is the first of those of its sender that are as it is."""
    c = T.checks[k]
    for j in range(k):
        if T.checks[j].sender == c.sender and T.checks[j].coming == c.coming:
            return False
    return True


@kernel
def begin_to_come(T: Any, t_ns: int, c: Any) -> bool:
    """Take that a message comes again; returns whether it, and others that have stopped, were missing alone."""
    h, stopped = T.health[c.bus], c.coming == STOPPED
    if c.coming == NOT_YET:
        h.joined_ns = max(h.joined_ns, t_ns)
        if h.weighed_ns > 0 and c.one_ns > 0:  # until now it had no rate
            h.watched += int(c.stride * c.slots * ((t_ns - h.weighed_ns) / c.one_ns))
        if h.activity == PART and not _are_many(T, t_ns, c.bus, NOT_YET, False):
            set_activity(T, t_ns, c.bus, AWAKE)
    elif stopped and h.activity in (AWAKE, PART) and is_gone(T, t_ns, c) and not stopped_apart(T, t_ns, c.bus):
        if _are_many(T, t_ns, c.bus, STOPPED, False):
            _fall(T, t_ns, c.bus)
        elif not _is_parked(T, t_ns, c.bus) and not _are_many(T, t_ns, c.bus, STOPPED, True):
            return True
    c.coming = COMES
    return False
