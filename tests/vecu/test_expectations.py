"""What is said of a scenario's DTCs, to the word: set, healed, late, early, never, not expected."""

import pytest

from gateway_bench.vecu.expectations import Judge
from gateway_bench.vecu.scenario import Scenario

DTC, OTHER = "P0336-39", "U0100-87"
FAILED, PASSED = 0x2F, 0x2E
WANT = [{"dtc": DTC, "after_s": 0.5, "by_s": 1.0, "healed_by_s": 1.5}]
BY = f"{DTC} set after 0.5 s by 1 s"
HEALED = f"{DTC} healed by 1.5 s"
SET, ABSENT = (0.75, DTC, FAILED, 1), [{"dtc": OTHER, "absent": True}]
OLD = [(-1, DTC, PASSED, 3), (0.75, DTC, PASSED, 3)]
AGAIN = [SET, (1.0, DTC, PASSED, 1), (1.125, DTC, FAILED, 2)]

#: What is expected; reports: time [s], DTC, status, occurrence; lines; what is still waited for [s].
CASES = [
    (WANT, [], [(False, f"{DTC} not set by 1.0 s", BY)], 1.0),
    ([{"dtc": DTC}], [], [(False, f"{DTC} not set by 2.0 s", f"{DTC} set")], 0.0),
    ([{"dtc": DTC}], [(2.0, DTC, FAILED, 1)], [(True, f"{DTC} set at 2.000 s", f"{DTC} set")], 0.0),
    (
        WANT,
        [SET, (1.25, DTC, PASSED, 1)],
        [(True, f"{DTC} set at 0.750 s", BY), (True, f"{DTC} healed at 1.250 s", HEALED)],
        0.0,
    ),
    (
        WANT,
        [(0.5, DTC, FAILED, 1), (1.5, DTC, PASSED, 1)],
        [(True, f"{DTC} set at 0.500 s", BY), (True, f"{DTC} healed at 1.500 s", HEALED)],
        0.0,
    ),
    (
        WANT,
        [SET],
        [(True, f"{DTC} set at 0.750 s", BY), (False, f"{DTC} not healed by 1.5 s, set at 0.750 s", HEALED)],
        1.5,
    ),
    (
        WANT,
        [SET, (1.75, DTC, PASSED, 1)],
        [(True, f"{DTC} set at 0.750 s", BY), (False, f"{DTC} not healed by 1.5 s, but at 1.750 s", HEALED)],
        0.0,
    ),
    (WANT, [(1.25, DTC, FAILED, 1)], [(False, f"{DTC} not set by 1.0 s, but at 1.250 s", BY)], 1.5),
    (WANT, [(0.25, DTC, FAILED, 1)], [(False, f"{DTC} set at 0.250 s, before 0.5 s", BY)], 1.0),
    # Stored from an earlier drive, and not set in this one; then its occurrence counts.
    (WANT, OLD, [(False, f"{DTC} not set by 1.0 s", BY)], 1.0),
    (
        WANT,
        [*OLD, (0.875, DTC, PASSED, 4)],
        [(True, f"{DTC} set at 0.875 s", BY), (True, f"{DTC} healed at 0.875 s", HEALED)],
        0.0,
    ),
    (
        [{"dtc": DTC}],
        [(-1, DTC, FAILED, 3), (0.5, DTC, FAILED, 3)],
        [(False, f"{DTC} not set by 2.0 s", f"{DTC} set")],
        0.0,
    ),
    # Set again after it healed, to the end; and healed again.
    (
        WANT,
        AGAIN,
        [(True, f"{DTC} set at 0.750 s", BY), (False, f"{DTC} not healed by 1.5 s, set at 0.750 s", HEALED)],
        1.5,
    ),
    (
        WANT,
        [*AGAIN, (1.875, DTC, PASSED, 2)],
        [(True, f"{DTC} set at 0.750 s", BY), (True, f"{DTC} healed at 1.000 s", HEALED)],
        0.0,
    ),
    # After the drive the ECUs are switched off.
    (
        WANT,
        [SET, (1.25, DTC, PASSED, 1), (2.25, DTC, FAILED, 2)],
        [(True, f"{DTC} set at 0.750 s", BY), (True, f"{DTC} healed at 1.250 s", HEALED)],
        1.5,
    ),
    (
        [],
        [(2.0, OTHER, FAILED, 1), (0.5, DTC, PASSED, 0)],
        [(False, f"{OTHER} set at 2.000 s, not expected", "no other DTC")],
        0.0,
    ),
    ([], [(2.25, OTHER, FAILED, 1)], [], 0.0),
    (ABSENT, [(2.25, OTHER, FAILED, 1)], [(True, f"{OTHER} never set", f"{OTHER} never set")], 0.0),
    (ABSENT, [], [(True, f"{OTHER} never set", f"{OTHER} never set")], 0.0),
    (
        ABSENT,
        [(2.0, OTHER, FAILED, 1)],
        [(False, f"{OTHER} set at 2.000 s, should never be", f"{OTHER} never set")],
        0.0,
    ),
]


def judge(expect, reports, **more):
    made = Judge(Scenario(name="s", duration_s=2.0, ecu=[{"type": "restbus"}], expect=expect, **more))
    for report in reports:
        made.report(*report)
    return made


@pytest.mark.parametrize(("expect", "reports", "lines", "waits_s"), CASES)
def test_the_verdict_line_by_line(expect, reports, lines, waits_s):
    made = judge(expect, reports)
    assert [(one.good, one.text, one.expected) for one in made.findings()] == lines
    assert made.waits_until_s == waits_s


def test_other_dtcs_may_be_allowed():
    assert judge([], [(0.5, OTHER, FAILED, 1)], unexpected="allow").findings() == []
