"""The fault detection counter against a reference written from the definition."""

from fractions import Fraction
from math import ceil, floor

from hypothesis import given
from hypothesis import strategies as st

from gateway.engine.debounce import DEBOUNCE, configure, count, fault_detection_counter, reset
from gateway.engine.events import QUALIFIED_FAILED, QUALIFIED_PASSED, RESULT_CHANGED
from gateway.engine.tables import table
from gateway.monitors.shape import FAILED, PASSED, Debounce


def row(debounce):
    rows = table(1, DEBOUNCE)
    configure(rows[0], debounce)
    return rows


def test_counter_reaches_the_limits_in_the_asked_number_of_results():
    for number in (1, 2, 3, 7, 50, 100, 128, 300, 1000):
        rows = row(Debounce(failed_after=number, passed_after=number))
        kinds = [count(rows[0], FAILED) for _ in range(number)]
        assert kinds[-1] == QUALIFIED_FAILED
        assert QUALIFIED_FAILED not in kinds[:-1]
        assert fault_detection_counter(rows[0], 0) == 127
        reset(rows[0])
        kinds = [count(rows[0], PASSED) for _ in range(number)]
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
        jump = self.d.jump_up if failed else self.d.jump_down
        sign = 1 if failed else -1
        start = 0 if jump and self.counter * sign < 0 else self.counter
        self.counter = max(-self.d.passed_after, min(self.d.failed_after, start + sign))
        ends = {self.d.failed_after: "failed", -self.d.passed_after: "passed"}
        verdict = ends.get(self.counter, self.verdict)
        changed = verdict != self.verdict
        self.verdict = verdict
        return verdict if changed else None

    def fdc(self):
        if self.counter >= 0:
            return floor(Fraction(127 * self.counter, self.d.failed_after))
        return ceil(Fraction(128 * self.counter, self.d.passed_after))


@given(
    st.builds(
        Debounce,
        failed_after=st.integers(1, 130),
        passed_after=st.integers(1, 130),
        jump_up=st.booleans(),
        jump_down=st.booleans(),
    ),
    st.lists(st.booleans(), max_size=300),
)
def test_counter_follows_the_reference(debounce, results):
    rows = row(debounce)
    reference = Reference(debounce)
    last = None
    for failed in results:
        kind = count(rows[0], FAILED if failed else PASSED)
        verdict = reference.take(failed)
        expected = {"failed": QUALIFIED_FAILED, "passed": QUALIFIED_PASSED}.get(verdict, 0)
        if expected == 0 and failed != last:
            expected = RESULT_CHANGED
        assert kind == expected
        fdc = fault_detection_counter(rows[0], 0)
        assert fdc == reference.fdc()
        assert -128 <= fdc <= 127
        last = failed


def test_reset_starts_anew():
    rows = row(Debounce())
    count(rows[0], FAILED)
    reset(rows[0])
    assert rows[0]["counter"] == 0
    assert count(rows[0], FAILED) == QUALIFIED_FAILED
    assert fault_detection_counter(rows[0], 0) == 127
