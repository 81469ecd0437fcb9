"""A thread that works beside the gateway, one piece after the other, handed over with as little ado as there is.

The way to such a thread and back is part of each verdict's. ``concurrent.futures`` (a condition, a waiter, a work item,
a semaphore for each piece) takes two to three times as long as a queue and a lock.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from queue import SimpleQueue
from typing import Any, Protocol


class Work(Protocol):
    """A piece of work that is handed over, as a ``concurrent.futures.Future`` tells of it."""

    def done(self) -> bool:
        """Return whether it has ended."""

    def exception(self, timeout: float | None = None) -> BaseException | None:
        """Return what it raised, after waiting for its end.

        Raises:
            TimeoutError: it has not ended after this time [s].
        """

    def result(self, timeout: float | None = None) -> Any:
        """Wait for its end (see :meth:`exception`), and raise what it raised."""


class Writer(Protocol):
    """A worker for such work, as a ``concurrent.futures.Executor`` of one thread."""

    def submit(self, work: Callable[..., Any], /, *arguments: Any) -> Work:
        """Have it done after all that was asked for before."""

    def shutdown(self) -> None:
        """End, after all that was asked for."""


class _Piece:
    """A piece of work of a :class:`WriterThread`."""

    def __init__(self, work: Callable[..., Any], arguments: tuple[Any, ...]) -> None:
        self._work, self._arguments = work, arguments
        self._ended = False
        self._raised: BaseException | None = None
        self._end = threading.Lock()
        self._end.acquire()

    def run(self) -> None:
        """Do it."""
        try:
            self._work(*self._arguments)
        except BaseException as error:  # raised again for the caller that waits
            self._raised = error
        self._ended = True
        self._end.release()

    def done(self) -> bool:
        return self._ended

    def exception(self, timeout: float | None = None) -> BaseException | None:
        if not self._ended:
            if not self._end.acquire(timeout=-1 if timeout is None else timeout):
                raise TimeoutError
            self._end.release()
        return self._raised

    def result(self, timeout: float | None = None) -> None:
        error = self.exception(timeout)
        if error is not None:
            raise error


class WriterThread:
    """A :class:`Writer`: a thread that does not delay the end of its process; callers wait for its work."""

    def __init__(self, name: str) -> None:
        self._asked: SimpleQueue[_Piece | None] = SimpleQueue()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while (piece := self._asked.get()) is not None:
            piece.run()

    def submit(self, work: Callable[..., Any], /, *arguments: Any) -> _Piece:
        """Have it done after all that was asked for before."""
        piece = _Piece(work, arguments)
        self._asked.put(piece)
        return piece

    def shutdown(self) -> None:
        """End, after all that was asked for."""
        self._asked.put(None)
        self._thread.join()
