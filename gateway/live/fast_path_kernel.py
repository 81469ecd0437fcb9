"""The pump's kernel: from the sockets of the buses to the verdict without Python.

One pass waits for the sockets, receives, puts stamps on the engine's time, joins buses in order of time, takes the
frames down for those who read them later, runs the engine and sends what its monitors send. It repeats that until there
is something that only Python can do, and says what: one of the reasons below. Frames that only Python can receive are
handed in: those of a bus that is no socket, and of a socket where something unusual is among them. They are joined, and
fed, as all others are.

It is the one kernel that waits, and reads clocks. It needs Linux' C library and structures: elsewhere Python waits, and
all frames are handed in.
"""

from __future__ import annotations

from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gateway.bus.can_structs import fill_struct, settle
from gateway.bus.frames import ERROR, EXTENDED, OWN
from gateway.faults.journal_steps import Journalled, journal_put
from gateway.runtime.fast_path_conditions import JOURNAL, NOBODY
from gateway.servers.prepared_frames_kernel import PreparedTables, prepare_next
from gateway_fdi.jit import Record, i8, i8s, kernel, means
from gateway_fdi.jit.system import call_bound, clock_gettime, poll, recvmmsg, send

#: Reasons to leave for Python. Nothing was received since the last batch that was fed:
TIME = 0  # time has come: an engine's or a server's timer, or the loop's own look
DOOR = 1  # another descriptor is readable: status socket, reports
BUS = 2  # a bus is Python's to read: it is no socket, its socket tells an error, or Python has to do with it
INTERRUPTED = 3  # a signal came
#: Frames were received, and are handed over as they are:
RAW = 4  # with something rare among them: an error frame of no class, our own frame, frames lost in a queue, no order
STEPPED = 5  # the wall clock was set
#: Frames are on the engine's time, in order, and not fed yet:
WANTED = 6  # one is for a server
AHEAD = 7  # a time comes among them before which all must be done: a diagnosis, a look of the usage meter
FULL = 8  # no room to take them down
CONDITION = 9  # something rare is among them that was handed in: a bus came or went, our own frame
#: The engine has begun with the batch:
EVENTS = 10  # it has something to tell that does not wait for the next reason, as first passes do
SENDING = 11  # a monitor sends, and a queue is full, or somebody takes down what is sent
SERVER = 12  # the time of a server, or of a recording, has come
FAILED = 13  # the loop of the engine has failed

#: Time for which a frame of several buses is held back: an earlier one of another bus may still come [ns].
SETTLE_NS = 200_000
#: No frame is held back longer than this [ns]: clocks of interfaces may differ.
LONGEST_NS = 5_000_000
#: Frames of one bus that wait for those of others; then it is not read until these have come.
MOST_WAITING = 256

_POLLIN = 1
_DONTWAIT = 0x40
_NOSIGNAL = 0x4000
_REALTIME, _MONOTONIC = 0, 1
_SECOND = 1_000_000_000
#: Frames that come faster than this free those that are held back: no timer of the system's is set for these, which can
#: cost as much as two frames.
_DENSE_NS = 1_000_000
#: Longest time for which a single bus that has more than one call takes is read without a look at anything else [ns].
_UNASKED_NS = 1_000_000


class Side(Record):
    """One bus, or the places where the wall clock was set."""

    fd: i8 = means("its socket; -1: Python receives")
    headers: i8 = means("address of the headers of its messages")
    lost: i8 = means("the socket's count of lost frames, modulo 2**32")
    count: i8 = means("frames received in this pass")
    gaps: i8 = means("places in it before which frames were lost")
    more: i8 = means("1: it may have more than these")
    last_ns: i8 = means("time of the latest frame received", "ns")
    waiting: i8 = means("its frames that are held back")
    joined: i8 = means("of these frames, those that are in the common order")
    received: i8 = means("frames received since the pump was entered")
    rejected: i8 = means("messages that were no frames since then")
    sent: i8 = means("frames sent since then")


