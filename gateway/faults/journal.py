"""The journal as Python sees it: its file, its thread, and which frames that thread has sent."""

from __future__ import annotations

import os
import signal
import struct
import threading
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from gateway.faults import journal_steps as steps
from gateway.faults.journal_file import SLOTS, begin, name_of, note, path_of
from gateway.faults.rollback import LastLink
from gateway.host.slice import come_first
from gateway.signals.protection.crc import KNOWN, table_of
from gateway_fdi.jit import bound, zeros

_CRC = KNOWN["crc32"]
_PLACE = {name: field[1] // 8 for name, field in (steps.State.dtype.fields or {}).items()}
_REASONS = {
    steps.NO_WRITE: "a record could not be written",
    steps.NO_SYNC: "a record could not be synchronised",
    steps.NO_EVENT: "its thread cannot be reached",
}


def _memory(state: Any, entries: Any, faults: Iterable[str]) -> steps.Journalled:
    names = b"".join(map(name_of, faults)) or bytes(16)
    table = table_of(_CRC.width, _CRC.poly, _CRC.refin)
    return steps.Journalled(state, entries, np.frombuffer(bytearray(names), np.uint64).reshape(-1, 2), table)


#: Takes nothing: where there is no journal.
NO_JOURNAL = _memory(zeros(1, steps.State), zeros(SLOTS, steps.Entry), ())


class Journal:
    """Verdicts on their way to the disk and to the bus, in a thread of compiled code (:mod:`.journal_steps`).

    Args:
        database: the fault memory's file, which is there.
        generation: of that file.

    Raises:
        OSError: it cannot have a journal.
    """

    def __init__(self, database: Path, generation: int = 0) -> None:
        self._path = path_of(database)
        self._file, latest = begin(database, generation)
        self._event = os.eventfd(0, os.EFD_CLOEXEC)
        self._state, self._entries = zeros(1, steps.State), zeros(SLOTS, steps.Entry)
        state = self._state[0]
        state.file, state.event, state.one = self._file, self._event, 1
        state.number = state.before = state.done = latest
        self._cells = memoryview(self._state.view(np.int64))
        self._head, self._over = b"", False
        memory = self.memory(())
        self._withdraw, self._keep = bound(steps.withdraw, memory, rest=(0,)), bound(steps.keep, memory, rest=())
        self._thread = threading.Thread(target=self._run, name="fault-verdicts", daemon=True)
        self._thread.start()

    def _run(self) -> None:
        signal.pthread_sigmask(signal.SIG_BLOCK, signal.valid_signals())  # they would end a wait for the disk
        come_first()  # it has next to nothing to do, and a verdict waits for it
        self._keep()

    def memory(self, faults: Iterable[str]) -> steps.Journalled:
        """Return its memory for a kernel that hands verdicts over."""
        return _memory(self._state, self._entries, faults)

    def arm(self, head: bytes, link: int = 0, generation: int = 0) -> bool:
        """Let verdicts be taken, or not; returns whether they are.

        Args:
            head: digest of the last link of the memory's file, if no write is under way; else b"".
            link: its number.
            generation: of the file.
        """
        cells = self._cells
        if head and head != self._head:
            cells[_PLACE["before"]] = cells[_PLACE["number"]]
            cells[_PLACE["link"]], cells[_PLACE["generation"]] = link, generation
            for k, word in enumerate(struct.unpack("<4q", head)):
                cells[_PLACE["digest"] + k] = word
            self._head = head
        cells[_PLACE["armed"]] = armed = bool(head) and not self._over
        return armed

    def note(self, link: LastLink) -> None:
        """Note the last link of a commit, which is on the disk (see :mod:`gateway.faults.rollback`)."""
        note(self._file, self._cells[_PLACE["number"]] + 1, link)

    def withdraw(self, number: int) -> bool:
        """Return whether a verdict's frame has been sent; if not, it will not be, and the caller sends his.

        A disk is not waited for, only the end of a call that sends.
        """
        while (state := self._withdraw(number)) == steps.SENDING:
            time.sleep(0)
        return bool(state == steps.SENT)

    def settle(self) -> None:
        """Withdraw all frames that wait: a socket is to be closed, whose number another file may get."""
        cells = self._cells
        for number in range(cells[_PLACE["done"]] + 1, cells[_PLACE["number"]] + 1):
            self.withdraw(number)

    def look(self) -> str:
        """Look whether it does its work; returns why it does not, once, and it takes no more verdicts; else ""."""
        reason = "" if self._over else self._reason()
        if reason:
            self._over = True
            self.arm(b"")
        return reason

    def _reason(self) -> str:
        if failed := self._cells[_PLACE["failed"]]:
            return _REASONS[failed]
        if not self._thread.is_alive():
            return "its thread has ended"
        try:
            same = os.path.samestat(os.fstat(self._file), self._path.stat())
        except OSError as error:
            return error.strerror or str(error)
        return "" if same else "another file has its place"

    def close(self) -> None:
        """End it, after all that was handed over."""
        self.arm(b"")
        os.eventfd_write(self._event, steps.END)
        self._thread.join()
        os.close(self._event)
        os.close(self._file)
