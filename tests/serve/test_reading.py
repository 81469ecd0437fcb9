"""How the page's process reads the fault memory's file: in one thread, by a connection that stays open.

Each thread has a heap of its own, where what SQLite has freed stays; and a connection takes thousands of small pieces
of memory, between which those of what was read come to lie.
"""

import asyncio
import threading
from pathlib import Path
from types import SimpleNamespace

import pytest
from talkative import frames, write_config

from gateway.config.load import load_config
from gateway.faults import service
from gateway.faults.dtc import ALL_DTCS
from gateway.faults.service import open_reader
from gateway.faults.store import Store
from gateway.runtime.app import Gateway
from gateway_serve.hub import Hub
from gateway_serve.memory import MemoryFile


class File:
    """Notes which threads read."""

    def __init__(self):
        self.threads = []

    def read(self, _faults):
        self.threads.append(threading.get_ident())
        return {"entries": [], "reads": len(self.threads)}

    def close(self):
        self.threads.append(threading.get_ident())

    def recording(self, _dtc, _number):
        self.threads.append(threading.get_ident())


def test_one_thread_reads_the_file():
    async def work():
        hub = Hub(Path("none"))
        hub.memory_file = file = File()
        reading = asyncio.create_task(hub._read_memory())
        hub.ask_memory()
        await asyncio.gather(*(hub.recording("P0336-39", 1) for _ in range(30)))
        while "reads" not in hub.memory:
            await asyncio.sleep(0.01)
        reading.cancel()
        return file.threads

    threads = asyncio.run(asyncio.wait_for(work(), 300))
    assert len(threads) > 30
    assert len(set(threads)) == 1
    assert threading.get_ident() not in threads


@pytest.fixture
def memory(tmp_path, monkeypatch):
    """A fault memory, its writer, and how often it was opened for reading."""
    gateway = Gateway(load_config(write_config(tmp_path)), tmp_path / "faults.sqlite")
    gateway.start(10**18)
    gateway.feed(frames(10**18))
    opened = []
    monkeypatch.setattr(service, "open_reader", lambda path: opened.append(path) or open_reader(path))
    yield SimpleNamespace(gateway=gateway, path=tmp_path / "faults.sqlite", opened=opened)
    gateway.close()


def test_the_file_is_opened_once_and_what_is_written_is_seen(memory):
    file = MemoryFile(memory.path)
    (entry,) = file.read(())["entries"]
    assert entry["recordings"] == 0
    memory.gateway.memory.clear(ALL_DTCS)
    assert file.read(())["entries"] == []
    memory.gateway.feed(frames(10**18 + 2 * 10**9))
    assert len(file.read(())["entries"]) == 1
    assert len(memory.opened) == 1
    file.close()
    assert len(file.read(())["entries"]) == 1, "opened again"
    file.close()


def test_who_leaves_last_puts_all_into_the_file(memory):
    file = MemoryFile(memory.path)
    file.read(())
    memory.gateway.close()
    file.close()
    assert not memory.path.with_name("faults.sqlite-wal").exists()
    assert len(service.list_entries(memory.path)) == 1


def test_another_file_at_its_place_is_read_and_one_that_is_gone_is_told(memory, tmp_path):
    memory.gateway.close()
    file = MemoryFile(memory.path)
    assert len(file.read(())["entries"]) == 1
    Store(tmp_path / "other.sqlite").close()
    (tmp_path / "other.sqlite").rename(memory.path)
    assert file.read(())["entries"] == []
    memory.path.unlink()
    assert "No such file" in file.read(())["error"]
    file.close()
