"""Health of the gateway's doors: whether what comes from outside makes its handling fail again and again.

No kernel: the exceptions that the walls catch (:mod:`gateway.common.fence`) are the test results.
"""

from __future__ import annotations

from gateway.monitors.contract import Debounce, Fault

#: This number of exceptions within this time is a fault, which heals when there was none for as long [ns].
REPEATED, WINDOW_NS = 3, 60_000_000_000
#: U3000: control module (SAE J2012). Failure type 81: invalid serial data received.
EXCEPTIONS = Fault(
    "exceptions",
    "U3000-81",
    "what comes from outside makes its handling fail again and again; each time its sender is closed",
    ("exceptions", "of these at the second wall"),
    Debounce(failed_after=1, passed_after=1, jump_up=True, jump_down=True),
    "The log and the event security (kind exception) name the door, the sender, the exception and its place: tell the"
    " gateway's authors, and keep that sender away.",
)
FAULTS = (EXCEPTIONS,)
