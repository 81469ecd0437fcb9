"""Counter debounce: many test results in, few qualified verdicts out.

It runs inside the jitted loop because it sees every test result of every monitor; the fault memory
sees only the changes. As in AUTOSAR DEM the internal counter runs between two thresholds, and the fault
detection counter of ISO 14229-1 Annex D is that counter scaled: -128 qualified passed, +127 qualified
failed, clamped at both ends.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from gateway.engine.events import QUALIFIED_FAILED, QUALIFIED_PASSED, RESULT_CHANGED
from gateway.jit import i4, kernel, record, u1
from gateway.monitors.shape import FAILED, NOT_TESTED, PASSED, Debounce

#: Debounce of one fault: thresholds and jumps; counter, last result, last verdict.
DEBOUNCE = record(
    failed_after=i4,
    passed_after=i4,
    counter=i4,
    jump_up=u1,
    jump_down=u1,
    last=u1,
    verdict=u1,
    bus=u1,
)


def configure(row: np.void, debounce: Debounce) -> None:
    """Fill the constants of one row."""
    row["failed_after"] = debounce.failed_after
    row["passed_after"] = debounce.passed_after
    row["jump_up"] = debounce.jump_up
    row["jump_down"] = debounce.jump_down


@kernel
def fault_detection_counter(d: Any) -> int:
    """Return the counter scaled to -128..127: the ends mean a qualified verdict, and only they do."""
    if d.counter >= 0:
        return int(d.counter * 127 // d.failed_after)
    return -int(-d.counter * 128 // d.passed_after)


@kernel
def count(d: Any, result: int) -> int:
    """Count one test result of a fault; returns the kind of event it makes, 0 for none.

    Args:
        d: record of :data:`DEBOUNCE`.
        result: PASSED or FAILED.
    """
    changed = d.last != result
    d.last = result
    if result == FAILED:
        if d.jump_up == 1 and d.counter < 0:
            d.counter = 0
        if d.counter < d.failed_after:
            d.counter += 1
        if d.counter == d.failed_after and d.verdict != FAILED:
            d.verdict = FAILED
            return QUALIFIED_FAILED
    else:
        if d.jump_down == 1 and d.counter > 0:
            d.counter = 0
        if d.counter > -d.passed_after:
            d.counter -= 1
        if d.counter == -d.passed_after and d.verdict != PASSED:
            d.verdict = PASSED
            return QUALIFIED_PASSED
    return RESULT_CHANGED if changed else 0


@kernel
def reset(d: Any) -> None:
    """Start anew: at the start of an operation cycle, and when the fault is cleared."""
    d.counter = 0
    d.last = NOT_TESTED
    d.verdict = NOT_TESTED
