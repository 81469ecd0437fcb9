"""Runs of passes: frames of a message that pass its checks, each with the results of the one before it.

Nearly every frame is one. Where the debounces of its tests stand at their passed ends, a result equal to the latest
changes nothing of them, and of the fault's bucket the count and the time only. So it is counted with the message, where
the frame is at work anyway, and the buckets get the whole run: before another result comes, and before they are read.
They are bit for bit as if they had got the results one by one.

A checksum is no part of it: its value is another with each frame.
"""

from __future__ import annotations

from typing import Any

from gateway.engine.buckets import note_alike
from gateway.engine.checks.kinds import COUNTER, CRC, EARLY, RULE
from gateway.engine.debounce import is_settled
from gateway.engine.gate import is_lasting
from gateway_fdi.jit import kernel


@kernel
def begin_run(T: Any, c: Any, length: int) -> None:
    """See whether a run may begin, after a frame of that length [byte] has passed all checks of its message."""
    c.steady = 0
    if c.presence >= 0 or c.protection.windowed == 1 or c.odd > 0 or c.twice > 0 or c.protection.secured == 1:
        return
    for kind in range(EARLY):  # a window is reported by itself
        if kind not in (CRC, RULE) and c.fault[kind] >= 0:
            d = T.debounces[c.fault[kind]]
            if not is_settled(d) or (d.gated == 1 and not is_lasting(T, d)):
                return
    c.gate_changes = T.clock[0].gate_changes
    c.usual_length = length
    c.counted = c.fault[COUNTER] >= 0
    if c.counted == 1:
        step = T.debounces[c.fault[COUNTER]].value
        if step > c.protection.max_step:
            return  # it passed because frames before it had been rejected: of the next frame it would be a loss
        c.usual_step = step
    c.summed = c.fault[CRC] >= 0
    c.steady = 1


@kernel
def go_on(T: Any, t_ns: int, c: Any) -> None:
    """Take a further frame into a run."""
    c.run_until_ns = t_ns + T.clock[0].offset_ns
    if c.run == 0:
        c.run_since_ns = c.run_until_ns
    c.run += 1


@kernel
def count_run(c: Any, debounces: Any, buckets: Any) -> None:
    """Tell the buckets of a message's run; its next frame begins another one."""
    if c.run == 0:
        return
    for kind in range(EARLY):
        fault = c.fault[kind]
        if fault >= 0 and kind not in (CRC, RULE):
            d = debounces[fault]
            note_alike(buckets, c.run_since_ns, c.run_until_ns, fault, c.run, False, d.value, d.limit)
    c.run = 0


@kernel
def count_all_runs(checks: Any, debounces: Any, buckets: Any) -> None:
    """Tell the buckets of the runs of all messages."""
    for k in range(checks.shape[0]):
        count_run(checks[k], debounces, buckets)
