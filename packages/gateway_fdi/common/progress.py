"""Listeners to the compilation of kernels: a start never stands silent. This imports nothing."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

#: Called with the name of the entry that is compiled, the kernels that are lowered, and how many there are. The last
#: call has ``done > total``: it is ready.
Listener = Callable[[str, int, int], None]

_listeners: list[Listener] = []


def _say_nothing(_text: str) -> None:
    """Take a line of a process without listeners."""


#: Takes a line for people about what costs time, but is not wrong; the command line sets it.
say: Callable[[str], None] = _say_nothing


def listen(listener: Listener) -> None:
    """Have a listener called from now on."""
    _listeners.append(listener)


@contextmanager
def compiling(name: str, total: int) -> Iterator[Callable[[str], None]]:
    """Tell the listeners of one entry; yields what is to be called with each kernel that was lowered."""
    done = 0

    def tell(at: int) -> None:
        for listener in list(_listeners):
            listener(name, at, total)

    def lowered(_kernel: str) -> None:
        nonlocal done
        done += 1
        tell(min(done, total))

    tell(0)
    try:
        yield lowered
    finally:
        tell(total + 1)
