"""Health of the monitors themselves: whether one had to be switched off.

No kernel: the loop says whose step failed, a file beside the fault memory whose step did not return.
"""

from __future__ import annotations

from gateway.monitors.contract import Debounce, Fault

#: U3000: control module (SAE J2012). Failure type 48: supervision software failure.
SWITCHED_OFF = Fault(
    "monitor_off",
    "U3000-48",
    "a monitor failed and is switched off; its faults are not tested",
    ("monitors switched off",),
    Debounce(failed_after=1, passed_after=1, jump_up=True, jump_down=True),
    "The log and the event monitor_off name the monitor, its file and what it did: tell its author. gateway check"
    " tries its kernel; another version of it is switched on again at the next start.",
)
FAULTS = (SWITCHED_OFF,)
