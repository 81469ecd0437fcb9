"""Waiting for sockets: a selector that another may wait for in turn, where the system has such a thing."""

from __future__ import annotations

import select
import selectors
import time
from collections.abc import Sequence
from typing import TYPE_CHECKING

#: In place of a descriptor: none tells, so that it must be asked.
NONE = -1


class _Asked(selectors.SelectSelector):
    """Windows' own: it is no descriptor itself, and can wait for nothing only by sleeping."""

    def fileno(self) -> int:
        return NONE

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        if self.get_map():
            return super().select(timeout)
        time.sleep(timeout or 0.0)
        return []


if TYPE_CHECKING:
    Selector = selectors.EpollSelector
else:
    #: A selector; its ``fileno`` is a descriptor that is readable when it has something, NONE where there is none.
    Selector = selectors.DefaultSelector if hasattr(selectors.DefaultSelector, "fileno") else _Asked


def readable(descriptors: Sequence[int], patience_s: float) -> list[int]:
    """Wait until descriptors are readable; returns which are: none, if this time [s] was over before."""
    if descriptors:
        return select.select(descriptors, [], [], patience_s)[0]
    time.sleep(patience_s)  # Windows waits for no empty list
    return []
