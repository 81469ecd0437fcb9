"""A descriptor that one thread makes readable for another that waits."""

from __future__ import annotations

import os
import socket
from contextlib import suppress


class Waker:
    """A descriptor that is readable from :meth:`wake` to :meth:`rest`: of Linux an event, else two sockets."""

    def __init__(self) -> None:
        self._pair: tuple[socket.socket, socket.socket] | None = None
        if hasattr(os, "eventfd"):
            self._event = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
            return
        self._pair = socket.socketpair()
        for each in self._pair:
            each.setblocking(False)
        self._event = self._pair[0].fileno()

    def fileno(self) -> int:
        """Return the descriptor."""
        return self._event

    def wake(self) -> None:
        """Make it readable."""
        with suppress(BlockingIOError):  # it is, many times over
            if self._pair is None:
                os.eventfd_write(self._event, 1)
            else:
                self._pair[1].send(b"!")

    def rest(self) -> None:
        """Make it wait again."""
        with suppress(BlockingIOError):
            if self._pair is None:
                os.eventfd_read(self._event)
                return
            while self._pair[0].recv(4096):
                pass

    def close(self) -> None:
        """Give it back."""
        if self._pair is None:
            os.close(self._event)
            return
        for each in self._pair:
            each.close()
