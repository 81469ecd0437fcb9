"""Test results of other processes: the contract of the package that takes them; without one nobody reports."""

from __future__ import annotations

from typing import Any

#: Names of the calls that make what takes the reports, and the socket.
REPORTS, REPORT_SOCKET = "external_reports", "report_socket"


class Reports:
    """Takes no reports."""

    def succeed(self, old: Reports) -> None:
        """Go on where those of another configuration stop: same connections, same counts."""

    def states(self) -> list[dict[str, Any]]:
        """Return how the reporters do: counts by outcome."""
        return []

    def counters(self) -> dict[str, int]:
        """Return what was counted, by name."""
        return {}
