"""Present contents of the page, and the open pages that get them."""

from __future__ import annotations

import asyncio
import itertools
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from gateway.common.fence import Fence
from gateway.common.jsonlines import line
from gateway.engine.buckets import TickRow
from gateway.faults.records import Recording
from gateway_fdi.common.log import get_logger
from gateway_serve.buses import BusLoads
from gateway_serve.history import History
from gateway_serve.link import StatusLink
from gateway_serve.memory import BITS, MemoryFile, shown
from gateway_serve.messages import MessageNames
from gateway_serve.words import unit_of

#: Reason of a gateway that nobody has tried to reach.
NOT_YET = "not reached yet"
#: Events that a page gets when it comes.
EVENTS = 300
#: Messages that wait for one page at most, and of them those that the next of their kind makes needless.
MOST_WAITING, MOST_PASSING = 2000, 40
#: Events that do not wait for a tick.
MANY_EVENTS = 100
PASSING = {"tick", "buses", "messages"}
#: Messages of which the latest says all.
STATES = {"memory", "link", "monitoring", "ecus"}
#: Least time between two looks into the fault memory's file, and longest [s].
READ_S, LOOK_S = 0.1, 2.0
#: Kinds of events that the page lists.
LISTED = {
    "dtc",
    "diagnosis",
    "symptoms",
    "clear",
    "cycle",
    "intervention",
    "bus",
    "clock",
    "memory",
    "restart",
    "config",
    "injected",
    "reporter",
    "ecu_dtc",
    "security",
}

#: State of the switches where none has been used.
ALL_ON: dict[str, Any] = {"on": True, "dtcs": True, "receive": True, "send": True, "by": []}

log = get_logger(__name__)
T = TypeVar("T")


class Viewer:
    """One page that is open, and the messages that wait for it.

    Where it does not keep up, ticks and the like are given up, and of a state the latest is told; events are not given
    up.
    """

    def __init__(self) -> None:
        self.waiting: deque[tuple[str, str]] = deque()
        self.newest: dict[str, str] = {}
        self.news = asyncio.Event()
        self.ended = False
        self.ticks = 0
        self._past: Iterator[str] | None = None

    def begin(self, state: str, tests: str, past: Iterator[str]) -> None:
        """Tell all there is, its verdict first, and then, piece by piece as they are taken, the columns of the past."""
        self.newest.clear()  # the state has them
        self.put("state", state)
        self.put("tests", tests)
        self._past = past

    def put(self, kind: str, text: str) -> None:
        """Add a message."""
        if kind in STATES:
            self.newest[kind] = text
            self.news.set()
            return
        if kind in PASSING and self.ticks > MOST_PASSING:
            return  # the next one says more
        if len(self.waiting) >= MOST_WAITING:
            self.end()  # it comes again, and gets all there is
            return
        self.ticks += kind in PASSING
        self.waiting.append((kind, text))
        # Events come with the next tick: many of them are one piece of work then.
        if kind != "event" or len(self.waiting) >= MANY_EVENTS:
            self.news.set()

    def end(self) -> None:
        """End its stream."""
        self.ended = True
        self.news.set()

    def take(self) -> list[tuple[str, str]]:
        """Take what waits, and a piece of the past."""
        taken = [*self.waiting, *self.newest.items()]
        self.waiting.clear()
        self.newest.clear()
        self.ticks = 0
        piece = None if self._past is None else next(self._past, None)
        if piece is None:
            self._past = None
            self.news.clear()
        else:
            taken.append(("history", piece))
        return taken


