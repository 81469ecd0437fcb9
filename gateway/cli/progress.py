"""Progress while kernels are compiled, or logs worked on: in a terminal it moves, in a pipe a line every 5 s."""

from __future__ import annotations

import sys
import time
from typing import Any

from gateway.cli.failure import on_stop
from gateway_fdi.common import progress

#: Time between two lines where no terminal is [s].
PERIOD_S = 5.0


class CompileProgress:
    """Tells of the kernels that are compiled, on stderr."""

    def __init__(self) -> None:
        self._terminal = sys.stderr.isatty()
        self._bar: Any = None
        self._task: Any = None
        self._said_s = float("-inf")
        self._entry = ""

    def __call__(self, name: str, done: int, total: int) -> None:
        """Tell how far one entry is (see :data:`gateway_fdi.jit.progress.Listener`)."""
        if self._terminal:
            self._draw(name, done, total)
        else:
            self._line(name, done, total)

    def _line(self, name: str, done: int, total: int) -> None:
        now = time.monotonic()
        if done > total or now - self._said_s < PERIOD_S:
            return
        first = self._said_s == float("-inf")
        self._said_s = now
        what = "its source has changed, or it is not shipped; next time it is loaded"
        print(
            f"compiling {name}: {done} of {total} functions" + (f" ({what})" if first else ""),
            file=sys.stderr,
            flush=True,
        )

    def _draw(self, name: str, done: int, total: int) -> None:
        if self._bar is None:
            self._begin()
        if self._entry != name:
            self._entry = name
            self._task = self._bar.add_task(f"compiling {name}", total=total)
        if done > total:
            self._bar.stop()
            self._bar = None
            self._entry = ""
        else:
            self._bar.update(self._task, completed=done)
            self._bar.refresh()

    def _begin(self) -> None:
        from rich.console import Console  # noqa: PLC0415 - only where something is compiled
        from rich.progress import BarColumn, Progress, TextColumn  # noqa: PLC0415

        self._bar = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            TextColumn("{task.completed} of {task.total}"),
            console=Console(stderr=True),
            auto_refresh=False,
            transient=True,
        )
        self._bar.start()


class LogsDone:
    """Tells how many of several logs are done, on stderr.

    Args:
        what: they are, if no logs.
        goes_on: whether the same command leaves out what is done.
    """

    def __init__(self, what: str = "logs", *, goes_on: bool = False) -> None:
        self._what = what
        again = "goes on with the others" if goes_on else "begins again"
        on_stop(lambda: f"{self._done} {what} are done; the same command {again}")
        self._begun_s = self._said_s = time.monotonic()
        self._done = self._frames = 0
        self._terminal = sys.stderr.isatty()

    def __call__(self, left: int, frames: int = 0) -> None:
        """Take one that is done.

        Args:
            left: logs that are not.
            frames: of it.
        """
        self._done += 1
        self._frames += frames
        now_s = time.monotonic()
        if left and now_s - self._said_s < (0.2 if self._terminal else PERIOD_S):
            return
        self._said_s = now_s
        text = f"{self._done} of {self._done + left} {self._what}"
        if self._frames:
            text += f", {self._frames / max(now_s - self._begun_s, 1e-9):,.0f} frames/s"
        if self._terminal:
            print(f"\r{text}\033[K", end="" if left else "\n", file=sys.stderr, flush=True)
        else:
            say(text)

    def clear(self) -> None:
        """Make room for other lines."""
        if self._terminal:
            print("\r\033[K", end="", file=sys.stderr, flush=True)


def report_compiling() -> None:
    """Have this process tell what it compiles, and the errors of its cache."""
    progress.listen(CompileProgress())
    progress.say = say


def say(text: str) -> None:
    """Tell a person something that is not data."""
    print(text, file=sys.stderr, flush=True)
