"""Sockets that listen in the daemon's loop; without descriptors they rest, and the loop does not turn for nothing."""

from __future__ import annotations

import selectors
import socket
from typing import Any

from gateway_fdi.common.log import get_logger

#: Time that no connection is taken where no descriptors are left [s].
REST_S = 1.0

log = get_logger(__name__)


class ListeningSockets:
    """Sockets of one door.

    Args:
        selector: of the door; it has each socket while that is listened at.
        what: message of the log where a connection cannot be taken.
    """

    def __init__(self, selector: selectors.BaseSelector, what: str) -> None:
        self._selector, self._what = selector, what
        self._sockets: dict[socket.socket, Any] = {}
        self._now_s = 0.0
        self._rests_until: float | None = None

    def add(self, made: socket.socket, data: Any = None) -> None:
        """Listen at a socket, too; ``data``: what the selector gives with it."""
        self._sockets[made] = data
        self._selector.register(made, selectors.EVENT_READ, data)

    def turn(self, now_s: float) -> None:
        """Listen again after a rest; ``now_s``: of a clock that is never set [s]."""
        self._now_s = now_s
        if self._rests_until is not None and now_s >= self._rests_until:
            self._rests_until = None
            for made, data in self._sockets.items():
                self._selector.register(made, selectors.EVENT_READ, data)

    def rest(self, _: object = None) -> None:
        """Listen to none of them for a while: something failed of which no peer is known."""
        if self._rests_until is None:
            for each in self._sockets:
                self._selector.unregister(each)
        self._rests_until = self._now_s + REST_S

    def accept(self, listener: socket.socket) -> tuple[socket.socket, Any] | None:
        """Return the next connection, which never waits, and its other end's address; None: there is none now."""
        if self._rests_until is not None:  # since another socket of the same turn
            return None
        try:
            made, peer = listener.accept()
        except BlockingIOError:
            return None  # gone again
        except OSError as error:  # no descriptors left: the socket stays readable
            log.warning(self._what, reason=error.strerror)
            self.rest()
            return None
        made.setblocking(False)
        return made, peer
