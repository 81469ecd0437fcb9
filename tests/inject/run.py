"""One run: a daemon on a bench, a schedule of what goes wrong, and checks all the time.

A failure prints the seed and the schedule; ``GATEWAY_SCHEDULE`` names a file with a schedule to be played instead, from
which lines can be taken out until only those are left that matter.
"""

import hashlib
import math
import os
import random
import sqlite3
from pathlib import Path

import numpy as np
from checks import Broken, Promises, Tap, Time, not_finite, uncounted
from ecus import Ecus, write_config
from machine import MS, Bench, random_part
from schedule import BUSES, draw, read, text_of
from tester import RESPONSE, Tester

from gateway.bus.frames import empty, payload
from gateway.live.daemon import Daemon

#: Time between two turns of the loop [ns].
TURN_NS = 5 * MS
#: At the end nothing goes wrong for so long [s]: longer than the longest wait before the memory is written again.
QUIET_S = 12.0
DISK = {
    "disk_full": (sqlite3.SQLITE_FULL, "database or disk is full"),
    "disk_error": (sqlite3.SQLITE_IOERR, "disk I/O error"),
    "disk_read_only": (sqlite3.SQLITE_READONLY, "attempt to write a readonly database"),
    "disk_busy": (sqlite3.SQLITE_BUSY, "database is locked"),
}
NO_VALUES = (math.nan, math.inf, 3e38)


def schedule_for(seed, span_s):
    """Return the schedule to be played: of the file that is named, else drawn."""
    named = os.environ.get("GATEWAY_SCHEDULE")
    return read(Path(named).read_text()) if named else draw(seed, span_s)


