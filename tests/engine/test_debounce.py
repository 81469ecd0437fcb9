"""The fault detection counter against a reference written from the definition."""

from fractions import Fraction
from math import ceil, floor

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from gateway.engine.debounce import (
    DebounceRow,
    configure,
    fault_detection_counter,
    hold,
    is_settled,
    jump_to_end,
    qualify_by_time,
    report_counter_based,
    report_time_based,
    reset,
)
from gateway.engine.events import QUALIFIED_FAILED, QUALIFIED_PASSED, RESULT_CHANGED
from gateway.monitors.contract import FAILED, PASSED, Debounce
from gateway_fdi.jit import zeros


def row(debounce):
    rows = zeros(1, DebounceRow)
    configure(rows[0], debounce)
    return rows


@pytest.mark.evidence("AUTOSAR DEM: debounce counter")
def test_counter_reaches_the_limits_in_the_asked_number_of_results():
    for number in (1, 2, 3, 7, 50, 100, 128, 300, 1000):
        rows = row(Debounce(failed_after=number, passed_after=number))
        kinds = [report_counter_based(rows[0], FAILED) for _ in range(number)]
        assert kinds[-1] == QUALIFIED_FAILED
        assert QUALIFIED_FAILED not in kinds[:-1]
        assert fault_detection_counter(rows[0], 0) == 127
        reset(rows[0])
        kinds = [report_counter_based(rows[0], PASSED) for _ in range(number)]
        assert kinds[-1] == QUALIFIED_PASSED
        assert QUALIFIED_PASSED not in kinds[:-1]
        assert fault_detection_counter(rows[0], 0) == -128


class Reference:
    """AUTOSAR DEM counter-based debounce; the FDC in exact fractions."""

    def __init__(self, debounce):
        self.d = debounce
        self.counter = 0
        self.verdict = None

    def take(self, failed):
        d, start = self.d, self.counter
        if failed:
            if d.jump_up and start < d.jump_up_to:
                start = d.jump_up_to
            self.counter = min(d.failed_after, start + d.failed_step)
        else:
            if d.jump_down and start > d.jump_down_to:
                start = d.jump_down_to
            self.counter = max(-d.passed_after, start - d.passed_step)
        ends = {self.d.failed_after: "failed", -self.d.passed_after: "passed"}
        verdict = ends.get(self.counter, self.verdict)
        changed = verdict != self.verdict
        self.verdict = verdict
        return verdict if changed else None

    def fdc(self):
        if self.counter >= 0:
            return floor(Fraction(127 * self.counter, self.d.failed_after))
        return ceil(Fraction(128 * self.counter, self.d.passed_after))


DEBOUNCES = st.builds(
    Debounce,
    failed_after=st.integers(1, 130),
    passed_after=st.integers(1, 130),
    jump_up=st.booleans(),
    jump_down=st.booleans(),
    failed_step=st.integers(1, 7),
    passed_step=st.integers(1, 7),
    jump_up_to=st.integers(-5, 5),
    jump_down_to=st.integers(-5, 5),
)


@pytest.mark.evidence("AUTOSAR DEM: debounce counter")
@given(
    DEBOUNCES,
    st.lists(st.booleans(), max_size=300),
)
def test_counter_follows_the_reference(debounce, results):
    rows = row(debounce)
    reference = Reference(debounce)
    last = None
    for failed in results:
        kind = report_counter_based(rows[0], FAILED if failed else PASSED)
        verdict = reference.take(failed)
        expected = {"failed": QUALIFIED_FAILED, "passed": QUALIFIED_PASSED}.get(verdict, 0)
        if expected == 0 and failed != last:
            expected = RESULT_CHANGED
        assert kind == expected
        fdc = fault_detection_counter(rows[0], 0)
        assert fdc == reference.fdc()
        assert -128 <= fdc <= 127
        last = failed


