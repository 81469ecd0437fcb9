"""Budget of processor time: so long a door or a server works for its peers before the others have their turn."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from selectors import SelectorKey

#: Time of one turn, of a door or of a server [s]: with all of them it is below what a tester waits (P2, 50 ms).
TURN_S = 0.01


class Budget:
    """The time of one turn. Work beyond it waits for the next one.

    Args:
        seconds: processor time of this thread, so that a machine that is busy with other things changes nothing [s].

    Attributes:
        put_off: how often something had to wait.
    """

    def __init__(self, seconds: float = TURN_S) -> None:
        self._seconds, self._until = seconds, 0.0
        self._last = -1
        self.put_off = 0

    def begin(self) -> None:
        """Begin a turn."""
        self._until = time.thread_time() + self._seconds

    @property
    def over(self) -> bool:
        """Whether the turn's time is over."""
        return time.thread_time() >= self._until

    def among(self, ready: Sequence[tuple[SelectorKey, int]]) -> Iterator[tuple[SelectorKey, int]]:
        """Begin a turn, and yield who is ready while there is time: at least one, and who had to wait comes first.

        Args:
            ready: as a selector gives it.
        """
        self.begin()
        last = self._last
        in_order = sorted(ready, key=lambda each: (each[0].fd <= last, each[0].fd)) if len(ready) > 1 else ready
        for k, each in enumerate(in_order, start=1):
            self._last = each[0].fd
            yield each
            if k < len(in_order) and self.over:
                self.put_off += 1
                return