class Run:
    """A run.

    Args:
        folder: for configuration and fault memory.
        seed: of everything random beside the schedule.
        seconds: how long it lasts.
        schedule: what goes wrong.
        per_turn: frames on each bus in a turn.
        each: called at each turn with this run.

    Attributes:
        daemon, bench, tester, promises, tap: of this run.
        turns: so far; ``events``: how many were told, with their ``digest``.
    """

    def __init__(self, folder, seed, seconds, schedule, *, per_turn=8, each=lambda run: None):
        self.folder, self.seed, self.schedule = folder, seed, schedule
        self._turns = round(seconds * 1e9) // TURN_NS
        self._per_turn, self._each = per_turn, each
        self.bench = Bench(BUSES)
        self.bench.on_sent = self._on_sent
        self._rng = np.random.default_rng(seed)
        self._ecus = {uri: Ecus(np.random.default_rng([seed, k]), plant=k == 0) for k, uri in enumerate(BUSES)}
        self.tester = Tester(self.bench, BUSES[0], random.Random(seed))
        self.promises = Promises(folder / "f.sqlite", self.bench)
        self.tap = Tap()
        self._totals = {}
        self._waiting = list(schedule)
        self._active = {}  # (kind, bus) -> (until, disturbance)
        self._held = dict.fromkeys(BUSES, empty(0))
        self._reloads = 0
        # Who clears waits until it is written; nobody else does.
        self.bench.may_block = lambda: self.tester.clears or self.promises.down
        self._stalled = False
        self._traffic_ns = self.bench.now_ns
        self.turns = 0
        self.events = 0
        self.digest = hashlib.sha256()

    def play(self):
        """Play it; returns itself.

        Raises:
            Broken: something that must hold did not.
        """
        self._config = write_config(self.folder)
        try:
            self.daemon = Daemon(
                self._config,
                memory=self.folder / "f.sqlite",
                report=self._on_event,
                taps=[self.tap],
                machine=self.bench.machine(),
            )
            self._time = Time(self.bench)
            try:
                self._usual = set(not_finite(self.daemon.gateway.engine))
                steps = self._script()
                self.daemon.run(lambda: next(steps, True))
                self._must(uncounted(self.bench, self.tap, self.daemon, self._totals))
                self._must(self.promises.end())
            finally:
                self.daemon.close()
        except Exception as error:
            at_ms = self.turns * TURN_NS // MS
            raise Broken(
                f"seed {self.seed}, at {at_ms} ms: {type(error).__name__}: {error}\n{text_of(self.schedule)}"
            ) from error
        return self

    def summary(self):
        """Return what was done, in one line."""
        put = sum(tally.put for tally in self.bench.tallies.values())
        lost = sum(tally.lost for tally in self.bench.tallies.values())
        return (
            f"{put} frames ({lost} lost in queues and told), {len(self.schedule)} disturbances,"
            f" {self.events} events, {self.promises.count} times a confirmed DTC told"
            f" ({self.promises.unstored} as not stored, {self.promises.outages} outages),"
            f" {self.tester.answered} of {self.tester.asked} requests answered"
            f" ({self.tester.excused} kept by the bus), the slowest after {self.tester.longest_ns / 1e6:.1f} ms"
        )

    def _must(self, wrong):
        if wrong is not None:
            raise Broken(wrong)

    def _script(self):
        for turn in range(self._turns):
            self.turns = turn
            self.bench.now_ns += TURN_NS
            for tally in self.bench.tallies.values():
                tally.sent_this_turn = 0
            self._disturb()
            self._traffic()
            self._must(self.tester.turn())
            self._before_reading()
            self._each(self)
            yield False
            self._look()

    # What must hold

    def _look(self):
        if self.bench.waiting:  # it has not caught up yet; it reads so many frames a turn
            self.bench.stalled_ns += TURN_NS
        stalled = self.bench.stalled_ns
        engine = self.daemon.gateway.engine
        self._must(self._time.look(engine, stalled=stalled != self._stalled))
        self._stalled = stalled
        if self.turns % 20 == 0:
            self._must(self.promises.look())
            new = set(not_finite(engine)) - self._usual
            self._must(f"not finite: {sorted(new)}" if new else None)

    def _on_event(self, event):
        self.events += 1
        told = {name: value for name, value in event.items() if name not in ("file", "aside")}
        self.digest.update(repr(told).encode())
        if event["event"] == "bus":
            self._totals[event["uri"]] = event
        self._must(self.promises.note(event))

    def _on_sent(self, uri, frames):
        if uri != BUSES[0]:
            return
        for frame in frames[frames["can_id"] == RESPONSE]:
            self._must(self.tester.take(payload(frame)))

    # What goes wrong

    def _disturb(self):
        now_ms = self.turns * TURN_NS // MS
        changed = False
        while self._waiting and self._waiting[0].at_ms <= now_ms:
            item = self._waiting.pop(0)
            self._begin(item)
            self._active[item.kind, item.bus] = (item.at_ms + item.for_ms, item)
            changed = True
        for key, (until, _) in list(self._active.items()):
            if until < now_ms:
                del self._active[key]
                changed = True
        if changed:
            self._set({key: item for key, (_, item) in self._active.items()})

    def _begin(self, item):
        """Do what happens at once."""
        bench = self.bench
        if item.kind == "clock_step":
            bench.ahead_ns += item.amount * MS
        elif item.kind == "loop_late":
            bench.stall(item.amount * MS)
        elif item.kind == "reload":
            self._reloads += 1
            bench.reload_late_ns = item.amount * MS
            write_config(self.folder, other=self._reloads % 2 == 1)
            self.daemon.reloader.request()
        elif item.kind == "file_deleted":
            for file in self.folder.glob("f.sqlite*"):
                if not file.name.endswith("-lock"):
                    file.unlink()
            self.promises.deleted()

    def _set(self, active):
        """Set what lasts."""
        bench = self.bench
        failing = [(*DISK[kind], item.amount) for (kind, _), item in active.items() if kind in DISK]
        bench.disk.failing = failing[0] if failing else None
        amounts = {key: item.amount for key, item in active.items()}
        bench.disk.slow_ns = amounts.get(("disk_slow", ""), 0) * MS
        bench.writer_late_ns = amounts.get(("writer_late", ""), 0) * MS
        bench.room = {bus: n for (kind, bus), n in amounts.items() if kind == "queue_full"}
        for uri, ecus in self._ecus.items():
            ecus.jumps, ecus.short = amounts.get(("jumps", uri), 0), amounts.get(("short", uri), 0)
            number = amounts.get(("no_value", ""))
            ecus.no_value = None if number is None else NO_VALUES[number]

    def _traffic(self):
        begin, end = self._traffic_ns, self.bench.now_ns
        self._traffic_ns = end
        count = self._per_turn * ((end - begin) // TURN_NS)
        for uri, ecus in self._ecus.items():
            frames = self._received(uri, ecus.frames(begin, end, count))
            self.bench.put(uri, frames)

    def _before_reading(self):
        """Do what happens while frames wait in the queues."""
        self.bench.cut = {bus for kind, bus in self._active if kind == "cut"}
        for (kind, bus), (_, item) in list(self._active.items()):
            if kind == "overflow":
                del self._active[kind, bus]
                self.tester.excuse()
                if bus in self.bench.wires:
                    self.bench.wires[bus].lose(item.amount)

    def _received(self, uri, frames):
        """Return what of the frames comes now, and in which order."""
        held, self._held[uri] = self._held[uri], empty(0)
        kinds = {kind: item.amount for (kind, bus), (_, item) in self._active.items() if bus == uri}
        if "lost" in kinds:
            frames = frames[~random_part(self._rng, frames, kinds["lost"])]
        if "twice" in kinds:
            frames = np.repeat(frames, 1 + random_part(self._rng, frames, kinds["twice"]))
        if "out_of_order" in kinds:
            late = random_part(self._rng, frames, kinds["out_of_order"])
            self._held[uri], frames = frames[late], frames[~late]
        return np.concatenate([held, frames]) if len(held) else frames
