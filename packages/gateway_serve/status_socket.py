"""The status socket: a unix socket on which a daemon shows what it does, and takes commands of who may open it.

A process that may open it (mode 0600: of its owner, or root) may read and intervene; :mod:`gateway_serve` puts HTTP and
rights before it, in another process. All of it is done in the daemon's loop, between two batches, without waiting:

- Out, a line of JSON each, of some with ``size`` bytes after it: ``hello`` (what there is to see), ``event`` (the JSON
  contract), ``tick`` (20 times a second, buckets as rows of :class:`gateway.engine.buckets.TickRow`), ``buses`` (twice
  a second), ``messages`` (once a second), ``answer``. ``protocol`` in the first line is 1.
- In, a line of JSON each: see :mod:`gateway_serve.status_commands`.

A reader that does not keep up misses ticks and the like, which are counted and told to it, and no event; one that
leaves events lying beyond :data:`MOST_BYTES` is sent away. Without a reader nothing is counted and nothing encoded.
"""

from __future__ import annotations

import selectors
import socket
from collections import deque
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gateway.bus.frames import Frames
from gateway.bus.traffic import Traffic
from gateway.common.budget import Budget
from gateway.common.jsonlines import line
from gateway.engine.buckets import TickRow
from gateway.host.sockets import credentials_of, listen_at, remove
from gateway.host.waiting import Selector
from gateway.live.listening_sockets import ListeningSockets
from gateway.runtime.app import Gateway
from gateway_fdi.common.log import get_logger
from gateway_serve.hello import described
from gateway_serve.status_commands import Commands, monitoring_of

#: Readers at a time.
READERS = 8
#: A reader with this much unread gets no ticks [byte].
ENOUGH_BYTES = 256 << 10
#: One with this much unread, all of it events, is sent away [byte].
MOST_BYTES = 4 << 20
#: Longest line that a reader may send, and most that is read or sent at once [byte]; lines of one that wait.
LINE_BYTES, CHUNK_BYTES, MOST_LINES = 64 << 10, 64 << 10, 16
#: How often what is shown [s].
TICK_S, BUSES_S, MESSAGES_S = 0.05, 0.5, 1.0
#: No detection counter is this.
_NEVER_TOLD = 999
#: Identifiers that are shown.
MOST_MESSAGES = 2048

log = get_logger(__name__)


class _Reader:
    """One connection."""

    def __init__(self, connection: socket.socket, number: int) -> None:
        self.socket, self.number = connection, number
        self.uid = credentials_of(connection)[1]
        self.heard = bytearray()
        self.lines: deque[bytes] = deque()
        self.waiting: deque[bytes] = deque()
        self.bytes = 0
        self.missed = 0
        self.behind = False  # waits until its socket takes more

    def __str__(self) -> str:
        return f"reader {self.number}, uid {self.uid}"

    def put(self, data: bytes) -> None:
        self.waiting.append(data)
        self.bytes += len(data)


