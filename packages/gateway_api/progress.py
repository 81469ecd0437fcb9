"""How far a long work is: a bar in a notebook or a terminal, or whatever the caller makes of it."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, TypeAlias

#: True: a bar; a function that is called with the share done, 0 to 1; False: nothing.
Progress: TypeAlias = "bool | Callable[[float], object]"
#: Least share between two looks at a bar.
STEP = 0.01


@contextmanager
def shown(progress: Progress) -> Iterator[Callable[[float], None]]:
    """Yield what is to be told the share done; a bar is gone at the end."""
    if callable(progress):
        called = progress

        def call(share: float) -> None:
            called(share)

        yield call
        return
    if not progress:
        yield lambda share: None
        return
    bar = _notebook() or _Line()
    last = -1.0

    def report(share: float) -> None:
        nonlocal last
        if abs(share - last) >= STEP:
            last = share
            bar.show(min(share, 1.0))

    try:
        yield report
    finally:
        bar.clear()


class _Line:
    """A line on stderr, where a person looks at it."""

    def __init__(self) -> None:
        self._seen = sys.stderr.isatty()

    def show(self, share: float) -> None:
        if self._seen:
            print(f"\r{'#' * round(40 * share):<40} {share:4.0%}", end="", file=sys.stderr, flush=True)

    def clear(self) -> None:
        if self._seen:
            print("\r\033[K", end="", file=sys.stderr, flush=True)


class _Cell:
    """A bar in a notebook's cell."""

    def __init__(self, display: Callable[..., Any]) -> None:
        self._handle = display({"text/plain": ""}, raw=True, display_id=True)

    def show(self, share: float) -> None:
        html = f'<progress value="{share:.3f}" max="1"></progress> {share:.0%}'
        self._handle.update({"text/html": html, "text/plain": f"{share:.0%}"}, raw=True)

    def clear(self) -> None:
        self._handle.update({"text/html": "", "text/plain": ""}, raw=True)


def _notebook() -> _Cell | None:
    """Return a bar of the notebook in which this runs; None: it runs in none. IPython is not loaded for it."""
    ipython = sys.modules.get("IPython")
    shell = None if ipython is None else ipython.get_ipython()
    if shell is None or not hasattr(shell, "kernel"):
        return None
    from IPython.display import display  # noqa: PLC0415 - of the host, where it is loaded already

    return _Cell(display)
