"""What a gateway does with its memory while the power may go: one of five kinds of work, told line by line.

``known FAULT STATUS OCCURRENCE``: a state that the memory has in the process now. ``told ...``: it has been told, as a
DTC frame of the journal or as stored. The lines go into a file of the same folder: they stand in the trace in order.
"""

import os
import random
import sys
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve()
sys.path[:0] = [str(HERE.parents[1]), str(HERE.parents[2] / "support")]

from fault_examples import catalogue, event, frame  # noqa: E402
from journalled import Bus, putter  # noqa: E402

from gateway.engine.events import QUALIFIED_FAILED, QUALIFIED_PASSED  # noqa: E402
from gateway.faults.memory import FaultMemory  # noqa: E402
from gateway.faults.records import Recording  # noqa: E402
from gateway.faults.resilient_store import ResilientStore  # noqa: E402
from gateway.faults.status import CLEARED  # noqa: E402
from gateway.faults.writer_thread import WriterThread  # noqa: E402

COUNT = 4


class Work:
    """A memory with a journal, whose verdicts are told as in the live gateway."""

    def __init__(self, path, seed):
        self.path, self.rng = path, random.Random(seed)
        self.lines = os.open(path.parent / "lines", os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600)
        self.bus, self.t_ns = Bus(), 0
        self.writer = None
        self.open()

    def say(self, kind, fault, status, occurrence):
        os.write(self.lines, f"{kind} {fault} {int(status)} {occurrence}\n".encode())

    def open(self):
        self.catalogue = catalogue((1,) * COUNT)
        self.store = ResilientStore(self.path)
        self.memory = FaultMemory(self.catalogue, self.store)
        self.memory.start_cycle(self.t_ns)
        self.say_all("known")
        self.store.begin_journal()
        self.say_all("told")
        self.put = putter(self.store.journal, [d.id for d in self.catalogue])

    def close(self):
        self.store.close()

    def states(self):
        records = [self.memory.record(definition.id) for definition in self.catalogue]
        return [(record.id, record.status, record.occurrence) for record in records]

    def say_all(self, kind, states=None):
        for state in self.states() if states is None else states:
            self.say(kind, *state)

    def verdicts(self, count):
        """Some verdicts of one pass; the journal tells those that it takes."""
        self.store.arm_journal(self.memory.clean)
        for place in self.rng.sample(range(COUNT), count):
            self.t_ns += 1
            failed = not self.memory.record(f"m.f{place}").status & 1
            self.memory.apply(event(place, failed, self.t_ns), frame({"x": self.rng.random()}))
            record = self.memory.record(f"m.f{place}")
            self.say("known", record.id, record.status, record.occurrence)
            number = self.put(
                place, QUALIFIED_FAILED if failed else QUALIFIED_PASSED, self.t_ns, record.status, record.occurrence,
                127 if failed else -128, Bus.wire(self.t_ns), 16, self.bus.inside.fileno(),
            )  # fmt: skip
            if number:
                assert self.bus.next() == self.t_ns
                self.say("told", record.id, record.status, record.occurrence)

    def commit(self):
        assert self.memory.commit()
        self.say_all("told")

    def clear(self):
        for definition in self.catalogue:
            self.say("known", definition.id, CLEARED, 0)
        self.memory.clear()
        self.say_all("told")

    def storm(self, count, reload=0):
        """Verdicts while a thread writes; a successor takes the memory over each so many writes."""
        writer, begun, writes = WriterThread("fault-memory"), None, 0
        for _ in range(count):
            self.verdicts(self.rng.randrange(1, 3))
            if not self.memory.ledger.under_way(0.001):
                self.memory.join()
                self.say_all("told", begun or [])
                if reload and writes % reload == reload - 1:
                    old, self.memory = self.memory, FaultMemory(self.catalogue, self.store)
                    self.memory.succeed(old)
                begun, writes = self.states(), writes + 1
                self.memory.begin(self.t_ns, writer)
            else:
                FaultMemory(self.catalogue, self.store)  # whoever reads meanwhile
        self.memory.join()
        writer.shutdown()
        self.commit()


def start(work):
    """The file is begun, opened again, and opened by a daemon that finds something in the journal only."""
    for _ in range(3):
        work.verdicts(2)
        work.close()
        work.open()
        work.commit()


def storm(work):
    work.store.tend_log()
    work.storm(40)


def reload(work):
    work.store.tend_log()
    work.storm(40, reload=2)


def clear(work):
    for _ in range(8):
        work.verdicts(3)
        work.commit()
        work.verdicts(2)
        work.clear()
        work.verdicts(1)


def checkpoint(work):
    for k in range(12):
        work.verdicts(2)
        work.memory.ledger.add_recordings([Recording("m.f1", k, 1, 0, np.random.default_rng(k).bytes(9000))])
        work.commit()
        if k % 3 == 2:
            work.store.tend_log()
    work.store.compact()
    work.verdicts(2)
    work.commit()


KINDS = {work.__name__: work for work in (start, storm, reload, clear, checkpoint)}

if __name__ == "__main__":
    made = Work(Path(sys.argv[2]), int(sys.argv[3]))
    KINDS[sys.argv[1]](made)
    made.close()