@example(Debounce(failed_after=10, passed_after=10), [(False, 12), (True, 1)])
@given(DEBOUNCES, st.lists(st.tuples(st.booleans(), st.integers(1, 200)), min_size=1, max_size=6))
def test_what_is_settled_one_more_pass_does_not_change(debounce, runs):
    rows = row(debounce)
    settled = 0
    for failed, count in [*runs, (False, 300)]:
        for _ in range(count):
            before, was_settled = rows.tobytes(), is_settled(rows[0])
            kind = report_counter_based(rows[0], FAILED if failed else PASSED)
            if was_settled and not failed:
                settled += 1
                assert (kind, rows.tobytes()) == (0, before)
    assert settled >= 300 - 261, "at the end it is, whatever came before"


@pytest.mark.evidence("AUTOSAR DEM: debounce time")
@given(
    st.integers(1, 1000),
    st.integers(1, 1000),
    st.lists(st.tuples(st.integers(0, 300), st.sampled_from("FPHN")), max_size=60),
)
def test_time_debounce_follows_a_reference(failed_ms, passed_ms, steps):
    """Results F and P, a hold H, nothing N; the reference adds up the time that each result has lasted."""
    rows = row(Debounce(failed_ms=failed_ms, passed_ms=passed_ms))
    d, now = rows[0], 0
    counter, direction, verdict = 0, None, None
    for wait, what in steps:
        end = now + wait * 10**6
        while d["deadline_ns"] <= end:
            due = int(d["deadline_ns"])
            kind = qualify_by_time(d, due)
            assert kind == (QUALIFIED_FAILED if direction == "F" else QUALIFIED_PASSED)
            verdict = direction
        if direction == "F":
            counter = min(counter + end - now, failed_ms * 10**6)
        elif direction == "P":
            counter = max(counter - (end - now), -passed_ms * 10**6)
        now = end
        expected = {failed_ms * 10**6: "F", -passed_ms * 10**6: "P"}.get(counter, verdict)
        assert verdict == expected, "a verdict comes exactly when its time is over"
        if what == "H":
            hold(d, now)
            direction = None
        elif what in "FP":
            report_time_based(d, now, FAILED if what == "F" else PASSED)
            if direction != what:
                counter = max(counter, 0) if what == "F" else min(counter, 0)
                if counter == {"F": failed_ms, "P": -passed_ms}[what] * 10**6:
                    verdict = what
            direction = what
        fdc = fault_detection_counter(d, now)
        scale = Fraction(127, failed_ms) if counter >= 0 else Fraction(128, passed_ms)
        exact = Fraction(counter, 10**6) * scale
        assert fdc == (floor(exact) if counter >= 0 else ceil(exact))


def test_reset_starts_anew():
    rows = row(Debounce())
    report_counter_based(rows[0], FAILED)
    reset(rows[0])
    assert rows[0]["counter"] == 0
    assert report_counter_based(rows[0], FAILED) == QUALIFIED_FAILED
    assert fault_detection_counter(rows[0], 0) == 127


TIMED = st.builds(lambda a, b: Debounce(failed_ms=a, passed_ms=b), st.integers(1, 50), st.integers(1, 50))


@given(
    debounce=st.one_of(DEBOUNCES, TIMED),
    before=st.lists(st.sampled_from([PASSED, FAILED]), max_size=20),
    result=st.sampled_from([PASSED, FAILED]),
)
def test_a_result_after_a_jump_to_the_end_qualifies_whatever_was_before(debounce, before, result):
    """AUTOSAR: a monitor that reports FAILED or PASSED has debounced itself."""
    rows = row(debounce)
    d, t_ns = rows[0], 0

    def take(result):
        return report_time_based(d, t_ns, result) if debounce.timed else report_counter_based(d, result)

    for each in before:
        t_ns += 7_000_000
        take(each)
    t_ns += 7_000_000
    known = qualify_by_time(d, t_ns) if debounce.timed else 0  # what time had brought until then
    verdict = int(d["verdict"])
    jump_to_end(d, t_ns, result)
    kind = take(result)
    if verdict != result:
        assert kind == (QUALIFIED_FAILED if result == FAILED else QUALIFIED_PASSED), known
    assert int(d["verdict"]) == result
    assert fault_detection_counter(d, t_ns) == (127 if result == FAILED else -128)
    assert fault_detection_counter(d, t_ns + 10**12) == fault_detection_counter(d, t_ns), "it stays there"
