"""DTC frames made where a verdict is made: Python has prepared one for the next verdict of each fault.

It is known before how the next verdict changes a DTC (see :meth:`gateway.faults.memory.FaultMemory.foresee`). So a pump
can send the frame at once, without waiting for Python, which then does all that belongs to the verdict, finds that the
frame has gone, and does not send it again.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from cantools.database.can import Message
from numpy.typing import NDArray

from gateway.bus.frames import EXTENDED, FRAME
from gateway.engine.events import FDC_REACHED, QUALIFIED_FAILED, QUALIFIED_PASSED, RESULT_CHANGED
from gateway.faults.entries import UNKNOWN, UNTOLD
from gateway.signals.columns import insert
from gateway.signals.decode import SIGNAL
from gateway.signals.tables import encode_rows
from gateway_fdi.jit import COMPILED, Record, i8, kernel, means

#: Signals of the message, in the order in which frames are made of them.
SIGNALS = ("Dtc", "Status", "FaultDetectionCounter", "Index", "Count", "Occurrence")
#: DTCs of one frame's verdicts that are told here; of more Python tells.
MOST = 8
_CELLS = FRAME.itemsize // 8


class Next(Record):
    """A fault's DTC after its next verdict."""

    dtc: i8 = means("its code")
    failed: i8 = means("status byte after a failure; UNKNOWN, UNTOLD")
    passed: i8 = means("status byte after a pass; UNKNOWN, UNTOLD")
    failed_occurrence: i8 = means("failures after a failure")
    passed_occurrence: i8 = means("failures after a pass")
    failed_adds: i8 = means("by how many a failure lengthens the list")
    passed_adds: i8 = means("by how many a pass lengthens the list")
    from_ns: i8 = means("engine's time from which on it may be told again", "ns")


class Head(Record):
    """The message, and the list of DTCs as it is now."""

    can_id: i8 = means("identifier")
    bus: i8 = means("number of the bus")
    length: i8 = means("bytes of the frame", "byte")
    count: i8 = means("DTCs in the list")


class Made(Record):
    """A DTC frame that was made of a verdict."""

    event: i8 = means("place of the verdict among the events")
    fault: i8 = means("its fault")
    status: i8 = means("status byte after it")
    occurrence: i8 = means("failures after it")
    number: i8 = means("of the verdict in the journal that sends the frame; 0: it was sent at once")


class PreparedTables(NamedTuple):
    """Tables: ``following`` has a :class:`Next` a fault, ``head`` one row, ``signals`` those of the message.

    ``made`` and ``frames`` take what is made at a verdict, the frames in cells, shapes (MOST,) and (MOST, 10).
    """

    following: NDArray[np.void]
    head: NDArray[np.void]
    signals: NDArray[np.void]
    made: NDArray[np.void]
    frames: NDArray[np.uint64]


def _table(values: NDArray[np.void]) -> NDArray[np.void]:
    return values if COMPILED else values.view(np.recarray)


def prepared_tables(message: Message | None, bus: int, faults: int) -> PreparedTables:
    """Return the tables of a message (None: there is none) on a bus; of no fault anything is known."""
    following, head = np.zeros(max(faults, 1), Next.dtype), np.zeros(1, Head.dtype)
    following["failed"] = following["passed"] = UNKNOWN
    signals = np.zeros(len(SIGNALS), SIGNAL)
    if message is not None:
        head["can_id"] = message.frame_id | (EXTENDED if message.is_extended_frame else 0)
        head["bus"], head["length"] = bus, message.length
        signals = np.asarray(encode_rows(message, SIGNALS), SIGNAL)
    frames = np.zeros((MOST, _CELLS), np.uint64)
    made = _table(np.zeros(MOST, Made.dtype))
    return PreparedTables(_table(following), _table(head), _table(signals), made, frames)


@kernel
def put_report(
    F: Any, into: Any, t_ns: int, dtc: int, status: int, fdc: int, index: int, count: int, occurrence: int
) -> None:
    """Make one DTC frame; values beyond their signals become the nearest.

    Args:
        F: a :class:`PreparedTables`.
        into: its cells, shape (10,).
        t_ns: when [ns].
        dtc: its code.
        status: status byte.
        fdc: fault detection counter.
        index: place in the list, from 1; 0: it has changed.
        count: DTCs in the list.
        occurrence: failures.
    """
    head = F.head[0]
    into[0] = np.uint64(t_ns)
    into[1] = np.uint64(head.can_id) | np.uint64(head.bus) << np.uint64(32) | np.uint64(head.length) << np.uint64(48)
    for k in range(2, into.shape[0]):
        into[k] = np.uint64(0)
    words = into[2:]
    insert(words, F.signals[0], float(dtc))
    insert(words, F.signals[1], float(status))
    insert(words, F.signals[2], float(fdc))
    insert(words, F.signals[3], float(index))
    insert(words, F.signals[4], float(count))
    insert(words, F.signals[5], float(occurrence))


@kernel
def _verdicts(F: Any, events: Any, count: int, now_ns: int) -> int:
    """Note the events whose verdicts change a DTC; returns how many, 0 also where only Python can tell."""
    told = 0
    for k in range(count):
        e = events[k]
        if e.kind in (RESULT_CHANGED, FDC_REACHED):
            continue
        if e.kind not in (QUALIFIED_FAILED, QUALIFIED_PASSED):
            return 0
        for j in range(told):
            if F.made[j].fault == e.fault:
                return 0  # it is foreseen one verdict ahead only
        following = F.following[e.fault]
        status, occurrence = following.failed, following.failed_occurrence
        if e.kind == QUALIFIED_PASSED:
            status, occurrence = following.passed, following.passed_occurrence
        if status == UNTOLD:
            continue
        if status == UNKNOWN or now_ns < following.from_ns or told == MOST:
            return 0
        made = F.made[told]
        made.event, made.fault, made.status, made.occurrence, made.number = k, e.fault, status, occurrence, 0
        told += 1
    return told


@kernel
def prepare_next(F: Any, events: Any, count: int, now_ns: int) -> int:
    """Make the DTC frames of the verdicts among events; returns how many, 0: none, or only Python can tell.

    Args:
        F: a :class:`PreparedTables`; its ``made`` and ``frames`` take them.
        events: of the engine, ``events[:count]`` are new.
        count: how many.
        now_ns: the engine's time [ns].
    """
    told, listed = _verdicts(F, events, count, now_ns), F.head[0].count
    for k in range(told):
        following = F.following[F.made[k].fault]
        failed = events[F.made[k].event].kind == QUALIFIED_FAILED
        listed += following.failed_adds if failed else following.passed_adds
    for k in range(told):
        made = F.made[k]
        dtc, fdc = F.following[made.fault].dtc, events[made.event].fdc
        put_report(F, F.frames[k], now_ns, dtc, made.status, fdc, 0, listed, made.occurrence)
    return told
