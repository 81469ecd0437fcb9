"""Kernels of the journal: a verdict is handed over, put on the disk, and sent, none of it by Python.

Two threads share a ring of entries. The one that feeds the engine fills an entry (:func:`journal_put`) and goes on. The
other one (:func:`keep`) waits for that, writes the record into its place in the file, synchronises it, and sends the
frame. An event descriptor counts the entries that are handed over; reading it is the only wait. The state of an entry
is changed by one of two in one step of the processor: the second thread takes it to send it, or Python withdraws it,
which sends its own frame then. So each frame leaves once, and never after a newer one of the same DTC.
"""

from __future__ import annotations

from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gateway.faults.journal_file import MAGIC, RECORD, SLOT, SLOTS
from gateway.signals.protection.checksum import take_bytes
from gateway_fdi.jit import Record, i8, i8s, kernel, means, u8s
from gateway_fdi.jit.system import change_if, fdatasync, pwrite, read, send, write

#: States of an entry.
WAITING, SENDING, SENT, UNSENT = 1, 2, 3, 4
#: Reasons why the journal takes no more: 0: it does.
NO_WRITE, NO_SYNC, NO_EVENT = 1, 2, 3
#: Added to the event's count, it ends the thread.
END = 1 << 32

_DONTWAIT = 0x40
_NOSIGNAL = 0x4000
_CELLS = RECORD // 8 - 1  # of a record, without its sum


class State(Record):
    """The journal's file and counts."""

    armed: i8 = means("1: verdicts are taken: no write is under way, and the digest is that of the last one")
    failed: i8 = means("why no more are taken")
    event: i8 = means("descriptor of the event")
    file: i8 = means("descriptor of the file")
    number: i8 = means("of the latest verdict taken")
    before: i8 = means("number of the latest verdict that the memory's file has for certain")
    done: i8 = means("number of the latest entry that is dealt with")
    kept: i8 = means("verdicts that were synchronised")
    sent: i8 = means("frames that were sent")
    link: i8 = means("number of the last link of the memory's file")
    generation: i8 = means("of that file")
    digest: Annotated[u8s, 4] = means("of that link")
    one: Annotated[u8s, 1] = means("the number 1")
    woken: Annotated[u8s, 1] = means("count of the event, as read")


class Entry(Record):
    """A verdict on its way."""

    state: Annotated[i8s, 1] = means("one of the states")
    number: i8 = means("of the verdict")
    fd: i8 = means("socket that its frame leaves by")
    length: i8 = means("bytes of its frame")
    record: Annotated[u8s, 13] = means("as in the file")
    wire: Annotated[u8s, 9] = means("the frame as a struct of the system")


class Journalled(NamedTuple):
    """Memory of a journal, in one argument: one state, a ring of entries, names of faults (shape (n, 2)), CRC-32."""

    state: NDArray[np.void]
    entries: NDArray[np.void]
    names: NDArray[np.uint64]
    table: NDArray[np.uint64]


@kernel
def journal_put(
    J: Any, fault: int, kind: int, t_ns: int, status: int, occurrence: int, fdc: int, wire: Any, size: int, fd: int
) -> int:
    """Hand a verdict over, to be put on the disk and sent; returns its number, 0: the journal does not take it.

    Args:
        J: a :class:`Journalled`.
        fault: its place among the names.
        kind: of the event.
        t_ns: of the wall clock [ns].
        status: status byte after it.
        occurrence: failures after it.
        fdc: fault detection counter.
        wire: the frame, in cells.
        size: of the frame [byte].
        fd: socket that it leaves by.
    """
    s = J.state[0]
    number = s.number + 1
    if s.armed != 1 or s.failed != 0 or number - s.done > SLOTS or number - s.before > SLOTS:
        return 0
    entry = J.entries[number % SLOTS]
    record = entry.record
    record[0], record[1] = np.uint64(MAGIC), np.uint64(number)
    for k in range(4):
        record[2 + k] = s.digest[k]
    record[6], record[7] = J.names[fault, 0], J.names[fault, 1]
    record[8] = np.uint64(np.int64(t_ns))
    record[9] = np.uint64(kind | status << 8 | occurrence << 16 | (fdc & 0xFF) << 24)
    record[10], record[11] = np.uint64(s.link), np.uint64(s.generation)
    register = np.uint64(0xFFFFFFFF)
    for k in range(_CELLS):
        register = take_bytes(register, record[k], 8, 1, J.table)
    record[_CELLS] = register ^ np.uint64(0xFFFFFFFF)
    for k in range(size // 8):
        entry.wire[k] = wire[k]
    entry.number, entry.length, entry.fd = number, size, fd
    entry.state[0] = WAITING
    s.number = number
    if write(s.event, s.one.ctypes.data, 8) != 8:
        s.failed = NO_EVENT
        entry.state[0] = UNSENT
        return 0
    return int(number)


@kernel
def withdraw(J: Any, number: int) -> int:
    """Keep a frame from being sent; returns the entry's state: SENDING, as long as it is, SENT, or UNSENT for good.

    Args:
        J: a :class:`Journalled`.
        number: of the verdict.
    """
    entry = J.entries[number % SLOTS]
    if entry.number != number:
        return UNSENT
    change_if(entry.state.ctypes.data, WAITING, UNSENT)
    return int(entry.state[0])


@kernel
def _put_down(J: Any, first: int, last: int) -> None:
    """Put verdicts on the disk, and send their frames."""
    s = J.state[0]
    for number in range(first, last + 1):
        at = J.entries[number % SLOTS].record.ctypes.data
        if s.failed == 0 and pwrite(s.file, at, RECORD, (number % SLOTS) * SLOT) != RECORD:
            s.failed = NO_WRITE
    if s.failed == 0 and fdatasync(s.file) != 0:
        s.failed = NO_SYNC
    if s.failed == 0:
        s.kept += last + 1 - first
    for number in range(first, last + 1):
        entry = J.entries[number % SLOTS]
        state = entry.state.ctypes.data
        if change_if(state, WAITING, UNSENT if s.failed != 0 else SENDING) == 1 and s.failed == 0:
            sent = send(entry.fd, entry.wire.ctypes.data, entry.length, _DONTWAIT | _NOSIGNAL) == entry.length
            s.sent += sent
            change_if(state, SENDING, SENT if sent else UNSENT)
        s.done = number


@kernel
def keep(J: Any) -> None:
    """Put verdicts on the disk, and send their frames, until told to end.

    Args:
        J: a :class:`Journalled`.
    """
    s = J.state[0]
    while True:
        if read(s.event, s.woken.ctypes.data, 8) != 8:
            s.failed = NO_EVENT
            return
        came = np.int64(s.woken[0])
        taken = came % END
        if taken > 0:
            _put_down(J, s.done + 1, s.done + taken)
        if came >= END:
            return