class StatusSocket:
    """Listens for readers, and serves them.

    Args:
        path: of the socket.
        gateway: that is shown.
        buses: returns how the buses do, as events of the JSON contract.
        readers: most at a time.

    Attributes:
        sent_away: readers that did not take their events, or asked too much.
        refused: connections beyond the most.

    Raises:
        InputError: another process listens there, or something else is at this path.
    """

    name = "status"

    def __init__(
        self,
        path: Path,
        gateway: Gateway,
        buses: Callable[[], Sequence[dict[str, Any]]] = lambda: (),
        *,
        readers: int = READERS,
    ) -> None:
        self.path, self._most = path, readers
        self._buses = buses
        self._readers: list[_Reader] = []
        self._pending: list[_Reader] = []  # of whom commands wait
        self._due = [0.0, 0.0, 0.0]
        self._count = 0
        self._ended, self._ended_s = "", 0.0
        self.sent_away = self.refused = self.ticks = 0
        self._open()
        self.replace(gateway)

    def _open(self) -> None:
        self._selector, self._budget = Selector(), Budget()
        self._socket = listen_at(self.path)
        self._inode = self.path.stat().st_ino
        self._listening = ListeningSockets(self._selector, "status socket: a reader cannot be taken")
        self._listening.add(self._socket)

    def fileno(self) -> int:
        """Return a descriptor that is readable when a reader wants something, or can take more."""
        return self._selector.fileno()

    def replace(self, gateway: Gateway) -> None:
        """Show another gateway from now on; the readers are told what there is now."""
        self._gateway, self._wall = gateway, gateway.fence.wall(self.name)
        self._commands = Commands(gateway, self._say, self._wall)
        for reader in self._readers:
            self._commands.enter(reader.number, reader.uid)
        self._traffic = Traffic(len(gateway.config.bus))
        self._greet()

    def end(self, text: str) -> None:
        """Tell the readers, and those that come later, that the shown run has ended; they can still look at it.

        Args:
            text: the part that has ended, a sentence for people.
        """
        self._ended = text
        self._greet()

    def listening(self) -> bool:
        """Return whether there is a reader."""
        return bool(self._readers)

    def on_frames(self, frames: Frames) -> None:
        """Count frames on the buses while there is a reader."""
        if self._readers:
            self._traffic.write(frames)

    def report(self, event: dict[str, Any]) -> None:
        """Pass on an event of the JSON contract."""
        if self._readers:
            self._wall.keep(self._report, event, of="an event")

    def _report(self, event: dict[str, Any]) -> None:
        self._send(_message("event", event=event), event=True)

    def turn(self, now_s: float, *, wanted: bool = True) -> None:
        """Serve the readers, without waiting.

        Args:
            now_s: of a clock that is never set [s].
            wanted: whether the descriptor was readable.
        """
        self._listening.turn(now_s)
        if wanted:
            for key, mask in self._budget.among(self._selector.select(0)):
                if key.fileobj is self._socket:
                    self._wall.keep(self._accept, of="no reader yet", ends=self._listening.rest)
                else:
                    self._wall.keep(self._attend, key.data, mask, of=key.data, ends=self._drop)
        if not self._readers:
            return
        if self._ended:
            self._poll_alone(now_s)
        self._wall.keep(self._commands.pass_time, now_s, of="sessions of readers")
        for k, (every_s, show) in enumerate(
            ((TICK_S, self._tick), (BUSES_S, self._show_buses), (MESSAGES_S, self._show_messages))
        ):
            if now_s >= self._due[k]:
                self._due[k] = now_s + every_s
                self._wall.keep(show, of="all readers")
        if self._pending and not self._gateway.writing:
            reader = self._pending.pop(0)
            self._wall.keep(self._obey, reader, of=reader, ends=self._drop)
        for reader in list(self._readers):
            if reader.bytes > 2 * MOST_BYTES:  # it asks and asks
                self._send_away(reader, "does not take what it gets")
            elif reader.waiting and not reader.behind:
                self._wall.keep(self._flush, reader, of=reader, ends=self._drop)

    def restart(self) -> None:
        """Send all readers away, and listen again.

        Raises:
            InputError: something else is at its path now.
        """
        self.close()
        self._open()

    def close(self) -> None:
        """Send what the readers take at once, and close."""
        for reader in list(self._readers):
            self._wall.keep(self._flush, reader, of=reader)
        for reader in list(self._readers):
            self._drop(reader)
        self._selector.close()
        self._socket.close()
        remove(self.path, self._inode)

    def _poll_alone(self, now_s: float) -> None:
        """Have requests answered after the run, when no one lets time pass; nothing goes to a bus."""
        self._ended_s = self._ended_s or now_s
        self._gateway.poll(self._gateway.engine.now_ns + round((now_s - self._ended_s) * 1e9))

    # Readers

    def _attend(self, reader: _Reader, mask: int) -> None:
        if mask & selectors.EVENT_WRITE and reader in self._readers:
            self._flush(reader)
        if mask & selectors.EVENT_READ and reader in self._readers:
            self._hear(reader)

    def _accept(self) -> None:
        taken = self._listening.accept(self._socket)
        if taken is None:
            return
        connection, _ = taken
        if len(self._readers) >= self._most:
            self.refused += 1
            log.warning("status socket: too many readers, one refused", most=self._most, refused=self.refused)
            connection.close()
            return
        self._wall.keep(self._take, connection, of="a reader", ends=lambda _: connection.close())

    def _take(self, connection: socket.socket) -> None:
        self._count += 1
        reader = _Reader(connection, self._count)
        if not self._readers:  # earlier results were shown to no reader, and have no known time
            self._gateway.engine.take_buckets()
            self._traffic = Traffic(len(self._gateway.config.bus))
            self._due = [0.0, 0.0, 0.0]
        self._report_all_counters()
        self._readers.append(reader)
        self._wall.keep(self._greet_one, reader, of=reader, ends=self._drop)

    def _greet_one(self, reader: _Reader) -> None:
        self._selector.register(reader.socket, selectors.EVENT_READ, reader)
        self._commands.enter(reader.number, reader.uid)
        reader.put(self._greeting())

    def _hear(self, reader: _Reader) -> None:
        try:
            data = reader.socket.recv(CHUNK_BYTES)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            self._drop(reader)
            return
        reader.heard += data
        *lines, rest = bytes(reader.heard).split(b"\n")
        reader.heard[:] = rest
        reader.lines.extend(lines)
        if len(reader.lines) > MOST_LINES or max(len(rest), *map(len, lines), 0) > LINE_BYTES:
            self._send_away(reader, "asks too much")
        elif reader.lines and reader not in self._pending:
            self._pending.append(reader)

    def _obey(self, reader: _Reader) -> None:
        """Do one command; there is one a turn."""
        answer = self._commands.answer(reader.lines.popleft(), reader.number)
        if answer is not None:
            reader.put(_message("answer", **answer))
        if reader.lines:
            self._pending.append(reader)

    def _say(self, number: int, kind: str, fields: dict[str, Any]) -> None:
        """Tell one reader, if it is there still."""
        for reader in self._readers:
            if reader.number == number:
                reader.put(_message(kind, **fields))

    def _send(self, data: bytes, *, event: bool = False) -> None:
        for reader in list(self._readers):
            if not event and reader.bytes > ENOUGH_BYTES:
                reader.missed += 1
            elif reader.bytes > MOST_BYTES:
                self._send_away(reader, "does not take what it gets")
            else:
                reader.put(data)

    def _send_away(self, reader: _Reader, why: str) -> None:
        self.sent_away += 1
        log.warning(f"status socket: a reader {why}, sent away", reader=reader.number)
        self._drop(reader)

    def _flush(self, reader: _Reader) -> None:
        room = CHUNK_BYTES
        try:
            while reader.waiting and room > 0:
                data = reader.waiting[0]
                sent = reader.socket.send(data[:CHUNK_BYTES])
                reader.bytes -= sent
                room -= sent
                if sent == len(data):
                    reader.waiting.popleft()
                else:
                    reader.waiting[0] = data[sent:]
        except BlockingIOError:
            pass
        except OSError:
            self._drop(reader)
            return
        if bool(reader.waiting) != reader.behind:
            reader.behind = bool(reader.waiting)
            events = selectors.EVENT_READ | (selectors.EVENT_WRITE if reader.behind else 0)
            self._selector.modify(reader.socket, events, reader)

    def _drop(self, reader: _Reader) -> None:
        """Forget a reader, whatever is wrong with it."""
        if reader not in self._readers:
            return
        self._readers.remove(reader)
        if reader in self._pending:
            self._pending.remove(reader)
        for step, what in ((self._selector.unregister, reader.socket), (self._commands.leave, reader.number)):
            self._wall.keep(step, what, of=reader)
        self._wall.keep(reader.socket.close, of=reader)

    # Contents for readers

    def _greet(self) -> None:
        """Tell all readers what there is to see now."""
        self._hello: dict[str, Any] = {}
        self._report_all_counters()
        for reader in self._readers:
            reader.put(self._greeting())

    def _greeting(self) -> bytes:
        if not self._hello:
            self._hello = {**described(self._gateway), "ended": self._ended}
        return _message("hello", **self._hello, monitoring=monitoring_of(self._gateway))

    def _report_all_counters(self) -> None:
        """Have the next tick tell the detection counters of all faults, not of those only that have changed."""
        self._counters = np.full(len(self._gateway.engine.faults), _NEVER_TOLD, np.int16)

    def _tick(self) -> None:
        engine = self._gateway.engine
        buckets, counters = engine.take_buckets(), engine.fault_detection_counters()
        told = np.flatnonzero((buckets["count"] > 0) | (counters != self._counters))
        self._counters = counters.astype(np.int16)
        rows = np.zeros(len(told), TickRow.dtype)
        for name in buckets.dtype.names or ():
            rows[name] = buckets[name][told]
        rows["fault"], rows["fdc"] = told, counters[told]
        self.ticks += 1
        t_ns = engine.wall_ns(engine.now_ns)
        self._send(_message("tick", rows.tobytes(), t_ns=t_ns, number=self.ticks, rows=len(rows)))

    def _show_buses(self) -> None:
        engine = self._gateway.engine
        told = []
        states = {state["bus"]: state for state in self._buses()}
        for k, bus in enumerate(self._gateway.config.bus):
            load = self._traffic.loads[k]
            counted = {name: int(load[name]) for name in load.dtype.names}
            errors = {name: count for name, count in engine.error_counters(k).items() if count}
            state = {**states.get(bus.name, {}), "activity": engine.activity(k)}
            told.append({"bus": bus.name, **state, "traffic": counted, "errors": errors})
        t_ns, counters = engine.wall_ns(engine.now_ns), engine.counters()
        monitoring = monitoring_of(self._gateway)
        self._send(
            _message(
                "buses",
                t_ns=t_ns,
                buses=told,
                counters=counters,
                receive=monitoring["receive"],
                monitoring=monitoring,
                reporters=self._gateway.reports.states(),
                ecus=self._gateway.asking.states(),
                exceptions={"first": self._gateway.fence.first, "second": self._gateway.fence.second},
            )
        )
        for reader in self._readers:
            if reader.missed and reader.bytes <= ENOUGH_BYTES:
                reader.put(_message("missed", count=reader.missed))
                reader.missed = 0
                self._report_all_counters()  # some of the changes were in what it missed

    def _show_messages(self) -> None:
        engine = self._gateway.engine
        rows = self._traffic.identifiers()
        data = np.ascontiguousarray(rows[:MOST_MESSAGES]).tobytes()
        t_ns = engine.wall_ns(engine.now_ns)
        told = min(len(rows), MOST_MESSAGES)
        left_out = len(rows) - told
        self._send(_message("messages", data, t_ns=t_ns, offset_ns=engine.offset_ns, rows=told, left_out=left_out))


def _message(kind: str, data: bytes = b"", **fields: Any) -> bytes:
    if data:
        fields["size"] = len(data)
    return line({"kind": kind, **fields}).encode() + b"\n" + data
