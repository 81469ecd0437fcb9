"""The socket on which other processes report test results: packets of JSON, each answered (docs/report.md).

The kernel names the process that connects (SO_PEERCRED), :mod:`gateway_serve.external_reports` what it may report. All
of it is done in the daemon's loop, without waiting, and only a little each turn, so that frames hardly wait: further
reports wait in the kernel's queue, and then their sender waits.
"""

from __future__ import annotations

import selectors
import socket
import sys
from pathlib import Path

from gateway.bus.frames import Frames
from gateway.common.budget import Budget
from gateway.common.jsonlines import line
from gateway.faults.external_faults import ReportParams
from gateway.host.sockets import credentials_of, groups_of, listen_at, remove
from gateway.host.waiting import Selector
from gateway.live.listening_sockets import ListeningSockets
from gateway.report.words import MOST_BYTES, REFUSALS
from gateway.runtime.app import Gateway
from gateway_fdi.common.log import get_logger
from gateway_fdi.errors import UnsupportedError
from gateway_serve.external_reports import ExternalReports

#: Reports of all connections in one turn of the loop.
MOST_IN_A_TURN = 32
#: Time that a connection is not heard after a report that was refused for its sender's fault [s].
PAUSE_S = 0.01
#: Reasons for the pause: a sender of too much or of nonsense does not keep the loop busy.
_PAUSING = {"malformed", "unknown_fault", "not_allowed", "rate", "data", "internal"}
_FAILED = {"ok": False, "refused": "internal", "why": REFUSALS["internal"]}
_TURNED_AWAY = line({"ok": False, "refused": "not_allowed", "why": REFUSALS["not_allowed"]}).encode()

log = get_logger(__name__)


class _Connection:
    """One process; ``waiting``: an answer that it has no room for, before which nothing more of it is heard."""

    def __init__(self, made: socket.socket, number: int) -> None:
        self.socket, self.number = made, number
        self.waiting = b""

    def __str__(self) -> str:
        return f"connection {self.number}"


