"""What every bus can do."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import Self

from gateway.bus.frames import Frames


@dataclass
class Statistics:
    """Counters of one bus since it was opened."""

    received: int = 0
    sent: int = 0
    overflow: int = 0  # lost in a queue before they were read
    rejected: int = 0  # input that was no frame


class Bus(ABC):
    """A CAN bus; one thread uses it.

    Args:
        uri: as the user named it.
        index: stamped into every frame.
    """

    def __init__(self, uri: str, index: int) -> None:
        self.uri = uri
        self.index = index
        self.statistics = Statistics()

    @abstractmethod
    def fileno(self) -> int:
        """Return a descriptor that is readable when :meth:`receive` has work."""

    @abstractmethod
    def receive(self, out: Frames) -> int:
        """Take what has come, without waiting.

        Args:
            out: batch to fill from its beginning.

        Returns:
            how many frames; as many as ``out`` holds means there may be more.

        Raises:
            BusError: the bus is gone.
        """

    @abstractmethod
    def send(self, frames: Frames) -> None:
        """Send frames, in order.

        Raises:
            BusError: the bus did not take them.
        """

    def set_filters(self, can_ids: Sequence[int]) -> None:  # noqa: B027 - a hint may be ignored
        """Ask for these identifiers only (with EXTENDED); a hint, others may still come."""

    @abstractmethod
    def close(self) -> None:
        """Close the bus; more than once does no harm."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        value: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()
