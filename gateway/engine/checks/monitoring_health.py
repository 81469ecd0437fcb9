"""Health of the gateway's own monitoring: whether test results count at present.

No kernel: monitoring that is switched off (0x85, 0x28, the status socket) is the test result. The fault lasts as long
as that, so that a reader of DTCs sees why there are no others.
"""

from __future__ import annotations

from gateway.monitors.contract import Debounce, Fault

#: U3000: control module (SAE J2012). Failure type 53: deactivated.
MONITORING_OFF = Fault(
    "monitoring_off",
    "U3000-53",
    "monitoring is switched off; no test result counts",
    ("test results off", "reception off"),
    Debounce(failed_after=1, passed_after=1, jump_up=True, jump_down=True),
)
FAULTS = (MONITORING_OFF,)
