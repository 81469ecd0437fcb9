"""The DTC status byte (ISO 14229-1, Annex D.2): its bits and how they change. There is no other.

Each transition is a total function of the status, its counters of cycles, and the event; a store keeps both.
Healing and aging as AUTOSAR DEM has them: the warning indicator goes out after passed cycles in a row, and only
then cycles without a failure count towards aging, which ends the confirmed state.
"""

from __future__ import annotations

from enum import IntFlag
from typing import NamedTuple

#: Counters of cycles stop here.
MOST_CYCLES = 255


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

#: Every status byte as a :class:`Status`. Flags are slow to make and to combine, and a storm changes thousands a
#: second: the transitions count in plain numbers.
STATUS = tuple(Status(value) for value in range(256))
_FAILED_BITS = int(Status.TEST_FAILED | Status.TEST_FAILED_THIS_CYCLE | Status.PENDING_DTC | Status.FAILED_SINCE_CLEAR)
_PENDING, _CONFIRMED, _LIT = int(Status.PENDING_DTC), int(Status.CONFIRMED_DTC), int(Status.WARNING_INDICATOR)
_FAILED_THIS_CYCLE = int(Status.TEST_FAILED_THIS_CYCLE)
_COMPLETE = 0xFF & ~int(NOT_COMPLETED)
#: Bits that a qualified pass leaves as they are: the test is complete and does not fail now.
PASSED = _COMPLETE & ~int(Status.TEST_FAILED)


class Rules(NamedTuple):
    """How many cycles confirm, heal and age a DTC, and whether it asks for the warning indicator."""

    confirm_cycles: int = 1
    healing_cycles: int = 3
    aging_cycles: int = 40
    indicator: bool = False


class Cycles(NamedTuple):
    """Counters of cycles that the transitions need.

    Attributes:
        failed: cycles in a row, among the completed ones, that failed.
        passed: completed cycles in a row, since the last failure, that did not fail.
        aged: cycles counted towards aging.
    """

    failed: int = 0
    passed: int = 0
    aged: int = 0


def on_passed(status: Status) -> Status:
    """Return the status after a qualified pass: the test is complete and does not fail now."""
    return STATUS[int(status) & PASSED]


def on_failed(status: Status, cycles: Cycles, rules: Rules, *, wait: bool = False) -> tuple[Status, Cycles]:
    """Return the status and the counters after a qualified failure.

    ``rules.confirm_cycles`` 1 confirms at the first failure.

    Args:
        status: before.
        cycles: before.
        rules: of the fault.
        wait: whether a DTC that is not confirmed yet stays so for now (see :func:`on_awaited`).
    """
    value, failed = int(status), cycles.failed
    if not value & _FAILED_THIS_CYCLE:
        failed = min(failed + 1, MOST_CYCLES)
    value = value & _COMPLETE | _FAILED_BITS
    if failed >= rules.confirm_cycles and (value & _CONFIRMED or not wait):
        value |= _CONFIRMED
        if rules.indicator:
            value |= _LIT
    return STATUS[value], Cycles(failed=failed)


def on_awaited(status: Status, cycles: Cycles, rules: Rules) -> Status:
    """Return the status when a confirmation waits no longer: confirmed, unless a whole cycle has passed well."""
    value = int(status)
    if value & _PENDING and cycles.failed >= rules.confirm_cycles:
        value |= _CONFIRMED | (_LIT if rules.indicator else 0)
    return STATUS[value]


def on_cycle_start(status: Status) -> Status:
    """Return the status at the start of an operation cycle.

    testFailed is kept: ISO 14229-1 leaves its reset at a new cycle to the manufacturer, and a fault that
    was there when the engine stopped is taken to be there until a test says otherwise.
    """
    return (status & ~Status.TEST_FAILED_THIS_CYCLE) | Status.NOT_COMPLETED_THIS_CYCLE


def _passed_this_cycle(status: Status) -> bool:
    return not status & (Status.NOT_COMPLETED_THIS_CYCLE | Status.TEST_FAILED_THIS_CYCLE)


def on_cycle_end(status: Status, cycles: Cycles, rules: Rules) -> tuple[Status, Cycles]:
    """Return the status and the counters at the end of an operation cycle.

    A cycle in which the test completed and never failed ends the pending state and counts towards healing; one
    in which it did not complete changes nothing.
    """
    if not _passed_this_cycle(status):
        return status, cycles
    passed = min(cycles.passed + 1, MOST_CYCLES)
    if passed >= rules.healing_cycles:
        status &= ~Status.WARNING_INDICATOR
    return status & ~Status.PENDING_DTC, cycles._replace(failed=0, passed=passed)


def on_aging_cycle_end(status: Status, cycles: Cycles, rules: Rules) -> tuple[Status, Cycles, bool]:
    """Return the status, the counters, and whether the DTC has aged away, at the end of an aging cycle.

    Judged by the status before :func:`on_cycle_end` of the same moment, so that the cycle that heals does not
    age: a cycle counts if its test passed in it and the DTC was neither pending nor lit before.
    """
    lit = status & (Status.WARNING_INDICATOR | Status.PENDING_DTC | Status.TEST_FAILED)
    if lit or not _passed_this_cycle(status):
        return status, cycles, False
    aged = cycles.aged + 1
    if aged < rules.aging_cycles:
        return status, cycles._replace(aged=aged), False
    return status & ~Status.CONFIRMED_DTC, Cycles(), True


def on_displaced(status: Status) -> Status:
    """Return the status of a DTC whose entry had to give way to another: it is no longer in the memory."""
    return status & ~(Status.PENDING_DTC | Status.CONFIRMED_DTC | Status.WARNING_INDICATOR)
