"""Events: Python's view of the engine's work."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gateway.monitors.contract import EVIDENCE
from gateway_fdi.jit import f8, i1, i4, i8, record, u1

#: Debounce qualified a failure: the fault detection counter arrived at +127.
QUALIFIED_FAILED = 1
#: Debounce qualified a pass: the fault detection counter arrived at -128.
QUALIFIED_PASSED = 2
#: A test result differs from the last one of the same fault; not qualified yet.
RESULT_CHANGED = 3
#: The fault detection counter rose to the value at which the fault's freeze frame is wanted.
FDC_REACHED = 4
#: An operation cycle began, or ended; ``fault`` is the index of the cycle.
CYCLE_BEGAN, CYCLE_ENDED = 5, 6
#: The wall clock was set; ``value`` is by how much [s].
CLOCK_STEPPED = 7

#: A step of a monitor failed, which is switched off; ``fault`` is the index of the monitor.
MONITOR_OFF = 8
#: Why a monitor is off that changed the number of its results itself, as the handlers have it; no status of a kernel.
MISCOUNTED = 4094

#: An identifier that nobody knows has come, once or ten times as often as when it was told last; ``fault`` is its place
#: among the strangers.
STRANGER = 9

#: The first frame that is shorter than its message has come; ``fault`` is the row of the message, ``value`` the length
#: of the frame, ``threshold`` that from which on it has all signals [byte].
SHORT = 10

#: Another source address (``value``) sends a J1939 message, or has been silent for longer than its timeout; ``fault``
#: is the row of the message, ``threshold`` its silence, or 0 [ms].
SOURCE = 11

#: A bus does something else as a whole: ``value`` is what, a place of ``bus_health.ACTIVITIES``, ``threshold`` what
#: before.
ACTIVITY = 12

#: Frames of a bus get lost, or no more: ``value`` is their share, ``threshold`` that from which on it is told.
LOSSY = 13

#: A message of a bus that sleeps never was as its check says since it came: ``fault`` is its row, ``result`` the kind
#: of the check (``kinds.KINDS``), ``value`` what it is now, ``threshold`` the limit of the check.
OTHER = 14

#: Slips of a monitor's author that the loop puts right, as bits of ``slips`` of its handler.
NO_NUMBER, NO_FAULT, TOO_MANY, TOO_SOON = 1, 2, 4, 8

#: Bus of what is of no bus: the gateway's own faults.
NO_BUS = 255

#: One event. ``t_ns`` is of the wall clock, as all stamps for people, ``fault`` the index in the engine's list of
#: faults, ``result`` one of NOT_TESTED,
#: PASSED, FAILED, ``fdc`` the fault detection counter, ``evidence`` named by the fault's definition.
EVENT = record(
    t_ns=i8,
    fault=i4,
    kind=u1,
    result=u1,
    fdc=i1,
    bus=u1,
    value=f8,
    threshold=f8,
    evidence=(f8, EVIDENCE),
)

#: Shape ``(n,)`` of :data:`EVENT`.
Events = NDArray[np.void]


class Event(NamedTuple):
    """A row of :data:`EVENT` in Python's numbers; to reach a field of the row itself takes ten times as long."""

    t_ns: int
    fault: int
    kind: int
    result: int
    fdc: int
    bus: int
    value: float
    threshold: float
    evidence: NDArray[np.float64]


def each(events: Events) -> list[Event]:
    """Return events one by one; their evidence is valid as long as the array is."""
    return [Event(*row) for row in events.tolist()]
