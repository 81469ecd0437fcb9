"""Health of the gateway itself: memory, process, monitoring, monitors, reporters, doors. DTC U3000: control module.

No kernel: what the gateway does, and what happens to it, is the test result. Failure types are of SAE J2012.
"""

from __future__ import annotations

from gateway.monitors.contract import Debounce, Fault

#: First part of the ids of the gateway's own faults.
OWNER = "gateway"
#: Least important number first: they say how far the others can be trusted.
PRIORITY = 10
#: This number of exceptions within this time is a fault, which heals when there was none for as long [ns].
REPEATED, WINDOW_NS = 3, 60_000_000_000


def _fault(name: str, failure_type: str, text: str, evidence: tuple[str, ...], remedy: str = "") -> Fault:
    debounce = Debounce(failed_after=1, passed_after=1, jump_up=True, jump_down=True)
    return Fault(name, f"U3000-{failure_type}", text, evidence, debounce, remedy)


#: 44: data memory. It stands until all that waits is written.
NOT_WRITTEN = _fault(
    "memory_not_written",
    "44",
    "fault memory cannot be written; faults are reported, but not stored",
    ("changes waiting",),
)
#: 42: general memory failure. It stands until the next operation cycle finds the new file whole.
DAMAGED = _fault(
    "memory_damaged",
    "42",
    "fault memory's file was damaged, deleted, replaced or overwritten; a new one was begun",
    ("rows recovered", "rows lost"),
)
#: 47: watchdog or safety controller failure: what resets a module.
RESTARTED = _fault(
    "restarted",
    "47",
    "the gateway ended again and again without a stop; it did not monitor in between",
    ("restarts of all",),
    "The log of the service manager (journalctl) says what ended it, the event restart since when: tell us that."
    " It heals when it has run for ten minutes, or after a stop.",
)
#: 53: deactivated. It stands as long as monitoring is off (0x85, 0x28, the status socket), so that a reader of DTCs
#: sees why there are no others.
MONITORING_OFF = _fault(
    "monitoring_off",
    "53",
    "monitoring is switched off; no test result counts",
    ("test results off", "reception off"),
)
#: 48: supervision software failure. The loop says whose step failed, a file beside the memory whose did not return.
SWITCHED_OFF = _fault(
    "monitor_off",
    "48",
    "a monitor failed and is switched off; its faults are not tested",
    ("monitors switched off",),
    "The log and the event monitor_off name the monitor, its file and what it did: tell its author. gateway check"
    " tries its kernel; another version of it is switched on again at the next start.",
)
#: 93: no operation. Its connection ended without a goodbye, or it did not report in time.
REPORTER_LOST = _fault(
    "reporter_lost",
    "93",
    "a process that reports test results is gone; its faults are not tested",
    ("reporters lost",),
    "The log and the event reporter name it and say how it ended: start it again. It heals with its next report.",
)
#: 81: invalid serial data received. The walls catch these exceptions (:mod:`gateway.common.fence`).
EXCEPTIONS = _fault(
    "exceptions",
    "81",
    "what comes from outside makes its handling fail again and again; each time its sender is closed",
    ("exceptions", "of these at the second wall"),
    "The log and the event security (kind exception) name the door, the sender, the exception and its place: tell the"
    " gateway's authors, and keep that sender away.",
)
#: All of them, in the order of a catalogue.
FAULTS = (NOT_WRITTEN, DAMAGED, RESTARTED, MONITORING_OFF, SWITCHED_OFF, REPORTER_LOST, EXCEPTIONS)
