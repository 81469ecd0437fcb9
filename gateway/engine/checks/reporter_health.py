"""Health of those that report test results from other processes: whether one is gone.

No kernel: that a reporter's connection ended without a goodbye, or that it did not report in time, is the test result.
"""

from __future__ import annotations

from gateway.monitors.contract import Debounce, Fault

#: U3000: control module (SAE J2012). Failure type 93: no operation.
REPORTER_LOST = Fault(
    "reporter_lost",
    "U3000-93",
    "a process that reports test results is gone; its faults are not tested",
    ("reporters lost",),
    Debounce(failed_after=1, passed_after=1, jump_up=True, jump_down=True),
    "The log and the event reporter name it and say how it ended: start it again. It heals with its next report.",
)
FAULTS = (REPORTER_LOST,)
