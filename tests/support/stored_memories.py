"""Fault memories on a disk, for tests."""

import sqlite3

from fault_examples import catalogue, event, frame

from gateway.faults import service
from gateway.faults.memory import FaultMemory
from gateway.faults.records import Recording
from gateway.faults.resilient_store import ResilientStore


def connect(*arguments, **options):
    """Connect as SQLite's driver does at the time of the call: a test may have changed it since the store was made."""
    return sqlite3.connect(*arguments, **options)


def kept(path, count=3, **settings):
    store = ResilientStore(path, connect=connect)
    return store, FaultMemory(catalogue((1,) * count), store, **settings)


def listed(path):
    return {e["fault"]: e["occurrence"] for e in service.list_entries(path)}


def fill(path, count=3):
    """A memory with so many failures, closed."""
    store, memory = kept(path, count)
    memory.start_cycle(0)
    for k in range(count):
        memory.apply(event(k, True, k + 1), frame({"x": float(k)}))
    memory.ledger.add_recordings([Recording(f"m.f{k}", k, 1, 0, b"log") for k in range(count)])
    memory.write_identifier(0xF190, b"VIN")
    memory.end_cycle(count + 1)
    store.close()
