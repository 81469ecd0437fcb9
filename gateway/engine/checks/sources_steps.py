"""Source addresses of a J1939 message: the frames of one are used, the others are watched for their silence.

Frames of several sources in one mailbox would look like jumps of its signals and of its alive counter. So a message has
the frames of one source, the first that came; the signals of another one are tested under its exact name.
"""

from __future__ import annotations

from typing import Any

from gateway.engine.checks.communication_steps import end_run
from gateway.engine.checks.kinds import TIMEOUT
from gateway.engine.events import SOURCE
from gateway.engine.gate import sleeps
from gateway.engine.results import announce, report_result, store_evidence
from gateway_fdi.jit import kernel


@kernel(inlined=False)
def is_used(T: Any, t_ns: int, row: int, address: int) -> bool:
    """Return whether the frames of a source address are those that are used; takes note of the others.

    Args:
        T: the tables.
        t_ns: time of the frame.
        row: of the message.
        address: that sent it.
    """
    v = T.vectors[row]
    if v.source < 0:
        v.source = address
    if v.source != address:
        T.clock[0].other_sources += 1
        note_other(T, t_ns, row, address)
    if v.others > 0 and v.check >= 0:
        c = T.checks[v.check]
        if t_ns - v.heard_ns > c.timeout_ns:  # nobody was heard: all have their time again
            for k in range(T.others.shape[0]):
                if T.others[k].row == row and T.others[k].silent == 0 and T.others[k].last_ns > 0:
                    T.others[k].last_ns = t_ns
        watch_others(T, t_ns, c)
    v.heard_ns = t_ns
    return bool(v.source == address)


@kernel
def note_other(T: Any, t_ns: int, row: int, address: int) -> None:
    """Take a frame of another source; one that is new is told, if there is room for it."""
    v = T.vectors[row]
    for k in range(T.others.shape[0]):
        o = T.others[k]
        if o.last_ns == 0:
            o.row, o.address = row, address
            v.others += 1
            announce(T, t_ns, SOURCE, row, T.messages[row].bus, float(address), 0.0)
        if o.row == row and o.address == address:
            o.last_ns = max(t_ns, 1)
            if o.silent == 1 and v.check >= 0:
                T.checks[v.check].silent_sources = max(T.checks[v.check].silent_sources - 1, 0)
            o.silent = 0
            return


@kernel(inlined=False)
def watch_others(T: Any, t_ns: int, c: Any) -> None:
    """Report the silence of other sources of a message, once each: its timeout fails as long as one is silent."""
    if c.timeout_ns <= 0 or sleeps(T, T.debounces[c.fault[TIMEOUT]]):
        return
    for k in range(T.others.shape[0]):
        o = T.others[k]
        if o.last_ns == 0:
            return
        if o.row != c.row or o.silent == 1 or t_ns - o.last_ns <= c.timeout_ns:
            continue
        o.silent = 1
        end_run(T, c)
        c.silent_sources += 1
        silent_ms = (t_ns - o.last_ns) * 1e-6
        announce(T, t_ns, SOURCE, c.row, c.bus, float(o.address), silent_ms)
        place = report_result(T, t_ns, c.fault[TIMEOUT], True, silent_ms, c.timeout_ns * 1e-6)
        store_evidence(T, c.fault[TIMEOUT], place, 0, silent_ms)
        store_evidence(T, c.fault[TIMEOUT], place, 1, float(o.address))
