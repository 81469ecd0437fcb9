"""The engine's tables: what the jitted loop reads and writes, as NumPy record arrays."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gateway.engine.debounce import NEVER
from gateway.jit import COMPILED, f8, i4, i8, record, u1
from gateway.monitors.shape import EVIDENCE

__all__ = [
    "CLOCK",
    "HANDLER",
    "MOST_REPORTS",
    "NEVER",
    "REPORT",
    "VECTOR",
    "Tables",
    "table",
]

#: One row of the vector table, for each message of the decode plan: the monitors it triggers
#: (``handlers[first:first + count]``, by priority), its communication check (-1: none), the operation
#: cycles it may begin or end (``watches[first_watch:+watches]``), and when its data were last accepted
#: [ns, -1: never].
VECTOR = record(first=i4, count=i4, check=i4, first_watch=i4, watches=i4, arrived_ns=i8)

#: One configured monitor: addresses of its kernel and records, its inputs
#: (``slots[first_slot:+slots]`` to ``pool[inputs:]``, in 8-byte cells), the messages its inputs
#: come from (``sources[first_source:+sources]``), its faults, the message it
#: sends (-1: none), and when it wants to be woken.
HANDLER = record(
    entry=i8,
    state=i8,
    const=i8,
    inputs_address=i8,
    inputs=i4,
    first_slot=i4,
    slots=i4,
    first_source=i4,
    sources=i4,
    fault=i4,
    faults=i4,
    emit=i4,
    bus=u1,
    tested=u1,
    wake_ns=i8,
    steps=i8,
    skipped=i8,
)

#: A test result that is none of a monitor's: of the gateway itself (see Engine.report).
REPORT = record(fault=i4, failed=u1, value=f8, limit=f8, evidence=(f8, EVIDENCE))
#: So many of them wait at most.
MOST_REPORTS = 16

#: Clock and counters. ``deadline_ns`` is a lower bound of every timer's deadline; ``timed`` tells whether a
#: fault is debounced by time, ``held`` whether test results count at present; ``reported`` of the results in ``reports``
#: wait. ``offset_ns`` is what the wall clock is ahead of the engine's: it changes where the wall clock is set
#: (``clock_steps`` times), so that ``now_ns`` goes on evenly. Of the outbox's ``sent`` frames the first ``fed`` went
#: through the engine themselves, the first ``taken`` have left.
CLOCK = record(
    now_ns=i8,
    offset_ns=i8,
    deadline_ns=i8,
    started=u1,
    stop=u1,
    timed=u1,
    held=u1,
    reported=i8,
    events=i8,
    events_lost=i8,
    frames=i8,
    decoded=i8,
    unknown=i8,
    remote=i8,
    error=i8,
    late=i8,
    clock_steps=i8,
    too_short=i8,
    unknown_mux=i8,
    invalid_values=i8,
    crc_failed=i8,
    repeated=i8,
    timeouts=i8,
    results_lost=i8,
    sent=i8,
    fed=i8,
    taken=i8,
    sent_lost=i8,
)


class Tables(NamedTuple):
    """All arrays of the loop, in one argument.

    Decode plan: ``keys``, ``rows``, ``messages``, ``signals``, ``mux_ids`` (see signals.tables).
    Scratch: ``values`` float64 and ``present`` uint8, shape (most signals of a message,).
    Outbox: ``emits``, ``emit_signals``, ``outbox`` and the same memory in cells (see engine.emission).
    Gates: ``conditions`` and ``roots`` of the debounces; ``watches`` and the state of the ``cycles`` (see
    engine.gate).
    Health: a row for each bus, and one for the gateway itself (see monitors.bus_health).
    Reports: results of the gateway itself, of which the clock knows how many wait.
    State: ``mailbox`` float64 (slots,), ``pool`` float64 and ``pool_ns`` int64 views of the inputs.
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
    triggers: NDArray[np.int32]
    handlers: NDArray[np.void]
    slots: NDArray[np.int32]
    sources: NDArray[np.int32]
    pool: NDArray[np.float64]
    pool_ns: NDArray[np.int64]
    checks: NDArray[np.void]
    crc_tables: NDArray[np.uint8]
    debounces: NDArray[np.void]
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
    clock: NDArray[np.void]


def table(count: int, dtype: np.dtype[np.void]) -> Any:
    """Return zeroed records that kernels can address by attribute, compiled or not."""
    array = np.zeros(count, dtype)
    return array if COMPILED else array.view(np.recarray)