class ReportSocket:
    """Listens for reporters.

    Args:
        params: the table ``[report]``.
        gateway: that takes the reports.

    Attributes:
        params: the same.
        refused: connections beyond the most.

    Raises:
        InputError: another process listens there, or something else is at this path.
        UnsupportedError: this system cannot say who connects.
    """

    name = "report"

    def __init__(self, params: ReportParams, gateway: Gateway) -> None:
        if not sys.platform.startswith("linux"):
            raise UnsupportedError("[report]: only Linux says which process reports")
        self.params, self._gateway = params, gateway
        self._wall = gateway.fence.wall(self.name)
        self._path = Path(params.socket)
        self._connections: list[_Connection] = []
        self._paused: dict[_Connection, float] = {}  # until when
        self.refused = 0
        self._open()
        self._say_strangers()

    @property
    def _reports(self) -> ExternalReports:
        found = self._gateway.reports
        assert isinstance(found, ExternalReports), "made for a gateway to come: replace() comes first"
        return found

    def _open(self) -> None:
        mode = self.params.mode_of_socket
        self._selector, self._budget = Selector(), Budget()
        self._socket = listen_at(self._path, "report socket", kind=socket.SOCK_SEQPACKET, mode=mode)
        self._inode = self._path.stat().st_ino
        self._listening = ListeningSockets(self._selector, "report socket: a reporter cannot be taken")
        self._listening.add(self._socket)

    def _say_strangers(self) -> None:
        for reporter in self.params.reporter:
            for lacking in reporter.strangers():
                log.error("this machine does not have who may report", reporter=reporter.name, who=lacking)

    def fileno(self) -> int:
        """Return a descriptor that is readable when a process reports or comes."""
        return self._selector.fileno()

    def listening(self) -> bool:
        """Return whether a connection waits for a short time to pass."""
        return bool(self._paused)

    def on_frames(self, frames: Frames) -> None:
        """Frames are nothing to it."""

    def fits(self, params: ReportParams | None) -> bool:
        """Return whether it can be that of another configuration: same path."""
        return params is not None and params.socket == self.params.socket

    def replace(self, gateway: Gateway, params: ReportParams) -> None:
        """Give the reports to another gateway from now on; the connections stay."""
        self._gateway, self.params, self._wall = gateway, params, gateway.fence.wall(self.name)
        self._path.chmod(params.mode_of_socket)
        self._say_strangers()

    def turn(self, now_s: float, *, wanted: bool = True) -> None:
        """Take what has come, without waiting.

        Args:
            now_s: of a clock that is never set [s].
            wanted: whether the descriptor was readable.
        """
        reports = self._reports
        if not reports.begun:
            return  # no time to stamp a report with
        if reports.is_due:
            self._wall.keep(reports.pass_time, of="all reporters")
        self._listening.turn(now_s)
        for connection in [each for each, until_s in self._paused.items() if now_s >= until_s]:
            del self._paused[connection]
            self._selector.register(connection.socket, _events_of(connection), connection)
            wanted = True
        if not wanted:
            return
        ready = self._selector.select(0)
        room = max(MOST_IN_A_TURN // max(len(ready), 1), 1)
        for key, _ in self._budget.among(ready):
            if key.fileobj is self._socket:
                self._wall.keep(self._accept, of="no reporter yet", ends=self._listening.rest)
            else:
                self._wall.keep(self._hear, key.data, room, now_s, of=key.data, ends=self._drop)

    def restart(self) -> None:
        """End all connections, and listen again.

        Raises:
            InputError: something else is at its path now.
        """
        self.close()
        self._open()

    def close(self) -> None:
        """End all connections."""
        for connection in self._connections:
            self._wall.keep(self._reports.let_go, connection.number, of=connection)
            connection.socket.close()
        self._connections.clear()
        self._paused.clear()
        self._selector.close()
        self._socket.close()
        remove(self._path, self._inode)

    def _accept(self) -> None:
        taken = self._listening.accept(self._socket)
        if taken is None:
            return
        made, _ = taken
        if len(self._connections) >= self.params.connections:
            self.refused += 1
            if self.refused == 1:
                log.warning("report socket: too many connections, one refused", most=self.params.connections)
            made.close()
            return
        self._wall.keep(self._take, made, of="a reporter", ends=lambda _: made.close())

    def _take(self, made: socket.socket) -> None:
        pid, uid, gid = credentials_of(made)
        number = self._reports.enter(uid, {gid, *groups_of(made)}, pid)
        if number is None:
            self._send(made, _TURNED_AWAY)
            made.close()
            return
        self._connections.append(_Connection(made, number))
        self._selector.register(made, selectors.EVENT_READ, self._connections[-1])

    def _hear(self, connection: _Connection, room: int, now_s: float) -> None:
        if connection.waiting:
            if not self._send(connection.socket, connection.waiting):
                return
            connection.waiting = b""
            self._selector.modify(connection.socket, selectors.EVENT_READ, connection)
        for _ in range(room):
            try:
                packet = connection.socket.recv(MOST_BYTES + 1)
            except BlockingIOError:
                return
            except ConnectionResetError:
                continue  # it has ended with answers unread; its earlier reports still come
            except OSError:
                packet = b""
            if not packet:
                self._drop(connection)
                return
            take, number = self._reports.take, connection.number
            answer = self._wall.keep(take, number, packet, now_s, of=connection, instead=_FAILED)
            data = line(answer).encode()
            if not self._send(connection.socket, data):
                connection.waiting = data
                self._selector.modify(connection.socket, selectors.EVENT_WRITE, connection)
                return
            if answer.get("refused") in _PAUSING:
                self._selector.unregister(connection.socket)
                self._paused[connection] = now_s + PAUSE_S
                return

    def _send(self, to: socket.socket, data: bytes) -> bool:
        """Send an answer; returns whether there was room for it, or its receiver is gone."""
        try:
            to.send(data, socket.MSG_NOSIGNAL)
        except BlockingIOError:
            return False
        except OSError:
            return True  # it has ended; its earlier reports still come
        return True

    def _drop(self, connection: _Connection) -> None:
        """Forget a connection, whatever is wrong with it."""
        if connection not in self._connections:
            return
        self._connections.remove(connection)
        if self._paused.pop(connection, None) is None:
            self._wall.keep(self._selector.unregister, connection.socket, of=connection)
        self._wall.keep(self._reports.leave, connection.number, of=connection)
        connection.socket.close()


def _events_of(connection: _Connection) -> int:
    return selectors.EVENT_WRITE if connection.waiting else selectors.EVENT_READ
