"""A fleet on the road, for tests: cars' memories, a broker that can be killed, tables."""

import json
import os
import random
import socket
import subprocess
from collections import Counter
from contextlib import contextmanager, suppress

import pyarrow.parquet as pq
from debian import program
from kernel_can import wait_for

from gateway.faults.catalogue import Catalogue
from gateway.faults.fleet import FleetParams
from gateway.faults.memory import FaultMemory
from gateway.faults.memory_reader import MemoryReader
from gateway.faults.resilient_store import ResilientStore
from gateway.runtime.contract import STATISTICS

#: Ports below those of connections (Linux: from 32768), another order in each process of the tests.
PORTS = random.SystemRandom()


def car_of(name="c0ffee01", **more):
    """A car of the fleet "vans"."""
    return FleetParams(name="vans", car=name, model="van", software="7.1", **more)


def event(n, kind="dtc", pad=0):
    """An event that has a number."""
    if kind == "statistics":
        row = ("m.f", 1, 2.0, 0, 0, [1], [n])
        return {
            "event": "statistics", "t_ns": n, "begin_ns": 0, "part": 0, "condition": "x" * pad, "block_s": 60.0,
            "seconds": 60.0, "tests": {name: [value] for name, value in zip(STATISTICS, row, strict=True)},
        }  # fmt: skip
    return {
        "event": "dtc", "t_ns": n, "bus": "can0", "fault": "m.f", "dtc": "P0301-11", "status": 47, "fdc": 127,
        "occurrence": n, "evidence": {f"pad{k}": 1.0 for k in range(pad)},
    }  # fmt: skip


class Memory:
    """A car's fault memory, as its daemon keeps it."""

    def __init__(self, path, car):
        self.store = ResilientStore(path)
        self.memory = FaultMemory(Catalogue(()), self.store, fleet=car)

    def post(self, *events):
        for each in events:
            self.memory.fleet.post(each, detail=each["event"] == "statistics")

    def commit(self):
        return self.memory.commit(final=True)

    def close(self):
        self.store.close()


def rows(folder, table="events"):
    """All rows of a table."""
    found = []
    for path in sorted((folder / table).glob("*/[!.]*.parquet")):
        found += pq.ParquetFile(path).read().to_pylist()
    return found


def numbers(folder):
    """How often each number of :func:`event` is in the tables."""
    return Counter(row["t"].value if hasattr(row["t"], "value") else row["t"] for row in rows(folder))


def occurrences(folder):
    """How often each dtc event is in the tables, by its number."""
    return Counter(json.loads(row["body"])["occurrence"] for row in rows(folder) if row["kind"] == "dtc")


def waiting(path):
    """Rows of a memory's file that have not been taken away, read beside its daemon and its sender."""
    opened = MemoryReader(path)
    try:
        return opened.store().outgoing()
    finally:
        opened.close()


def free_port():
    """A port that nobody listens at, and that the kernel gives to no connection until its process is there."""
    while True:
        with socket.socket() as probe, suppress(OSError):
            probe.bind(("127.0.0.1", port := PORTS.randrange(10_000, 32_000)))
            return port


@contextmanager
def broker(folder, port, more="allow_anonymous true\n"):
    """Debian's mosquitto; it keeps nothing when it ends."""
    folder.chmod(0o755)
    config = folder / "mosquitto.conf"
    config.write_text(f"listener {port} 127.0.0.1\npersistence false\nuser root\n{more}")
    log = (folder / "mosquitto.log").open("ab")
    started = subprocess.Popen([program("mosquitto"), "-c", config], stdout=log, stderr=log)
    try:

        def answers():
            assert started.poll() is None, (folder / "mosquitto.log").read_text()
            with socket.socket() as probe:
                return probe.connect_ex(("127.0.0.1", port)) == 0

        wait_for(answers)
        yield started
    finally:
        started.kill()
        started.wait()
        log.close()


def plain():
    """The environment of a process of a user."""
    return {**os.environ, "PYTHONUNBUFFERED": "1"}
