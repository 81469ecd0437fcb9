"""Requests that a diagnostic tester may make, by any protocol."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple, Protocol

from gateway.faults.interventions import Intervention
from gateway.faults.settings import ConditionSettings


class LatestResult(NamedTuple):
    """A fault's latest test result: value, limit, whether it failed."""

    value: float
    limit: float
    failed: bool


class TesterControl(Protocol):
    """The gateway, as the servers that testers speak to see it."""

    def knows(self, group: int) -> bool:
        """Return whether there is such a DTC or group."""

    def meets(self, conditions: Sequence[ConditionSettings]) -> bool:
        """Return whether signals are in their ranges now; one that is unknown or too old is not."""

    def note(self, intervention: Intervention) -> None:
        """Keep and tell what a tester did, or was refused; its time is now."""

    def clear(self, group: int) -> bool:
        """Clear one DTC or a group, durable on return; False if there is no such DTC or group.

        Raises:
            StoreError: it could not be written; nothing was cleared.
        """

    def set_dtcs(self, on: bool, by: str = "") -> None:
        """Let test results count, or not (ISO 14229-1, 0x85); they do when no tester has it off."""

    def set_communication(self, *, receive: bool, send: bool, by: str = "") -> None:
        """Switch normal communication (ISO 14229-1, 0x28); it is on when no tester has it off."""

    def restart_cycle(self) -> None:
        """End the operation cycle and begin the next one, as at key off and on."""

    def compact(self) -> None:
        """Check and compact the fault memory's file."""

    def fault_detection_counter(self, fault: str) -> int:
        """Return a fault's detection counter now, -128..127."""

    def fault_detection_counters(self) -> Mapping[str, int]:
        """Return the detection counters of all monitored faults now, -128..127."""

    def test_result(self, fault: str) -> LatestResult | None:
        """Return a fault's latest test result; None: not tested since the clear, or since the operation cycle began."""

    def wall_ns(self) -> int:
        """Return now, by the wall clock [ns]."""

    def value(self, name: str) -> float:
        """Return a signal's value now in its unit, NaN before the first."""
