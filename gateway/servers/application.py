"""The contract of what answers requests, whichever transport put them together."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence

from gateway.common.times import NEVER
from gateway.faults.entries import DtcChange


class Application(ABC):
    """Takes whole requests and gives whole responses; knows no frames, no bus and no clock."""

    #: Service identifiers that are its own where it shares an address with UDS.
    services = range(0)

    @abstractmethod
    def answer(self, request: bytes, functional: bool, t_ns: int) -> list[bytes]:
        """Return the responses to a request, in order; none where it is to stay silent.

        Args:
            request: with its service identifier, not empty.
            functional: whether it was meant for every server.
            t_ns: now.
        """

    def pending(self, request: bytes) -> list[bytes]:
        """Return what tells a tester to wait for the answer to a request; none where this cannot be told."""
        return []

    def hold(self, busy: bool, t_ns: int) -> None:
        """Take whether a request or a response is under way: a session does not end meanwhile (ISO 14229-2, S3)."""
        return

    def on_changes(self, changes: Sequence[DtcChange], t_ns: int) -> list[bytes]:
        """Take changes that are durable; returns the responses that were asked for on them."""
        return []

    def pass_time(self, t_ns: int) -> list[bytes]:
        """Let time pass; returns the responses that were still to come."""
        return []

    @property
    def next_ns(self) -> int:
        """Time at which :meth:`pass_time` has something to do next."""
        return NEVER