class Hub:
    """Listens to a daemon, and tells viewers."""

    def __init__(self, socket: Path) -> None:
        self.fence = Fence()
        self._wall = self.fence.wall("gateway")
        self.link = StatusLink(socket, self._on_message, self._on_link, self._wall)
        self.connected, self.reason = False, NOT_YET
        self.hello: dict[str, Any] = {
            "name": "", "faults": [], "buses": [], "version": "", "memory": None, "ended": "", "ecus": [],
            "identifiers": [], "levels": [], "s3_s": 5.0, "signals": [],
        }  # fmt: skip
        self.memory_file = MemoryFile(None)
        self.memory: dict[str, Any] = self.memory_file.read(())
        self.buses: list[dict[str, Any]] = []
        self.counters: dict[str, int] = {}
        self.exceptions: dict[str, dict[str, int]] = {}  # of the daemon, by wall and door
        self.reporters: list[dict[str, Any]] = []
        self.ecus: list[dict[str, Any]] = []
        self.security: dict[tuple[str, str], dict[str, Any]] = {}  # the last event of each sensor and kind
        self.monitoring: dict[str, Any] = dict(ALL_ON)
        self.messages: list[dict[str, Any]] = []
        self._left_out = 0  # identifiers that are on the buses, and are not told
        self.history = History(0)
        self.latest: dict[int, dict[str, Any]] = {}
        self.worst: dict[int, float] = {}  # since the metrics were read
        self.events: deque[dict[str, Any]] = deque(maxlen=EVENTS)
        self.missed = self.refused = 0
        self._names, self._loads = MessageNames(()), BusLoads(())
        self._takes = {
            "hello": self._on_hello,
            "tick": self._on_tick,
            "event": self._on_event,
            "buses": self._on_buses,
            "messages": self._on_messages,
            "missed": self._on_missed,
            "answer": self._take_monitoring,
        }
        self._viewers: set[Viewer] = set()
        self.ending = False
        self._number = itertools.count(1)
        self._stale = asyncio.Event()
        # One thread, and no more: each has a heap of its own, which keeps memory that SQLite has freed.
        self._thread = ThreadPoolExecutor(1, "memory")

    async def run(self) -> None:
        """Listen until cancelled. An error of this process is told to the pages: they are out of date from then on."""
        try:
            await asyncio.gather(self.link.run(), self._read_memory())
        except Exception as error:
            log.error("this process does not follow the gateway any more", reason=repr(error))
            self._on_link(False, f"an error of the page's server: {error!r}")
            raise

    def open(self) -> Viewer:
        """Begin to tell a page; the first message is all there is."""
        viewer = Viewer()
        viewer.begin(self._state(), self._tests(), self.history.past())
        if self.ending:
            viewer.end()
        self._viewers.add(viewer)
        return viewer

    def close(self, viewer: Viewer) -> None:
        """End telling a page."""
        self._viewers.discard(viewer)

    def end(self) -> None:
        """End telling all pages: their streams end, and so do those of pages that come now."""
        self.ending = True
        for viewer in self._viewers:
            viewer.end()

    @property
    def viewers(self) -> int:
        """Pages that are open."""
        return len(self._viewers)

    def on_refused(self, _: int) -> None:
        """Count a request that was refused."""
        self.refused += 1

    def ask_memory(self) -> None:
        """Have the fault memory's file read soon."""
        self._stale.set()

    async def read_memory(self) -> dict[str, Any]:
        """Return the contents of the fault memory's file as it is now."""
        return await self._in_thread(self.memory_file.read, self.hello["faults"])

    async def interventions(self) -> list[dict[str, Any]]:
        """Return what testers did, the oldest first."""
        return await self._in_thread(self.memory_file.interventions)

    async def recordings(self, dtc: str) -> list[Recording]:
        """Return the recordings of a DTC, the oldest first; none, where there is no entry of it."""
        return await self._in_thread(self.memory_file.recordings, dtc)

    def unit(self, signal: str) -> str | None:
        """Return the unit of a signal by its full name, by the databases; None: it has none, or is not in them."""
        return self._names.unit(signal)

    async def recording(self, dtc: str, number: int) -> Recording | None:
        """Return a recording as :meth:`MemoryFile.recording` does."""
        return await self._in_thread(self.memory_file.recording, dtc, number)

    async def _in_thread(self, work: Callable[..., T], *arguments: Any) -> T:
        return await asyncio.get_running_loop().run_in_executor(self._thread, work, *arguments)

    def _state(self) -> str:
        return line(
            {
                "connected": self.connected,
                "reason": self.reason,
                "hello": {key: self.hello.get(key) for key in ("name", "version", "ended")},
                "bits": BITS,
                "memory": shown(self.memory),
                "buses": self.buses,
                "monitoring": self.monitoring,
                "ecus": self.ecus,
                "messages": {"messages": self.messages, "left_out": self._left_out},
                "events": list(self.events),
                "wrong": self._names.wrong,
            }
        )

    def _tests(self) -> str:
        """Return what a page knows of each test; texts, which many have in common, by their places."""
        texts: dict[str, int] = {}
        tests = [
            [fault["id"], fault["dtc"], fault["monitor"], fault.get("ecu", "")]
            + [texts.setdefault(text, len(texts)) for text in (fault["description"], unit_of(fault.get("tested", "")))]
            for fault in self.hello["faults"]
        ]
        return line({"tests": tests, "texts": list(texts), "latest": list(self.latest.values())})

    def _report(self, kind: str, value: Any) -> None:
        if self._viewers:
            text = line(value)
            for viewer in self._viewers:
                viewer.put(kind, text)

    def _on_link(self, connected: bool, reason: str) -> None:
        if (connected, reason) == (self.connected, self.reason):
            return
        if connected != self.connected:
            log.info("gateway reached" if connected else "gateway gone", reason=reason)
        self.connected, self.reason = connected, reason
        if not connected:
            self._thread.submit(self.memory_file.close)
        self._report("link", {"connected": connected, "reason": reason})

    def _on_message(self, message: dict[str, Any], block: bytes) -> None:
        take = self._takes.get(message["kind"])
        if take is not None:
            take(message, block)

    def _on_hello(self, message: dict[str, Any], _: bytes) -> None:
        old, new = ([fault["id"] for fault in hello["faults"]] for hello in (self.hello, message))
        path = message["memory"]
        file = MemoryFile(None if path is None else Path(path))
        names, loads = MessageNames(message["buses"]), BusLoads(message["buses"])
        memory = file.read(message["faults"])
        # From here on nothing fails: what is shown is of this message as a whole.
        told = {key: value for key, value in message.items() if key not in ("kind", "protocol", "monitoring")}
        self.hello = self.hello | told
        if new != old:
            self.history, self.latest, self.worst = History(len(new)), {}, {}
        self._thread.submit(self.memory_file.close)
        self.memory_file, self.memory, self._names, self._loads = file, memory, names, loads
        self.monitoring = message.get("monitoring", ALL_ON)
        state, tests = self._state(), self._tests()
        for viewer in self._viewers:
            viewer.begin(state, tests, self.history.past())

    def _on_tick(self, message: dict[str, Any], block: bytes) -> None:
        rows = np.frombuffer(block, TickRow.dtype)
        t_ms = message["t_ns"] / 1e6
        self.history.add(t_ms, rows)
        told = []
        for row in rows:
            fault = int(row["fault"])
            now = self.latest.setdefault(fault, {"fault": fault, "ratio": 0.0, "value": None, "threshold": None})
            now["fdc"], now["t_ms"] = int(row["fdc"]), t_ms
            if row["numbers"]:
                now.update(value=float(row["last"]), threshold=float(row["limit"]), ratio=float(row["ratio"]))
                self.worst[fault] = max(self.worst.get(fault, 0.0), float(row["ratio"]))
            told.append(
                [fault, int(row["fdc"]), int(row["count"]), int(row["failed"])]
                + [float(f"{row[name]:.9g}") for name in ("low", "high", "last", "limit", "ratio", "worst")]
                + [int(row["numbers"]), row["worst_ns"] / 1e6]
            )
        self._report("tick", {"t": t_ms, "rows": told})

    def _on_event(self, message: dict[str, Any], _: bytes) -> None:
        if message["event"]["event"] == "monitor":
            return  # ticks say more of it, and there may be thousands a second
        event = dict(message["event"], number=next(self._number))
        event["t_ms"] = event.get("t_ns", 0) / 1e6
        if event["event"] == "security":
            self.security[event["sensor"], event["kind"]] = event
        if event["event"] in LISTED:
            self.events.append(event)
        self._stale.set()
        self._report("event", event)

    def _on_buses(self, message: dict[str, Any], _: bytes) -> None:
        self.buses, self.counters = self._loads.shown(message), message["counters"]
        self.reporters, self.exceptions = message.get("reporters", []), message.get("exceptions", {})
        ecus = message.get("ecus", [])
        if ecus != self.ecus:
            self.ecus = ecus
            self._report("ecus", ecus)
        self._report("buses", self.buses)
        self._take_monitoring(message, b"")

    def _take_monitoring(self, message: dict[str, Any], _: bytes) -> None:
        found = message.get("monitoring", self.monitoring)
        if found != self.monitoring:
            self.monitoring = found
            self._report("monitoring", found)

    def _on_messages(self, message: dict[str, Any], block: bytes) -> None:
        self.messages = self._names.shown(block, message["t_ns"] - message["offset_ns"])
        self._left_out = message.get("left_out", 0)
        self._report("messages", {"messages": self.messages, "left_out": self._left_out})

    def _on_missed(self, message: dict[str, Any], _: bytes) -> None:
        self.missed += message["count"]
        log.warning("this process does not keep up with the gateway; it missed", ticks=message["count"])

    async def _read_memory(self) -> None:
        while True:
            try:
                await asyncio.wait_for(self._stale.wait(), LOOK_S)
            except TimeoutError:
                if not self.connected:
                    continue
            self._stale.clear()
            try:
                await self._read_memory_once()
            except Exception as error:  # it is read again
                self._wall.caught(error, "fault memory's file")
            await asyncio.sleep(READ_S)

    async def _read_memory_once(self) -> None:
        file, faults = self.memory_file, self.hello["faults"]
        found = await self._in_thread(file.read, faults)
        if not self.connected:
            self._thread.submit(file.close)
        if file is self.memory_file and found != self.memory:
            self.memory = found
            self._report("memory", shown(found))
