"""Health of the gateway's own monitoring: whether test results count at present.

No kernel: that somebody has switched monitoring off (0x85, 0x28, the status socket) is the test result. The fault is
there for as long as that lasts, so that whoever reads DTCs meanwhile sees why there are no others.
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
