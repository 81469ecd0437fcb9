"""A fault memory with a journal, and a bus (a socket) on which its verdicts are told."""

import shutil
import socket

import numpy as np
from fault_examples import event, frame

from gateway.engine.events import QUALIFIED_FAILED, QUALIFIED_PASSED
from gateway.faults.journal import Journal
from gateway.faults.journal_steps import journal_put
from gateway.faults.memory import FaultMemory
from gateway.faults.resilient_store import ResilientStore
from gateway_fdi.jit import bound

#: All files of a fault memory.
FILES = ("", "-wal", "-verdicts")


def putter(journal, faults=("m.f0", "m.f1", "m.f2")):
    """Return a function that hands a verdict of these faults over; its arguments are those of the kernel."""
    return bound(journal_put, journal.memory(faults), rest=(*[0] * 6, np.zeros(9, np.uint64), 0, 0))


class Bus:
    """A socket to send by, and the numbers of the frames that came."""

    def __init__(self):
        self.inside, self._outside = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._outside.settimeout(60)

    @staticmethod
    def wire(number):
        """A frame that carries a number."""
        return np.asarray([number, *[0] * 8], np.uint64)

    def next(self):
        """Wait for a frame."""
        return int.from_bytes(self._outside.recv(100)[:8], "little")

    def silent(self):
        """Whether no frame is there."""
        self._outside.setblocking(False)
        try:
            self._outside.recv(100)
        except BlockingIOError:
            return True
        finally:
            self._outside.settimeout(60)
        return False

    def close(self):
        self.inside.close()
        self._outside.close()


class Telling:
    """A memory whose verdicts are told by the journal where it takes them, else when they are committed."""

    def __init__(self, path, catalogue):
        self.path, self.catalogue = path, catalogue
        self.bus, self.t_ns = Bus(), 0
        self.open()
        self.told = {d.id: self.memory.status_now(d.id) for d in catalogue}

    def open(self):
        self.store = ResilientStore(self.path)
        self.memory = FaultMemory(self.catalogue, self.store)
        self.store.journal = Journal(self.path)
        self._put = putter(self.store.journal, [d.id for d in self.catalogue])

    def close(self):
        self.store.close()

    def verdicts(self, *found):
        """Take the verdicts (place, failed) of one pass: what is put is told at once; returns how many were."""
        self.store.arm_journal(self.memory.clean)
        told = 0
        for place, failed in found:
            self.t_ns += 1
            made = event(place, failed, self.t_ns)
            self.memory.apply(made, frame({"x": 1.0}))  # the journal does not need it, but knows its outcome
            record = self.memory.record(self.catalogue[place].id)
            kind = QUALIFIED_FAILED if failed else QUALIFIED_PASSED
            number = self._put(
                place, kind, self.t_ns, record.status, record.occurrence, made.fdc, Bus.wire(self.t_ns), 16,
                self.bus.inside.fileno(),
            )  # fmt: skip
            if number:
                assert self.bus.next() == self.t_ns
                assert self.store.journal.withdraw(number), "it was sent"
                self.told[record.id] = record.status
                told += 1
        return told

    def commit(self):
        """All that is known is told when it is stored."""
        assert self.memory.commit()
        self.note_told()

    def note_told(self):
        self.told = {fault: self.memory.status_now(fault) for fault in self.told}

    def kill(self, image):
        """Leave the files as they are at this moment, as a new memory at another place."""
        for suffix in FILES:
            shutil.copyfile(f"{self.path}{suffix}", f"{image}{suffix}")
        self.close()
        self.path = image
