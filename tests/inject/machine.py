"""A machine whose clocks, buses, disk and threads do what a test says: time passes when it says so."""

import os
import sqlite3
from collections import deque
from concurrent.futures import Executor, Future
from functools import partial

import numpy as np

from gateway.bus.base import Bus
from gateway.bus.frames import empty
from gateway.live.clock import Clock
from gateway.live.machine import Machine
from gateway_fdi.errors import BusError

MS = 1_000_000
#: Frames that wait on a bus before more are lost.
CAPACITY = 65_536


class Bench:
    """Time, and all that a gateway finds around it.

    Attributes:
        now_ns: true time [ns]; ``ahead_ns`` is what the wall clock is ahead of it.
        stalled_ns: how much of it the loop was kept from working [ns].
        cut: URIs of buses that are gone; ``room``: URI -> frames that a bus takes each turn, if not all.
        wires: open buses by URI; ``tallies``: what was put on each, and what became of it.
        writer_late_ns, reload_late_ns: how late threads are.
        may_block: tells whether the loop may wait for the disk now; ``blocked``: how often it did.
    """

    def __init__(self, uris):
        self.now_ns, self.ahead_ns, self.stalled_ns = 10**12, 1_700_000_000 * 10**9, 0
        self.cut, self.room = set(), {}
        self.wires = {}
        self.tallies = {uri: Tally() for uri in uris}
        self.disk = Disk(self)
        self.writer_late_ns = self.reload_late_ns = 0
        self.on_sent = lambda uri, frames: None
        self.may_block = lambda: False
        self.blocked = 0

    def machine(self):
        """Return it as a daemon sees it."""
        return Machine(
            clock=Clock(lambda: self.now_ns + self.ahead_ns, lambda: self.now_ns),
            monotonic=lambda: self.now_ns / 1e9,
            open_bus=partial(Wire, self),
            begin_thread=lambda work, name: LateThread(self, work),
            begin_writer=lambda: LateExecutor(self),
            patience_s=0.0,
            connect=self.disk.connect,
            tick_s=0.0,
            settle=lambda again: None,
        )

    def put(self, uri, frames):
        """Frames are on a bus, if it is there; their stamps are true time."""
        if len(frames) and uri in self.wires and uri not in self.cut:
            self.tallies[uri].put += len(frames)
            self.wires[uri].take(frames, self.ahead_ns)

    @property
    def waiting(self):
        """Frames in the queues of all buses."""
        return sum(wire.waiting for wire in self.wires.values())

    def block(self, ns):
        """The loop waits for the disk; nobody but who asks it to write may notice."""
        self.blocked += 1
        self.now_ns += ns
        if self.may_block():
            self.stalled_ns += ns

    def stall(self, ns):
        """The loop does not work for so long."""
        self.now_ns += ns
        self.stalled_ns += ns


class Tally:
    """Frames of one bus: put on it, lost in its queue, sent on it, and the turn's room for those."""

    def __init__(self):
        self.put = self.lost = self.sent = self.sent_this_turn = 0


class Wire(Bus):
    """One bus, whose receive queue has an end."""

    def __init__(self, bench, uri, index):
        super().__init__(uri, index)
        if uri in bench.cut:
            raise BusError(f"{uri}: cut")
        self._bench, self._tally = bench, bench.tallies[uri]
        self._event = os.eventfd(0)
        self._queue = deque()  # (frames, lost right before them)
        self.waiting = 0
        bench.wires[uri] = self

    def fileno(self):
        return self._event

    def take(self, frames, ahead_ns):
        """Queue what was put on the bus, stamped by the wall clock."""
        frames = frames.copy()
        frames["t_ns"] += ahead_ns
        room = max(CAPACITY - self.waiting, 0)
        if not self._queue:
            os.eventfd_write(self._event, 1)
        self._queue.append((frames[:room], 0))
        self.waiting += min(room, len(frames))
        self._lose(len(frames) - room)

    def lose(self, count):
        """Lose the latest frames in the queue, so many at most."""
        lost = 0
        while self._queue and lost < count:
            frames, before = self._queue.pop()
            gone = min(count - lost, len(frames))
            lost += gone
            if gone < len(frames) or before:
                self._queue.append((frames[: len(frames) - gone], before))
                break
        self.waiting -= lost
        self._lose(lost)

    def _lose(self, lost):
        if lost > 0:
            self._tally.lost += lost
            self._queue.append((empty(0), lost))

    def receive(self, out):
        self.losses = []
        count = 0
        while self._queue and count < len(out):
            frames, lost = self._queue.popleft()
            if lost:
                self.losses.append((count, lost))
                self.statistics.overflow += lost
            part = frames[: len(out) - count]
            out[count : count + len(part)] = part
            count += len(part)
            if len(part) < len(frames):
                self._queue.appendleft((frames[len(part) :], 0))
        if not self._queue and self.waiting:
            os.eventfd_read(self._event)
        out["bus"][:count] = self.index
        self.waiting -= count
        self.statistics.received += count
        if self.uri in self._bench.cut and not count:
            raise BusError(f"{self.uri}: cut")
        return count

    def send(self, frames):
        if self.uri in self._bench.cut:
            raise BusError(f"{self.uri}: cut")
        room = self._bench.room.get(self.uri, 1 << 30) - self._tally.sent_this_turn
        taken = max(min(len(frames), room), 0)
        self._tally.sent += taken
        self._tally.sent_this_turn += taken
        self.statistics.sent += taken
        if taken:
            self._bench.on_sent(self.uri, frames[:taken])
        return taken

    def close(self):
        if self._event >= 0:
            os.close(self._event)
            self._event = -1
        if self._bench.wires.get(self.uri) is self:
            del self._bench.wires[self.uri]


