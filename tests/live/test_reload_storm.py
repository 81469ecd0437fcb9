"""Reloads in a storm of verdicts: what was told as stored is in the file, at that moment and after all of them.

``GATEWAY_TESTS=full`` reloads 10,000 times (``GATEWAY_RELOADS`` sets the number).
"""

import os
import random
import sqlite3
import time
from collections import Counter

import pytest
from amount import amount
from daemon_rig import MS, World
from kill_storm import MESSAGES, write_config

from gateway.faults import service
from gateway.runtime.persistence import begin_writer

RELOADS = int(os.environ.get("GATEWAY_RELOADS", "0")) or amount(10_000, 30, 12)


class Storm:
    """Frames of eight messages, of which each fifth has a wrong counter and each fifth is too short."""

    def __init__(self, world, seed):
        self._world, self._rng, self._counts = world, random.Random(seed), [0] * MESSAGES

    def __call__(self, _turn):
        for _ in range(self._rng.randrange(1, 12)):
            k, what = self._rng.randrange(MESSAGES), self._rng.random()
            self._counts[k] += 1 + 3 * (what < 0.2)
            data = bytes([self._counts[k] % 256, *self._rng.randbytes(7)])
            self._world.put(0x300 + k, data[: 2 if what > 0.8 else 8])


class Reference:
    """An independent log of what was told as stored: the file must have it when it is told, and ever after."""

    def __init__(self, path):
        self._path, self._db = path, None
        self.told, self.missing, self.events = {}, [], Counter()

    def __call__(self, event):
        self.events[event["event"], event.get("stored", event.get("state"))] += 1
        if event["event"] == "dtc" and event["stored"]:
            self.told[event["fault"]] = event["occurrence"]
            self.look("when told", event["fault"])

    def look(self, when, *faults):
        if self._db is None:
            self._db = sqlite3.connect(f"{self._path.as_uri()}?mode=ro", uri=True, isolation_level=None)
        for fault in faults:
            row = self._db.execute("SELECT occurrence FROM fault WHERE id = ?", (fault,)).fetchone()
            if row is None or row[0] < self.told[fault]:
                self.missing.append((when, fault, self.told[fault], row, dict(self.events)))

    def close(self):
        self.look("at the end", *self.told)
        self._db.close()


def config_for(folder):
    path = write_config(folder)
    path.write_text(path.read_text().replace("loopback:", "virtual:a"))
    return path


@pytest.mark.long
@pytest.mark.timeout(600 + RELOADS)
def test_what_is_told_as_stored_over_many_reloads_is_in_the_file(tmp_path):
    """The thread writes in real time, and a reload reads the memory meanwhile."""
    seed = int(os.environ.get("GATEWAY_SEED", "4"))
    print("seed", seed)
    world, path = World(), tmp_path / "f.sqlite"
    daemon = world.daemon(config_for(tmp_path), path, begin_writer=begin_writer)
    reference, storm = Reference(path), Storm(world, seed)
    daemon._listener = reference

    def script():
        yield from world.wait(0.3, storm)
        for done in range(1, RELOADS + 1):
            daemon.reloader.request()
            while reference.events["config", "reloaded"] < done:
                assert not reference.events["config", "refused"]
                yield from world.wait(0.005, storm)
                time.sleep(0)  # the thread that prepares gets its turn
        yield from world.wait(0.3, storm)

    try:
        world.play(daemon, script())
    finally:
        daemon.close()
    reference.close()
    found = {entry["fault"]: entry["occurrence"] for entry in service.list_entries(path)}
    stored, untold = reference.events["dtc", True], reference.events["dtc", False]
    print(f"{RELOADS} reloads, {stored} changes told as stored, {untold} as not, missing {len(reference.missing)}")
    assert reference.missing == []
    assert stored > 10 * RELOADS, "how many come in a reload depends on how long it takes"
    assert untold == 0
    assert all(found[fault] >= occurrence for fault, occurrence in reference.told.items())
    assert service.verify(path)["broken"] == []
    assert reference.events["memory", "damaged"] == 0


class SlowWriter:
    """A disk that takes 30 ms for each write, of the world's time."""

    def __init__(self, world):
        self._world, self.begun = world, []

    def submit(self, work, *arguments):
        self.begun.append(self._world.now_ns)
        return _SlowWork(self._world, self._world.now_ns + 30 * MS, work, arguments)

    def shutdown(self):
        pass


class _SlowWork:
    def __init__(self, world, due_ns, work, arguments):
        self._world, self._due_ns, self._work = world, due_ns, (work, arguments)

    def done(self):
        if self._work is not None and self._world.now_ns >= self._due_ns:
            self.result()
        return self._work is None

    def exception(self, timeout=None):
        if not self.done() and timeout is not None:
            raise TimeoutError

    def result(self, timeout=None):
        self._world.now_ns = max(self._world.now_ns, self._due_ns)
        if self._work is not None:
            (work, arguments), self._work = self._work, None
            work(*arguments)


@pytest.mark.long
def test_a_reload_waits_for_one_write_however_long_the_storm(tmp_path):
    """It waited as long as the storm: the next write began when the one before had ended."""
    world = World()
    writers = []

    def slow():
        writers.append(SlowWriter(world))
        return writers[-1]

    daemon = world.daemon(config_for(tmp_path), tmp_path / "f.sqlite", begin_writer=slow, patience_s=0.0)
    storm, taken = Storm(world, 5), []

    def script():
        yield from world.wait(0.5, storm)
        for done in range(1, 5):
            daemon.reloader.request()
            while not daemon.reloader.ready:
                yield from world.wait(0.005, storm)
                time.sleep(0.001)
            ready_ns = world.now_ns
            while len(world.told("config")) < done and world.now_ns < ready_ns + 10_000 * MS:
                yield from world.wait(0.005, storm)
            taken.append((world.now_ns - ready_ns) / MS)
        yield from world.wait(0.5, storm)

    try:
        world.play(daemon, script())
    finally:
        daemon.close()
    (writer,) = writers
    assert [event["state"] for event in world.told("config")] == ["reloaded"] * 4
    assert max(taken) <= 50, f"[ms]: {taken}"
    assert len(writer.begun) > 20, "or there was no storm"