class State(Record):
    """Orders to the pump, and its report."""

    # Times, of the engine unless it says so.
    offset_ns: i8 = means("what the wall clock is ahead of the engine's", "ns")
    difference_ns: i8 = means("what the wall clock is ahead of the monotonic one", "ns")
    tolerance_ns: i8 = means("change of that which is a step", "ns")
    leave_ns: i8 = means("when to leave at the latest", "ns")
    prompt_ns: i8 = means("when a server of the bus's own time is due", "ns")
    server_ns: i8 = means("engine's time at which a server, or a recording, is due", "ns")
    before_ns: i8 = means("a frame from this time on is not fed", "ns")
    grace_ns: i8 = means("time that the engine's timers lag the clock without traffic", "ns")
    may_send: i8 = means("1: frames of monitors are sent here")
    foretells: i8 = means("who sends DTC frames of verdicts: NOBODY here, AT_ONCE, or the JOURNAL")
    waits: i8 = means("1: it may wait")
    sockets: i8 = means("buses of which it receives")
    handed: i8 = means("1: frames are handed in, nothing is received")
    final: i8 = means("1: nothing is held back")
    # The engine: its entry, places in its cells and in its clock.
    entry: i8 = means("address of the engine's loop")
    arguments_at: i8 = means("address of its arguments")
    results_at: i8 = means("address of its results")
    frames_at: i8 = means("cell of the batch")
    cells_at: i8 = means("cell of the same batch in cells")
    start_at: i8 = means("cell of the first frame")
    until_at: i8 = means("cell of the time that passes then")
    never: i8 = means("the time that never comes", "ns")
    now_at: i8 = means("cell of the clock: its time")
    deadline_at: i8 = means("cell of the clock: before it no timer is due")
    urgent_at: i8 = means("cell of the clock: whether there are events that do not wait")
    events_at: i8 = means("cell of the clock: how many events there are")
    sent_at: i8 = means("cell of the clock: frames sent")
    fed_at: i8 = means("cell of the clock: first of these that went through the engine")
    taken_at: i8 = means("cell of the clock: first of these that have left")
    # Its report.
    batch: i8 = means("address of the latest batch")
    count: i8 = means("its frames")
    start: i8 = means("first of these that the engine has not handled")
    took: i8 = means("frames taken down since the pump was entered")
    told: i8 = means("DTC frames sent since then")
    knocked: i8 = means("1: the other descriptor is readable")
    held: i8 = means("frames held back: an earlier one of another bus may still come")
    read_ns: i8 = means("when the sockets were looked at last", "ns")
    wall_ns: i8 = means("the wall clock, as it was read last", "ns")
    asked: i8 = means("1: they were waited for in this pass")
    asked_ns: i8 = means("when they, and the other descriptor, were waited for last", "ns")
    gap_ns: i8 = means("time between the last two looks", "ns")
    passes: i8 = means("passes since the pump was entered")
    clock: Annotated[i8s, 2] = means("struct timespec")


class Pumped(NamedTuple):
    """Memory of the pump, in one argument.

    ``state`` has one row, ``sides`` one a bus and one for steps of the wall clock. ``polls`` are struct pollfd, one a
    bus and one for all other descriptors. ``messages``, ``control`` and ``gaps`` have a row a bus (see
    :class:`gateway.bus.can_structs.RawReceiver`), ``frames``, and the same in ``cells``, a row a side. ``merged`` and
    ``since`` take the frames of several buses, and the time at which each was received; ``held`` and ``held_since``
    those that wait. ``taken`` are the frames for those who read them later. ``clock`` is the engine's, ``outbox`` its
    outbox in cells, ``wire`` room for one struct canfd_frame. ``heard`` are the identifiers of 11 bits that servers
    want, as flags, ``extended`` those of 29: value, and mask of the bits that count. ``events`` are the engine's,
    ``foreseen`` what the DTC frames of the next verdicts are made of, ``journal`` takes verdicts.
    """

    state: NDArray[np.void]
    sides: NDArray[np.void]
    polls: NDArray[np.int64]
    messages: NDArray[np.void]
    control: NDArray[np.uint8]
    gaps: NDArray[np.int64]
    frames: NDArray[np.void]
    cells: NDArray[np.uint64]
    merged: NDArray[np.uint64]
    since: NDArray[np.int64]
    held: NDArray[np.uint64]
    held_since: NDArray[np.int64]
    taken: NDArray[np.uint64]
    arguments: NDArray[np.int64]
    results: NDArray[np.int64]
    clock: NDArray[np.int64]
    outbox: NDArray[np.uint64]
    wire: NDArray[np.uint64]
    heard: NDArray[np.uint8]
    extended: NDArray[np.int64]
    events: NDArray[np.void]
    foreseen: PreparedTables
    journal: Journalled


@kernel
def _read_clock(which: int, s: Any) -> int:
    """Return a clock of the system [ns]."""
    clock_gettime(which, s.clock.ctypes.data)
    return int(s.clock[0] * _SECOND + s.clock[1])


