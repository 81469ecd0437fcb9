"""Lines to ECUs behind the gateway, as servers with routes see them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol


class Line(Protocol):
    """The line to an ECU."""

    name: str

    @property
    def part_ms(self) -> int:
        """How long a request may wait for it [ms]."""

    @property
    def is_open(self) -> bool:
        """Whether the ECU can be reached now."""

    def ask(self, request: bytes, owner: object, done: Callable[[bytes | None], None]) -> bool:
        """Have a request sent; returns whether there is room for it. ``done`` takes each answer; None: none comes."""

    def forget(self, owner: object) -> None:
        """Take out what a tester that has gone had asked."""

    def is_quiet(self, request: bytes) -> bool:
        """Return whether no good answer comes to a request."""


class Lines(Protocol):
    """The lines to all ECUs."""

    @property
    def askable(self) -> Sequence[str]:
        """Names of the ECUs that may be asked."""

    def line(self, name: str, requests_per_s: float | None = None) -> Line:
        """Return the line to an ECU; ``requests_per_s``: most of all testers together, None: that of other lines."""
