"""Interface of every bus."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, Self

import numpy as np
from numpy.typing import NDArray

from gateway.bus.frames import Frames
from gateway_fdi.errors import BusError

#: Wait before frames are offered again to a queue that was full [s].
RETRY_S = 0.001


@dataclass
class Statistics:
    """Counters of one bus since it was opened."""

    received: int = 0
    sent: int = 0
    overflow: int = 0  # lost in a queue before they were read
    rejected: int = 0  # input that was no frame
    refused: int = 0  # frames to send that this bus cannot carry
    driver_errors: int = 0  # exceptions of an adapter's driver, after which it was tried again


class Raw(Protocol):
    """A socket of ``struct can_frame``, of which a pump may receive, and to which it may send.

    Attributes:
        lost: frames lost in its queue so far, as the kernel counts them, modulo 2**32.
        losses: (place in the batch received last, frames lost right before it).
    """

    lost: int
    losses: list[tuple[int, int]]

    def fileno(self) -> int:
        """Return the socket."""

    def note(self, received: int, rejected: int, gaps: NDArray[np.int64]) -> None:
        """Count what a pump has received: frames, messages that were none, (place, frames lost before it)."""


class Bus(ABC):
    """A CAN bus; one thread uses it.

    Args:
        uri: as the user named it.
        index: stamped into every frame.

    Attributes:
        losses: (place in the batch received last, frames lost in a queue right before it).
        own_clock: whether its frames may be stamped by another clock than this machine's wall clock.
    """

    own_clock = False

    def __init__(self, uri: str, index: int) -> None:
        self.uri = uri
        self.index = index
        self.statistics = Statistics()
        self.losses: list[tuple[int, int]] = []

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
            BusError: the bus is gone, and all that it had received has been taken.
        """

    @property
    def raw(self) -> Raw | None:
        """The receiver of its socket, where a pump may take its place; None: only :meth:`receive` receives."""
        return None

    @abstractmethod
    def send(self, frames: Frames) -> int:
        """Send frames, in order, without waiting; returns how many the bus took.

        The rest finds the queue full, and is to be sent again later. Frames that this bus can never carry are
        counted (``statistics.refused``) and taken.

        Raises:
            BusError: the bus is gone.
        """

    def set_filters(self, can_ids: Sequence[int] | None) -> None:  # noqa: B027 - a hint may be ignored
        """Ask for these identifiers only (with EXTENDED), None: for all; a hint, others may still come."""

    def set_echo(self, on: bool) -> bool:
        """Ask for what this bus sends itself, too, flagged OWN once it is on the bus.

        Returns:
            whether that comes; else the sender knows only that it was taken.
        """
        return False

    @abstractmethod
    def close(self) -> None:
        """Close the bus; more than once does no harm."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def send_all(bus: Bus, frames: Frames, *, patience_s: float = 5.0) -> None:
    """Send frames, waiting while the queue of the bus is full.

    Raises:
        BusError: the bus is gone, or took nothing for this time [s].
    """
    limit = time.monotonic() + patience_s
    while len(frames):
        taken = bus.send(frames)
        frames = frames[taken:]
        if taken:
            limit = time.monotonic() + patience_s
        elif time.monotonic() > limit:
            raise BusError(f"{bus.uri}: the bus takes no frames")
        if len(frames):
            time.sleep(RETRY_S)