@kernel
def _was_set(s: Any) -> bool:
    """Return whether the wall clock, which was read right before this, may have been set since Python looked."""
    change = s.wall_ns - _read_clock(_MONOTONIC, s) - s.difference_ns
    return bool(abs(change) > s.tolerance_ns)


@kernel
def patience_ms(P: Any, now_ns: int) -> int:
    """Return how long the sockets may be waited for [ms]: until time has come for something.

    Args:
        P: a :class:`Pumped`.
        now_ns: engine's time [ns].
    """
    s = P.state[0]
    until = min(s.leave_ns, s.prompt_ns)
    due_ns = min(P.clock[s.deadline_at], s.server_ns)
    if s.before_ns > 0:
        due_ns = min(due_ns, s.before_ns)
    if due_ns < s.never - s.grace_ns:
        until = min(until, due_ns + s.grace_ns)
    if s.held > 0:
        until = min(until, now_ns + (LONGEST_NS if s.gap_ns < _DENSE_NS else 500_000))
    if s.waits == 0 or until <= now_ns:
        return 0
    return int((until - now_ns + 999_999) // 1_000_000)


@kernel
def _wait(P: Any, s: Any, now_ns: int) -> int:
    """Wait for the sockets, and for time to pass; returns a reason to leave, -1: frames wait, or a door is open."""
    buses = P.sides.shape[0] - 1
    for k in range(buses + 1):
        P.polls[k] = (P.polls[k] & 0xFFFFFFFF) | (_POLLIN << 32)
    ready = poll(P.polls.ctypes.data, buses + 1, patience_ms(P, now_ns))
    if ready < 0:
        return INTERRUPTED
    s.knocked = P.polls[buses] >> 48 != 0
    if ready == 0:
        if s.held == 0:
            return TIME
        return -1 if s.sockets > 0 else BUS
    for b in range(buses):
        told = P.polls[b] >> 48
        if told not in (0, _POLLIN) or (told != 0 and P.sides[b].fd < 0):
            return BUS
    return -1 if s.sockets > 0 else DOOR


@kernel
def _asks(P: Any, s: Any, now_ns: int) -> bool:
    """Return whether the sockets are to be waited for before they are read."""
    one = P.sides.shape[0] == 2 and s.passes > 0
    return not (one and P.sides[0].more == 1 and now_ns < s.asked_ns + _UNASKED_NS)


@kernel
def _receive(P: Any, s: Any, b: int, want: bool) -> int:
    """Receive what a bus has; returns 0, RAW where something of it is rare, BUS where its socket tells an error."""
    side = P.sides[b]
    side.count = 0
    side.gaps = 0
    side.more = 0
    if side.waiting >= MOST_WAITING:
        side.more = 1
        return 0
    if not want:
        return 0
    got = recvmmsg(side.fd, side.headers, P.messages.shape[1], _DONTWAIT, 0)
    if got < 0:
        return BUS if s.asked == 1 else 0  # it had just as much as the last call took
    messages, frames = P.messages[b], P.frames[b]
    kept, rejected, lost, gaps = settle(messages, P.control[b], P.gaps[b], frames, got, b, s.wall_ns, side.lost)
    side.count, side.gaps, side.lost = kept, gaps, lost
    side.received += kept
    side.rejected += rejected
    rare = gaps > 0
    last_ns = np.int64(0)
    for k in range(kept):
        frame = P.frames[b, k]
        rare = rare or np.int64(frame["can_id"]) == ERROR or np.int64(frame["flags"]) & OWN != 0
        rare = rare or frame["t_ns"] < last_ns
        last_ns = frame["t_ns"]
    if kept > 0:
        side.last_ns = last_ns - s.offset_ns
    if got == P.messages.shape[1]:
        side.more = 1
    return RAW if rare else 0


@kernel
def _next(P: Any, s: Any, held: int) -> int:
    """Return which side has the earliest frame: its index, -1: those held back from ``held`` on, -2: none has.

    Of equal times those held back are the first, then the steps of the clock.
    """
    sides = P.sides.shape[0]
    best, best_ns = -2, np.int64(0)
    if held < s.held:
        best, best_ns = -1, np.int64(P.held[held, 0])
    for j in range(sides):
        b = (j + sides - 1) % sides
        at = P.sides[b].joined
        if at < P.sides[b].count:
            t_ns = np.int64(P.cells[b, at, 0])
            if best == -2 or t_ns < best_ns:
                best, best_ns = b, t_ns
    return best


@kernel
def _hold(P: Any, s: Any, due: int, total: int) -> None:
    """Hold back the merged frames from ``due`` on."""
    for k in range(due, total):
        for j in range(10):
            P.held[k - due, j] = P.merged[k, j]
        P.held_since[k - due] = P.since[k]
        P.sides[np.int64((P.merged[k, 1] >> np.uint64(32)) & np.uint64(0xFF))].waiting += 1
    s.held = total - due


@kernel
def _join(P: Any, s: Any) -> None:
    """Put what the buses gave, and what was held back, into one order of time.

    A frame that is too new to be sure that no earlier one of another bus will still come is held back; of one bus none.
    """
    total, held = 0, 0
    until, more = s.read_ns - SETTLE_NS, False
    if s.final == 1 or P.sides.shape[0] == 2:
        until = s.never
    for b in range(P.sides.shape[0]):
        side = P.sides[b]
        side.joined = side.waiting = 0
        if side.more == 1 and P.sides.shape[0] > 2:
            until, more = min(until, side.last_ns), True
    while True:
        best = _next(P, s, held)
        if best == -2:
            break
        if best == -1:
            source, since = P.held[held], P.held_since[held]
            held += 1
        else:
            source, since = P.cells[best, P.sides[best].joined], s.read_ns
            P.sides[best].joined += 1
        for j in range(10):
            P.merged[total, j] = source[j]
        P.since[total] = since
        total += 1
    due = 0
    for k in range(total):
        t_ns = np.int64(P.merged[k, 0])
        # A frame that is not of the future is late only because another bus has more to read.
        late = P.since[k] < s.read_ns - LONGEST_NS and (not more or t_ns > s.read_ns)
        if t_ns <= until or late:
            due = k + 1
    due = max(due, total - P.held.shape[0])
    _hold(P, s, due, total)
    s.batch, s.count = P.merged.ctypes.data, due


@kernel
def _look(P: Any, s: Any, cells: Any) -> int:
    """Return why a batch cannot be fed here, -1: it can."""
    if s.took + s.count > P.taken.shape[0]:
        return FULL
    handed = s.handed == 1 or P.sides.shape[0] > 2  # what a single socket gives has nothing rare among it
    for k in range(s.count):
        if np.int64(cells[k, 0]) >= s.before_ns:
            return AHEAD
        can_id = np.int64(cells[k, 1] & np.uint64(0xFFFFFFFF))
        if handed and (can_id == ERROR or np.int64(cells[k, 1] >> np.uint64(40)) & OWN != 0):
            return CONDITION
        if can_id & EXTENDED:
            for e in range(P.extended.shape[0]):
                if can_id & P.extended[e, 1] == P.extended[e, 0]:
                    return WANTED
        elif P.heard[can_id & 0x7FF] != 0:
            return WANTED
    return -1


@kernel
def _transmit(P: Any, s: Any) -> bool:
    """Send what monitors have sent; returns whether all of it was."""
    clock = P.clock
    last = clock[s.sent_at]
    if s.may_send == 0:
        return False
    while clock[s.taken_at] < last:
        row = P.outbox[clock[s.taken_at]]
        side = P.sides[np.int64((row[1] >> np.uint64(32)) & np.uint64(0xFF))]
        if side.fd < 0:
            return False
        size = fill_struct(row, P.wire)
        if send(side.fd, P.wire.ctypes.data, size, _DONTWAIT | _NOSIGNAL) != size:
            return False
        side.sent += 1
        clock[s.taken_at] += 1
    waiting = False  # for the next pass of the engine: messages that it decodes itself
    for k in range(clock[s.fed_at], last):
        waiting = waiting or P.outbox[k, 1] >> np.uint64(56) != 0
    if not waiting:
        clock[s.sent_at] = clock[s.fed_at] = clock[s.taken_at] = 0
    return True


@kernel
def _send_early(P: Any, s: Any) -> None:
    """Send the DTC frames of the verdicts that wait, if it is foreseen what they are; Python does the rest."""
    clock, foreseen = P.clock, P.foreseen
    side = P.sides[foreseen.head[0].bus]
    if side.fd < 0 or clock[s.sent_at] > clock[s.taken_at]:
        return
    for k in range(prepare_next(foreseen, P.events, clock[s.events_at], clock[s.now_at])):
        size, made = fill_struct(foreseen.frames[k], P.wire), foreseen.made[k]
        if s.foretells == JOURNAL:
            e = P.events[made.event]
            made.number = journal_put(
                P.journal, e.fault, e.kind, e.t_ns, made.status, made.occurrence, e.fdc, P.wire, size, side.fd
            )
            if made.number == 0:
                return
        elif send(side.fd, P.wire.ctypes.data, size, _DONTWAIT | _NOSIGNAL) != size:
            return
        else:
            side.sent += 1
        s.told += 1


@kernel
def _run(P: Any, s: Any) -> int:
    """Run the engine over the rest of the batch; returns a reason to leave, -1: there is none."""
    arguments, clock = P.arguments, P.clock
    arguments[s.frames_at], arguments[s.frames_at + 1] = s.batch, s.count
    arguments[s.cells_at], arguments[s.cells_at + 1] = s.batch, s.count
    arguments[s.until_at] = s.never
    while s.start < s.count:
        arguments[s.start_at] = s.start
        if call_bound(s.entry, s.arguments_at, s.results_at) != 0:
            return FAILED
        s.start = P.results[0]
        if clock[s.urgent_at] != 0:
            if s.foretells != NOBODY:
                _send_early(P, s)
            return EVENTS
        if clock[s.sent_at] > clock[s.taken_at]:
            return SENDING
    return SERVER if clock[s.now_at] >= s.server_ns else -1


@kernel
def _feed(P: Any, s: Any, cells: Any) -> int:
    """Take a batch down, and run the engine over it; returns a reason to leave, -1: there is none."""
    why = _look(P, s, cells)
    if why >= 0:
        return why
    for k in range(s.count):
        for j in range(10):
            P.taken[s.took + k, j] = cells[k, j]
    s.took += s.count
    s.start = 0
    return _run(P, s)


@kernel
def _pass_on(P: Any, s: Any) -> int:
    """Join what the buses have given, and feed what is due; returns a reason to leave, -1: there is none."""
    if P.sides.shape[0] == 2 and P.sides[1].count == 0:
        s.batch, s.count = P.cells.ctypes.data, P.sides[0].count
        return _feed(P, s, P.cells[0]) if s.count > 0 else -1
    _join(P, s)
    return _feed(P, s, P.merged) if s.count > 0 else -1


@kernel
def _receive_all(P: Any, s: Any) -> int:
    """Receive what the buses have, and put their stamps on the engine's time; returns a reason to leave, -1: none."""
    why, total = 0, 0
    for b in range(P.sides.shape[0] - 1):
        why = max(why, _receive(P, s, b, P.polls[b] >> 48 != 0))
        total += P.sides[b].count
    s.wall_ns = _read_clock(_REALTIME, s)
    if _was_set(s):
        return STEPPED
    if why > 0:
        return RAW if total > 0 or why == RAW else BUS
    for b in range(P.sides.shape[0] - 1):
        for k in range(P.sides[b].count):
            P.cells[b, k, 0] = np.uint64(np.int64(P.cells[b, k, 0]) - s.offset_ns)
    return -1


@kernel
def _begin(P: Any, s: Any) -> None:
    """Forget the report of the last time."""
    s.took = s.passes = s.count = s.start = s.knocked = 0
    for b in range(P.sides.shape[0]):
        side = P.sides[b]
        side.received = side.rejected = side.sent = 0


@kernel
def pass_handed(P: Any) -> int:
    """Pass frames that are handed in to the engine; returns a reason to leave, TIME: there is no other.

    Args:
        P: a :class:`Pumped`.
    """
    s = P.state[0]
    _begin(P, s)
    return max(_pass_on(P, s), TIME)


@kernel
def pump(P: Any) -> int:
    """Pass frames from the sockets to the engine until there is a reason to leave, which is returned.

    Args:
        P: a :class:`Pumped`.
    """
    s = P.state[0]
    _begin(P, s)
    s.wall_ns = _read_clock(_REALTIME, s)
    while True:
        now_ns = s.wall_ns - s.offset_ns
        s.count = s.start = 0
        if s.passes > 0 and now_ns >= min(s.leave_ns, s.prompt_ns):
            return TIME
        s.asked = 1 if _asks(P, s, now_ns) else 0
        if s.asked == 1:
            why = _wait(P, s, now_ns)
            if why >= 0:
                return why
            s.wall_ns = _read_clock(_REALTIME, s)
            s.asked_ns = s.wall_ns - s.offset_ns
        s.passes += 1
        s.gap_ns, s.read_ns = s.wall_ns - s.offset_ns - s.read_ns, s.wall_ns - s.offset_ns
        why = _receive_all(P, s)
        if why >= 0:
            return why
        why = _pass_on(P, s)
        while why == SENDING and _transmit(P, s):
            why = _run(P, s)
        if why >= 0:
            return why
        if s.knocked == 1:
            return DOOR
