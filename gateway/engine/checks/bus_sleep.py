"""A bus that falls silent as a whole: it sleeps, or is cut off; or the recorder paused. That is one cause.

The time of a message is over: is it that message, or is the whole bus silent? If any frame came just before, it is that
message. If not, the message is *parked*: the next frame decides, or the bus is silent as a whole.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from gateway.common.times import NEVER
from gateway.engine.checks.activity import UNUSUAL, other_falls, set_activity, stopped_apart, watch_silence
from gateway.engine.checks.bus_health import ASLEEP, AWAITED, SILENT, SPOKEN, WHOLE, Params, Silence
from gateway.engine.checks.communication import CheckInstance
from gateway.engine.checks.kinds import TIMEOUT
from gateway.engine.gate import said_awake, sleeps
from gateway.engine.results import not_tested
from gateway.engine.timers import arm
from gateway.signals.database import Database
from gateway_fdi.errors import InputError
from gateway_fdi.jit import kernel

#: A bus is silent as a whole after this time, even with a slower sender [ns].
_LONGEST_NS = 10_000_000_000
#: A silence is looked at again and again; after an hour less often [ns].
_HOUR_NS, _AGAIN_NS = 3_600_000_000_000, 60_000_000_000
#: A message is missing if it missed this number of silences that were not of the whole bus.
MOST_PARKS = 3
#: Senders of databases that do not know the sender.
NOBODY = ("XXX", "Vector__XXX")


def silence_of(bus: int, params: Params, checks: Sequence[CheckInstance], databases: Mapping[int, Database]) -> Silence:
    """Return when a bus is silent as a whole: each of its senders has a message overdue."""
    shortest: dict[str, float] = {}
    for check in checks:
        timeout_ms = check.params.timeout_ms
        if check.bus == bus and timeout_ms is not None:
            name = sender_of(check.params.message, databases[bus])
            sender = f"ECU {name}" if name else check.params.message  # a message of an unknown sender has its own
            shortest[sender] = min(timeout_ms, shortest.get(sender, timeout_ms))
    if not params.watched or not shortest or (len(shortest) < 2 and params.silent_ms is None):
        return Silence()
    quiet_ns = min(round(max(shortest.values()) * 1e6), _LONGEST_NS)
    if params.silent_ms is not None:
        quiet_ns = round(params.silent_ms * 1e6)
    return Silence(quiet_ns, round(min(shortest.values()) * 1e6) // UNUSUAL)


def sender_of(message: str, database: Database) -> str:
    """Return the name of the ECU that sends a message; "": the database does not say."""
    try:
        senders = database.message(message).senders
    except InputError:  # told where the check is filled
        senders = []
    return next((str(name) for name in senders if name not in NOBODY), "")


@kernel
def others_sleep(T: Any, t_ns: int, bus: int) -> bool:
    """Return whether there are other buses, and none is heard: all sleep, or the recorder paused.

    One that is heard again after an unusual silence, which ended while this bus was silent, tells that for as long as
    this bus may take to wake.
    """
    h = T.health[bus]
    others = spoken = 0
    for k in range(T.health.shape[0] - 1):
        o = T.health[k]
        if k != bus and o.quiet_ns > 0:
            others += 1
            awake = o.activity != ASLEEP and (o.talks_ns <= h.heard_ns or t_ns - o.talks_ns >= h.wake_ns)
            if awake and o.heard_ns - h.heard_ns > UNUSUAL * max(h.gap_ns, o.gap_ns):
                spoken += 1
    return others > 0 and spoken == 0


@kernel
def park(T: Any, due: int, c: Any) -> bool:
    """Have a message whose time is over wait for a frame of anybody; returns whether it does.

    A bus of one sender cannot tell its silence from that of the sender: it waits while all other buses sleep.

    Args:
        T: the tables.
        due: when its time was over [ns].
        c: its record of Check.
    """
    if c.bus >= T.health.shape[0] - 1:
        return False
    h = T.health[c.bus]
    if h.quiet_ns == 0 and due - h.heard_ns >= c.timeout_ns and others_sleep(T, due, c.bus):
        c.deadline_ns = due + c.timeout_ns
        return True
    if h.quiet_ns == 0 or due - h.heard_ns <= h.gap_ns or int(h.bad) & ~(1 << SILENT) != 0:
        return False
    if c.parks >= MOST_PARKS and h.silence != WHOLE:
        return False
    c.parked_ns = due
    c.deadline_ns = NEVER
    if h.silence == WHOLE:
        not_tested(T, due, c.fault[TIMEOUT])
    elif h.silence == SPOKEN:
        h.silence = AWAITED
        h.until[SILENT] = max(h.heard_ns + h.quiet_ns, due + 1)
        h.deadline_ns = min(h.deadline_ns, h.until[SILENT])
        watch_silence(h)
        arm(T, h.timer, h.deadline_ns)
    return True


@kernel
def is_alone(T: Any, bus: int) -> bool:
    """Return whether there is no other bus that can say that all is awake."""
    for k in range(T.health.shape[0] - 1):
        if k != bus and T.health[k].quiet_ns > 0:
            return False
    return True


@kernel(inlined=False)
def judge_silence(T: Any, t_ns: int, bus: int) -> None:
    """Judge a bus that was silent for long enough; its verdict is in ``failed``.

    Nothing is said of one that may sleep: no other bus is heard, or ``[power]`` says so; nor, unless that says that the
    vehicle is awake, of one that ``sleeps`` and is the only one, or fell asleep, or has not settled yet, or while
    another falls asleep. It is looked at again.

    Args:
        T: the tables.
        t_ns: now.
        bus: its index.
    """
    h = T.health[bus]
    for k in range(T.checks.shape[0]):
        c = T.checks[k]
        if c.bus == bus and c.parked_ns > 0:
            not_tested(T, t_ns, c.fault[TIMEOUT])
    silent_ns, fault = t_ns - h.heard_ns, h.fault[SILENT]
    may_fall = h.settle_ns > 0 and not said_awake(T, T.debounces[fault])
    set_activity(T, t_ns, bus, ASLEEP)
    h.until[SILENT] = t_ns + max(h.quiet_ns, _AGAIN_NS if silent_ns > _HOUR_NS else 0)
    if sleeps(T, T.debounces[fault]):
        h.asleep = 1
        not_tested(T, t_ns, fault)
    elif others_sleep(T, t_ns, bus):
        not_tested(T, t_ns, fault)
    elif h.asleep == 1 and h.wake_ns > 0:  # it wakes
        h.asleep = 0
        h.until[SILENT] = t_ns + h.wake_ns
    elif may_fall and (stopped_apart(T, t_ns, bus) or is_alone(T, bus) or other_falls(T, bus)):
        not_tested(T, t_ns, fault)
    elif may_fall and silent_ns < h.settle_ns:
        h.until[SILENT] = h.heard_ns + h.settle_ns
    else:
        h.failed |= 1 << SILENT
        h.bad |= 1 << SILENT
        h.value, h.limit = silent_ns * 1e-6, h.quiet_ns * 1e-6
        h.evidence[0], h.evidence[1], h.evidence[2] = h.value, 0.0, 0.0
    h.deadline_ns = min(h.deadline_ns, h.until[SILENT])
