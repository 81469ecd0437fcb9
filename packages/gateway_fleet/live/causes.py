"""Causes that a gateway tells, counted each time they come."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from gateway_fleet.live.tables import proven


class CauseCount:
    """Counts causes that a diagnosis has proven and the one before had not.

    Attributes:
        told: until now.
    """

    def __init__(self) -> None:
        self.told = 0
        self._before: set[str] = set()

    def take(self, event: Mapping[str, Any]) -> None:
        """Take an event of the contract."""
        causes = proven(event)
        if causes is not None:
            self.told += len(set(causes) - self._before)
            self._before = set(causes)
