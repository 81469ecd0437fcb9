"""What must hold whatever goes wrong: checked at every turn, at every event, and at the end."""

import sqlite3
from collections import Counter

import numpy as np

from gateway.bus.frames import ERROR, OWN

MS = 1_000_000
CONFIRMED = 0x08
#: A file that was deleted is missed after this time at the latest [ns]; its successor takes the thread two writes.
MISSED_NS, WRITES = 400 * MS, 2
#: Engine's time is never further behind true time than this [ns]; nor ahead of it: where the clock was set among frames
#: that come out of order by a turn, nobody can tell the place to less than that turn.
LAG_NS, AHEAD_NS = 120 * MS, 6 * MS

#: Counters of what may become of a frame; each is counted in one of them.
OUTCOMES = (
    "decoded", "unknown", "remote", "error", "clock_steps",
    "too_short", "crc_failed", "repeated", "invalid_values",
)  # fmt: skip


class Broken(AssertionError):
    """Something that must hold did not."""


class Tap:
    """Counts what the engine gets, and what is sent."""

    def __init__(self):
        self.received, self.conditions, self.sent = 0, 0, 0

    def write(self, frames):
        own = frames["flags"] & OWN != 0
        conditions = (frames["can_id"] & ERROR != 0) & ~own
        self.sent += int(own.sum())
        self.conditions += int(conditions.sum())
        self.received += int((~own & ~conditions).sum())


class Stored:
    """The fault memory's file, as another process sees it."""

    def __init__(self, path):
        self._path, self._inode, self._db = path, None, None

    def read(self):
        """Return fault -> (occurrence, status); None: there is no file."""
        try:
            inode = self._path.stat().st_ino
        except OSError:
            return None
        if inode != self._inode:
            self.close()
            self._db = sqlite3.connect(f"file:{self._path}?mode=ro", uri=True)
            self._inode = inode
        rows = self._db.execute("SELECT id, occurrence, status FROM fault").fetchall()
        return {fault: (occurrence, status) for fault, occurrence, status in rows}

    def close(self):
        if self._db is not None:
            self._db.close()
        self._db = self._inode = None


class Promises:
    """Confirmed DTCs that were told, as stored or not, against the file.

    Attributes:
        count: DTCs told as confirmed; ``unstored`` of them as not stored.
        down: whether the memory was said not to be written.
    """

    def __init__(self, path, bench):
        self._stored, self._bench = Stored(path), bench
        self._told, self._kept = {}, {}
        self._deleted_ns, self._slowest_ns = None, 0
        self.count = self.unstored = self.outages = 0
        self.down = False

    def note(self, event):
        """Take an event; returns what is wrong with it."""
        if event["event"] == "memory":
            self.outages += event["state"] == "not written"
            self.down = event["state"] == "not written" or (self.down and event["state"] != "written")
            return None
        if event["event"] == "clear":
            for fault in event["faults"]:
                self._told.pop(fault, None)
                self._kept.pop(fault, None)
            return None
        if event["event"] != "dtc" or not event["status"] & CONFIRMED:
            return None
        fault, occurrence = event["fault"], event["occurrence"]
        self.count += 1
        self._told[fault] = occurrence
        if not event["stored"]:
            self.unstored += 1
            return None
        self._kept[fault] = occurrence
        return self._missing({fault: occurrence})

    def deleted(self):
        """The file was deleted."""
        self._deleted_ns = self._bench.now_ns - self._bench.stalled_ns
        self._slowest_ns = self._write_ns()

    def _write_ns(self):
        return self._bench.writer_late_ns + self._bench.disk.slow_ns

    def look(self):
        """Return what is missing of what was told as stored."""
        if self.down:
            return None
        if self._deleted_ns is not None:
            self._slowest_ns = max(self._slowest_ns, self._write_ns())
            since_ns = self._bench.now_ns - self._bench.stalled_ns - self._deleted_ns
            if since_ns < MISSED_NS + WRITES * self._slowest_ns:
                return None
            self._deleted_ns = None
        return self._missing(self._kept)

    def end(self):
        """Return what is missing of all that was told, now that writing works again."""
        wrong = "the memory is not written" if self.down else self._missing(self._told)
        self._stored.close()
        return wrong

    def _missing(self, wanted):
        if not wanted:
            return None
        stored = self._stored.read()
        if stored is None:
            return f"told as stored, but there is no file: {sorted(wanted)}"
        for fault, occurrence in wanted.items():
            kept, status = stored.get(fault, (0, 0))
            if kept < occurrence or not status & CONFIRMED:
                return (
                    f"told as stored: {fault}, confirmed, occurrence {occurrence};"
                    f" stored: occurrence {kept}, status {status:#04x}"
                )
        return None


class Time:
    """Engine's time against true time."""

    def __init__(self, bench):
        self._bench = bench
        self._ahead_ns, self._last_ns = bench.ahead_ns, 0
        self.worst_ns = 0

    def look(self, engine, *, stalled):
        """Return what is wrong with the engine's time; a loop that was kept from working may be behind."""
        now = engine.now_ns
        if now < self._last_ns:
            return f"the engine's time went back by {self._last_ns - now} ns"
        self._last_ns = now
        lag = self._bench.now_ns + self._ahead_ns - now
        if stalled:
            return None
        self.worst_ns = max(self.worst_ns, lag)
        if not -AHEAD_NS <= lag <= LAG_NS:
            return f"the engine's time is {lag / 1e6:.1f} ms behind true time"
        return None


def not_finite(engine):
    """Return the paths of all that monitors hold that is not finite."""
    found = []
    for k, instance in enumerate(engine.monitors):
        found += [f"{instance.name}{path}" for path in _not_finite(engine.state_of(k)[0], "")]
    return found


def _not_finite(value, path):
    if value.dtype.names:
        for name in value.dtype.names:
            yield from _not_finite(value[name], f"{path}.{name}")
    elif value.dtype.kind == "f" and not np.isfinite(value).all():
        yield path


def uncounted(bench, tap, daemon, totals):
    """Return what became of frames that nobody can say.

    Args:
        bench, tap: of the run.
        daemon: at its end.
        totals: URI -> last statistics that were told of the bus.
    """
    put = Counter({uri: tally.put for uri, tally in bench.tallies.items()})
    for uri, tally in bench.tallies.items():
        told = totals[uri]
        if told["received"] + told["overflow"] != tally.put or told["overflow"] != tally.lost:
            return (
                f"{uri}: {tally.put} frames put on it, {tally.lost} lost in its queue;"
                f" told: {told['received']} received, {told['overflow']} lost"
            )
        if told["sent"] != tally.sent:
            return f"{uri}: {tally.sent} frames sent, told: {told['sent']}"
    received = sum(put.values()) - sum(tally.lost for tally in bench.tallies.values())
    if tap.received != received:
        return f"{received} frames received, {tap.received} fed"
    counters = daemon.gateway.engine.counters()
    if counters["frames"] != tap.received + tap.conditions:
        return f"{tap.received} frames and {tap.conditions} conditions fed, counted: {counters['frames']}"
    if sum(counters[name] for name in OUTCOMES) != counters["frames"]:
        return f"not all frames are decoded or counted as something else: {counters}"
    sent = sum(tally.sent for tally in bench.tallies.values())
    unsent = sum(told["unsent"] for told in totals.values())
    if not sent <= tap.sent + unsent or not tap.sent <= sent + unsent:
        return f"{tap.sent} frames to be sent, {sent} sent, {unsent} given up"
    return None
