"""The engine's tables: the data of the jitted loop, as NumPy record arrays."""

from __future__ import annotations

from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gateway.common.times import NEVER
from gateway.monitors.contract import EVIDENCE
from gateway_fdi.jit import COMPILED, LINE, Record, f8, f8s, i4, i8, means, u1

__all__ = [
    "MOST_REPORTS",
    "NEVER",
    "Clock",
    "Handler",
    "Page",
    "Report",
    "Tables",
    "Vector",
    "table",
]

#: Test results of the gateway itself and of other processes that wait at most (see Engine.report).
MOST_REPORTS = 16
#: Further source addresses of J1939 messages that are watched at most.
MOST_SOURCES = 256


class VectorPlace(Record):
    """Effects of each message of the decode plan."""

    first: i4 = means("of the monitors that it triggers, handlers[first:first + count], by priority")
    count: i4 = means("how many these are")
    check: i4 = means("its communication check; -1: none")
    first_watch: i4 = means("of the operation cycles that it may begin or end")
    watches: i4 = means("how many these are")
    page: i4 = means("first of its pages; -1: none")
    by_group: u1 = means("1: of J1939, frames of each source address match it")


class VectorState(Record):
    """State of the message."""

    arrived_ns: i8 = means("when its data were last accepted; -1: never", "ns")
    source: i4 = means("of J1939: source address whose frames are used, the first that came; -1: none yet")
    others: i4 = means("of J1939: further source addresses that have sent it")
    heard_ns: i8 = means("of J1939: the last frame of any source", "ns")
    lacks: u1 = means("1: signals that are asked for are beyond the end of the last frame")
    told_short: u1 = means("1: it was told that its frames do not have all signals")


class Vector(VectorState, VectorPlace):
    """One row of the vector table."""


class Source(Record):
    """A further source address of a J1939 message, whose frames are not those that are used."""

    row: i4 = means("of its message")
    address: u1 = means("source address")
    silent: u1 = means("1: its silence was told")
    last_ns: i8 = means("its last frame", "ns")


class PagePlace(Record):
    """A multiplexed signal that a monitor waits for: frames of its message come without it, too."""

    place: i4 = means("among the signals of its message")
    after: i4 = means("the next page of its message; -1: none")
    slot: i4 = means("mailbox slot of the signal")


class PageState(Record):
    """Whether it has come."""

    came: u1 = means("since its message is there")


class Page(PageState, PagePlace):
    """One multiplexed signal."""


class HandlerPlace(Record):
    """One configured monitor: addresses of its kernel and records, and its places in other tables."""

    entry: i8 = means("address of its kernel")
    state: i8 = means("address of its state")
    const: i8 = means("address of its constants")
    inputs_address: i8 = means("address of its inputs")
    inputs: i4 = means("first of its cells in the pool")
    cells: i4 = means("first of those that are connected")
    first_sampled: i4 = means("sampled[first_sampled:+sampled]: messages that make samples; none: each frame steps it")
    sampled: i4 = means("how many these are")
    samplings: i4 = means("how many different ones these are of")
    first_loose: i4 = means("carried[first_loose:+loose]: inputs of no sample, whose newest value is taken")
    loose: i4 = means("how many these are")
    first_slot: i4 = means("slots[first_slot:+slots] go to its inputs")
    slots: i4 = means("how many these are")
    first_source: i4 = means("sources[first_source:+sources]: what its inputs come from; a message, or -1 - a page")
    sources: i4 = means("how many these are")
    fault: i4 = means("the engine's index of its first fault")
    faults: i4 = means("its faults")
    emit: i4 = means("the message that it sends; -1: none")
    timer: i4 = means("that wakes it")
    bus: u1 = means("number of the bus")
    ticks: u1 = means("1: it samples at the ticks of a clock, which wake it")
    takes_nan: u1 = means("1: it steps with a message whose values are not valid; they are NaN")


class HandlerState(Record):
    """Its counts, and when it wants to be woken."""

    tested: u1 = means("1: its faults were tested last")
    slips: u1 = means("slips of its author that were put right, as bits: NO_NUMBER, ...")
    off: i8 = means("why it is stepped no more, as call_entry tells it; 0: it is stepped")
    wake_ns: i8 = means(unit="ns")
    steps: i8 = means("times that it was stepped")
    skipped: i8 = means("times that it was not")


class Handler(HandlerState, HandlerPlace):
    """One configured monitor."""


class Report(Record):
    """A test result that is none of a monitor's: of the gateway itself, or of another process."""

    fault: i4 = means("the engine's index of the fault")
    result: u1 = means("PASSED, FAILED or NOT_TESTED")
    at_once: u1 = means("whether it qualifies at once, without debounce")
    value: f8 = means("what was tested")
    limit: f8 = means("what it was tested against")
    evidence: Annotated[f8s, EVIDENCE] = means("evidence of the result")


class ClockPass(Record):
    """Data of one pass of the loop; frames are those of the outbox, in its order."""

    stop: u1 = means("1: the pass ends here")
    held: u1 = means("whether test results do not count at present")
    heeds: u1 = means("1: the pass ends with each verdict; 0: not with a first pass of a fault that was not there")
    parts: u1 = means("frames of a woven message that have come")
    reported: i8 = means("results of the gateway itself that wait")
    gate_changes: i8 = means("what gates ask for, but for signals: cycles that began or ended, failed results of roots")
    stepping: i8 = means("timer of the monitor that is being stepped, and one; 0: none is")
    events: i8 = means("events of this pass")
    urgent: i8 = means("1: there are other events in this pass than first passes, or there is room for few more")
    sent: i8 = means("frames sent")
    fed: i8 = means("first of these that went through the engine themselves")
    taken: i8 = means("first of these that have left")


