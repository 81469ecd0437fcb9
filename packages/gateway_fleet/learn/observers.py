"""Observers that other packages bring: ``gateway learn`` shows their values beside a message's signals."""

from __future__ import annotations

from typing import ClassVar, Protocol, Self, cast

import numpy as np
from numpy.typing import NDArray

from gateway.common.plugins import Registry


class Observer(Protocol):
    """Follows the frames of one message.

    Attributes:
        topic: of what it tells, a key of the summary, e.g. ``wheels``.
    """

    topic: ClassVar[str]

    @classmethod
    def of(cls, message: str, signals: list[str]) -> Self | None:
        """Return one for a message, None if it has nothing to see in it.

        Args:
            message: its name.
            signals: of the message, in the order of the columns of :meth:`add`.
        """

    def begin(self) -> None:
        """Begin another log."""

    def add(self, values: NDArray[np.float64]) -> None:
        """Take frames: their signals, shape (frames, signals); NaN in frames that cannot be decoded."""

    def told(self) -> str:
        """Return what it saw, for people."""


def _accepted(found: object, name: str) -> type[Observer]:
    del name
    return cast("type[Observer]", found)


OBSERVERS: Registry[type[Observer]] = Registry("gateway.observers", _accepted)
