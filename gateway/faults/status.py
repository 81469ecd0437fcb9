"""The DTC status byte (ISO 14229-1, Annex D.2): its bits and how they change. There is no other.

Each transition is a total function of the status and what happened; counters that it needs (cycles with
a failure) are handed in and out, so that a store can keep them.
"""

from __future__ import annotations

from enum import IntFlag


class Status(IntFlag):
    """Bits of the status byte."""

    TEST_FAILED = 0x01
    TEST_FAILED_THIS_CYCLE = 0x02
    PENDING_DTC = 0x04
    CONFIRMED_DTC = 0x08
    NOT_COMPLETED_SINCE_CLEAR = 0x10
    FAILED_SINCE_CLEAR = 0x20
    NOT_COMPLETED_THIS_CYCLE = 0x40
    WARNING_INDICATOR = 0x80


#: The bits that only tell whether the test has run to its end.
NOT_COMPLETED = Status.NOT_COMPLETED_SINCE_CLEAR | Status.NOT_COMPLETED_THIS_CYCLE
#: Status at the first start and after a clear.
CLEARED = NOT_COMPLETED


def on_passed(status: Status) -> Status:
    """Return the status after a qualified pass: the test is complete and does not fail now."""
    return status & ~(NOT_COMPLETED | Status.TEST_FAILED)


def on_failed(
    status: Status, failed_cycles: int, *, confirm_cycles: int, indicator: bool
) -> tuple[Status, int]:
    """Return the status and the failed-cycle counter after a qualified failure.

    Args:
        status: before.
        failed_cycles: consecutive completed cycles that failed, this one not counted yet.
        confirm_cycles: failed cycles that confirm the DTC; 1 confirms at the first failure.
        indicator: whether a confirmed DTC asks for the warning indicator.
    """
    if not status & Status.TEST_FAILED_THIS_CYCLE:
        failed_cycles += 1
    status &= ~NOT_COMPLETED
    status |= (
        Status.TEST_FAILED
        | Status.TEST_FAILED_THIS_CYCLE
        | Status.PENDING_DTC
        | Status.FAILED_SINCE_CLEAR
    )
    if failed_cycles >= confirm_cycles:
        status |= Status.CONFIRMED_DTC
        if indicator:
            status |= Status.WARNING_INDICATOR
    return status, failed_cycles


def on_cycle_start(status: Status) -> Status:
    """Return the status at the start of an operation cycle.

    testFailed is kept: ISO 14229-1 leaves its reset at a new cycle to the manufacturer, and a fault that
    was there when the engine stopped is taken to be there until a test says otherwise.
    """
    return (status & ~Status.TEST_FAILED_THIS_CYCLE) | Status.NOT_COMPLETED_THIS_CYCLE


def on_cycle_end(status: Status, failed_cycles: int) -> tuple[Status, int]:
    """Return the status and the failed-cycle counter at the end of an operation cycle.

    A cycle in which the test completed and never failed ends the pending state; one in which it did not
    complete changes nothing.
    """
    completed = not status & Status.NOT_COMPLETED_THIS_CYCLE
    if completed and not status & Status.TEST_FAILED_THIS_CYCLE:
        return status & ~Status.PENDING_DTC, 0
    return status, failed_cycles