class LateThread:
    """A thread that works when its time has come, in the thread of the test."""

    def __init__(self, bench, work):
        self._bench, self._work = bench, work
        self._due_ns = bench.now_ns + bench.reload_late_ns

    def is_alive(self):
        if self._work is not None and self._bench.now_ns >= self._due_ns:
            work, self._work = self._work, None
            work()
        return self._work is not None

    def join(self):
        self._bench.now_ns = max(self._bench.now_ns, self._due_ns)
        self.is_alive()


class LateFuture(Future):
    """Something that a thread does, and will have done when its time has come."""

    def __init__(self, bench, due_ns, work):
        super().__init__()
        self._bench, self._due_ns, self._work = bench, due_ns, work

    def done(self):
        if self._work is not None and self._bench.now_ns >= self._due_ns:
            work, self._work = self._work, None
            with self._bench.disk.beside():
                try:
                    self.set_result(work())
                except Exception as error:  # as a thread's future does
                    self.set_exception(error)
        return super().done()

    def result(self, timeout=None):
        if self._bench.now_ns < self._due_ns:
            self._bench.block(self._due_ns - self._bench.now_ns)
        self.done()
        return super().result(0)


class LateExecutor(Executor):
    """One thread, as slow as the disk and as late as the test says."""

    def __init__(self, bench):
        self._bench = bench

    def submit(self, work, *arguments):
        late_ns = self._bench.writer_late_ns + self._bench.disk.slow_ns
        return LateFuture(self._bench, self._bench.now_ns + late_ns, partial(work, *arguments))


class Disk:
    """What SQLite finds: statements fail where and as the test says.

    Attributes:
        failing: (result code of SQLite, its text, place) or None.
        slow_ns: how long the end of a transaction takes.
        failures: statements that failed.
    """

    def __init__(self, bench):
        self._bench, self._beside = bench, False
        self.failing = None
        self.slow_ns = self.failures = 0

    def beside(self):
        """Return a context in which time does not wait for the disk: a thread does."""
        return _Beside(self)

    def connect(self, path, **options):
        """Connect to a file, as ``sqlite3.connect`` does."""
        kind = sqlite3.Connection if path == ":memory:" else partial(Connection, disk=self)
        return sqlite3.connect(path, factory=kind, **options)

    def before(self, sql):
        """Fail, if this statement is to."""
        verb = sql.split(None, 1)[0].upper()
        ends = verb == "COMMIT"
        if ends and not self._beside and self.slow_ns:
            self._bench.block(self.slow_ns)
        if self.failing is not None:
            place = self.failing[2]
            begins = "IMMEDIATE" in sql
            writes = verb in ("INSERT", "UPDATE", "DELETE", "REPLACE")
            if (begins, writes, ends)[min(place, 2)] and place < 3:
                self._fail()

    def after(self, sql):
        """Fail, though it was done."""
        if self.failing is not None and self.failing[2] == 3 and sql == "COMMIT":
            self._fail()

    def _fail(self):
        code, text, _ = self.failing
        self.failures += 1
        error = sqlite3.OperationalError(text)
        error.sqlite_errorcode = code
        raise error


class _Beside:
    def __init__(self, disk):
        self._disk = disk

    def __enter__(self):
        self._disk._beside = True

    def __exit__(self, *_):
        self._disk._beside = False


class Connection(sqlite3.Connection):
    """A connection on that disk."""

    def __init__(self, *arguments, disk, **options):
        self._disk = disk
        super().__init__(*arguments, **options)

    def execute(self, sql, *parameters):
        self._disk.before(sql)
        found = super().execute(sql, *parameters)
        self._disk.after(sql)
        return found

    def executemany(self, sql, *parameters):
        self._disk.before(sql)
        return super().executemany(sql, *parameters)

    def executescript(self, sql):
        self._disk.before(sql)
        return super().executescript(sql)


def random_part(rng, frames, percent):
    """Tell which frames a disturbance of so many percent concerns, as a mask."""
    return rng.random(len(frames)) * 100 < percent if percent < 100 else np.ones(len(frames), bool)
