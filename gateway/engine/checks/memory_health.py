"""Health of the gateway's own fault memory: whether it can be written, and whether its file is whole.

No kernel: the store's own errors are the test results. A file that has been put aside is a fault until the next
operation cycle finds the new one whole; one that cannot be written, until all that waits is written.
"""

from __future__ import annotations

from gateway.monitors.contract import Debounce, Fault

#: First part of the ids of the gateway's own faults.
OWNER = "gateway"

_AT_ONCE = Debounce(failed_after=1, passed_after=1, jump_up=True, jump_down=True)

#: U3000: control module (SAE J2012). Failure types 44: data memory, 42: general memory failure.
NOT_WRITTEN = Fault(
    "memory_not_written",
    "U3000-44",
    "fault memory cannot be written; faults are reported, but not stored",
    ("changes waiting",),
    _AT_ONCE,
)
DAMAGED = Fault(
    "memory_damaged",
    "U3000-42",
    "fault memory's file was damaged, deleted, replaced or overwritten; a new one was begun",
    ("rows recovered", "rows lost"),
    _AT_ONCE,
)
FAULTS = (NOT_WRITTEN, DAMAGED)
#: Least important number first: they say how far the others can be trusted.
PRIORITY = 10
