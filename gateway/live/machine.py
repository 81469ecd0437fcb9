"""The machine that a daemon runs on, as it uses it: given to it, so that tests can give another one."""

from __future__ import annotations

import sqlite3
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

from gateway.bus.base import Bus
from gateway.bus.uri import open_bus
from gateway.faults.store import Connect
from gateway.faults.writer_thread import Writer
from gateway.host.process import boot
from gateway.live.clock import Clock
from gateway.live.loop import TICK_S, collect_and_freeze
from gateway.runtime.persistence import PATIENCE_S, begin_writer


class Thread(Protocol):
    """A thread that has begun."""

    def is_alive(self) -> bool:
        """Return whether it works still."""

    def join(self) -> None:
        """Wait until it has ended."""


def begin_thread(work: Callable[[], None], name: str) -> Thread:
    """Begin a thread that no process waits for when it ends."""
    thread = threading.Thread(target=work, name=name, daemon=True)
    thread.start()
    return thread


def open_at_once(uri: str, index: int) -> Bus:
    """Open a bus, without waiting for one that is not there."""
    return open_bus(uri, index, patience_s=0.0)


@dataclass(frozen=True)
class Machine:
    """Clocks, buses, threads and the disk.

    Attributes:
        clock: the engine's.
        monotonic: for waits and for periodic work [s].
        sleep: waits for a time [s].
        boot: names the machine's boot; "": not known.
        open_bus: opens a bus: URI and index.
        begin_thread: begins a thread: its work and its name.
        begin_writer: begins the thread that writes the fault memory; None: the loop's own writes it.
        patience_s: how long a single write of that thread is waited for [s].
        connect: opens the fault memory, as ``sqlite3.connect`` does.
        tick_s: longest wait without traffic while something else than time is waited for [s]; 0: never wait.
        settle: called when everything is built (False) or replaced (True): the garbage collector is to look through
            little after it.
    """

    clock: Clock = field(default_factory=Clock)
    monotonic: Callable[[], float] = time.monotonic
    sleep: Callable[[float], None] = time.sleep
    boot: Callable[[], str] = boot
    open_bus: Callable[[str, int], Bus] = open_at_once
    begin_thread: Callable[[Callable[[], None], str], Thread] = begin_thread
    begin_writer: Callable[[], Writer] | None = begin_writer
    patience_s: float = PATIENCE_S
    connect: Connect = sqlite3.connect
    tick_s: float = TICK_S
    settle: Callable[[bool], None] = collect_and_freeze