class ClockState(Record):
    """Time and counters."""

    now_ns: i8 = means(unit="ns")
    offset_ns: i8 = means("what the wall clock is ahead of the engine's", "ns")
    deadline_ns: i8 = means("lower bound of every timer's deadline", "ns")
    started: u1 = means("1: there is a time")
    events_lost: i8 = means("events that there was no room for")
    frames: i8 = means("frames taken")
    decoded: i8 = means("frames of known messages that were decoded")
    unknown: i8 = means("frames of unknown identifiers")
    remote: i8 = means("remote frames")
    error: i8 = means("error frames, and conditions")
    late: i8 = means("frames older than the one before")
    clock_steps: i8 = means("how often the wall clock was set")
    too_short: i8 = means("frames shorter than their message")
    unknown_mux: i8 = means("frames whose multiplexer has a value that selects nothing")
    invalid_values: i8 = means("frames with a value that is none")
    crc_failed: i8 = means("frames whose checksum is wrong")
    repeated: i8 = means("frames whose alive counter stands still")
    missed: i8 = means("frames that alive counters miss while those of other messages are missing, too")
    wrong_sequence: i8 = means("frames of E2E out of sequence, not used")
    doubtful: i8 = means("frames not used because another sender is among them")
    window_rejected: i8 = means("right frames of E2E not used, too few of the last ones were right")
    unsynchronised: i8 = means("frames of SecOC not used, their freshness not known yet")
    timeouts: i8 = means("messages that stayed away")
    results_lost: i8 = means("results that there was no room for")
    results_unknown: i8 = means("results of a fault that the monitor does not have")
    results_no_number: i8 = means("results whose value or threshold is no number: not tested")
    wakes_moved: i8 = means("wishes to be woken too early, which were put off")
    other_sources: i8 = means("frames of J1939 of further source addresses, not used")
    sent_lost: i8 = means("messages of monitors that there was no room for")


class Clock(ClockState, ClockPass):
    """Clock and counters."""


class Tables(NamedTuple):
    """All arrays of the loop, in one argument.

    Decode plan: ``keys``, ``rows``, ``messages``, ``signals``, ``mux_ids`` (see signals.tables).
    Scratch: ``values`` float64 and ``present`` uint8, shape (most signals of a message,).
    Outbox: ``emits``, ``emit_signals``, ``outbox`` and the same memory in cells (see engine.emission).
    Gates: ``conditions`` and ``roots`` of the debounces; ``watches`` and the state of the ``cycles`` (see
    engine.gate).
    Health: a row for each bus, and one for the gateway itself (see monitors.bus_health).
    Timers: a row for each, ``groups`` of them with their ``members``, and the ``heap`` of what is noted of these (see
    engine.timers).
    Buckets: a row for each fault, its results since the last look (see engine.buckets).
    Reports: results of the gateway itself, of which the clock knows how many wait.
    Strangers: ``known_keys`` and ``known_rows``, what the buses know, and a row for each unknown identifier.
    Woven: a message of several frames, cells as a frame has them (see loop.join_woven).
    State: ``mailbox`` float64 (slots,), ``pool`` float64 and ``pool_ns`` int64 views of the inputs.
    Samples: ``samplers`` of the monitors that step once a sample, the messages that are ``sampled``, the inputs that
    these have ``carried``; ``held``: the parts that have come of unfinished samples.
    """

    keys: NDArray[np.uint64]
    rows: NDArray[np.int32]
    messages: NDArray[np.void]
    signals: NDArray[np.void]
    mux_ids: NDArray[np.int64]
    values: NDArray[np.float64]
    present: NDArray[np.uint8]
    mailbox: NDArray[np.float64]
    vectors: NDArray[np.void]
    pages: NDArray[np.void]
    triggers: NDArray[np.int32]
    handlers: NDArray[np.void]
    slots: NDArray[np.int32]
    carried: NDArray[np.int32]
    sources: NDArray[np.int32]
    samplers: NDArray[np.void]
    sampled: NDArray[np.void]
    held: NDArray[np.float64]
    pool: NDArray[np.float64]
    pool_ns: NDArray[np.int64]
    checks: NDArray[np.void]
    crc_tables: NDArray[np.uint64]
    debounces: NDArray[np.void]
    buckets: NDArray[np.void]
    conditions: NDArray[np.void]
    roots: NDArray[np.int32]
    watches: NDArray[np.void]
    cycles: NDArray[np.uint8]
    out: NDArray[np.void]
    out_address: NDArray[np.int64]
    emits: NDArray[np.void]
    emit_signals: NDArray[np.void]
    outbox: NDArray[np.void]
    outbox_cells: NDArray[np.uint64]
    ring: NDArray[np.void]
    health: NDArray[np.void]
    reports: NDArray[np.void]
    timers: NDArray[np.void]
    groups: NDArray[np.void]
    members: NDArray[np.int32]
    heap: NDArray[np.void]
    known_keys: NDArray[np.uint64]
    known_rows: NDArray[np.int32]
    strangers: NDArray[np.void]
    others: NDArray[np.void]
    woven: NDArray[np.uint64]
    clock: NDArray[np.void]


def table(count: int, kind: type[Record] | np.dtype[np.void]) -> Any:
    """Return zeroed records that kernels can address by attribute, compiled or not; they begin a line of the cache."""
    dtype = np.dtype(kind)
    room = np.zeros(count * dtype.itemsize + LINE, np.uint8)
    first = -int(room.ctypes.data) % LINE
    array = room[first : first + count * dtype.itemsize].view(dtype)
    return array if COMPILED else array.view(np.recarray)
