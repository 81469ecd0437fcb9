"""What people see while kernels are compiled: a bar in a terminal, in a pipe a line at once and one every 5 s."""

from __future__ import annotations

import sys
import time
from typing import Any

from gateway.common import progress

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
        """Tell how far one entry is (see :data:`gateway.jit.progress.Listener`)."""
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


def tell_of_kernels() -> None:
    """Have this process tell what it compiles, and what is wrong with its cache."""
    progress.listen(CompileProgress())
    progress.say = say


def say(text: str) -> None:
    """Tell a person something that is not data."""
    print(text, file=sys.stderr, flush=True)
