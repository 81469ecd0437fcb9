"""Health of the gateway's own process: whether it has died again and again.

No kernel: starts that find the fault memory of a process that was not stopped are the test result.
"""

from __future__ import annotations

from gateway.monitors.contract import Debounce, Fault

#: U3000: control module (SAE J2012). Failure type 47: watchdog or safety controller failure: what resets a module.
RESTARTED = Fault(
    "restarted",
    "U3000-47",
    "the gateway ended again and again without a stop; it did not monitor in between",
    ("restarts of all",),
    Debounce(failed_after=1, passed_after=1, jump_up=True, jump_down=True),
    "The log of the service manager (journalctl) says what ended it, the event restart since when: tell us that."
    " It heals when it has run for ten minutes, or after a stop.",
)
FAULTS = (RESTARTED,)
