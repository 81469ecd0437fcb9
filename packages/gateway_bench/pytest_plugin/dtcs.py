"""A test's expectations of DTCs: judged as the expectations of a scenario are."""

from __future__ import annotations

from gateway.faults.status import Status
from gateway_bench.pytest_plugin.bench import STEP_NS, Bench
from gateway_bench.vecu.expectations import Finding, Judge, refuse_impossible
from gateway_bench.vecu.scenario import Expectation, Scenario


class Dtcs:
    """The DTCs of a bench.

    Args:
        bench: whose clock goes on while something is waited for.
    """

    def __init__(self, bench: Bench) -> None:
        self._bench = bench

    @property
    def seen(self) -> list[tuple[float, str, int]]:
        """All changes so far: time [s], DTC, status byte."""
        return [(e["t_ns"] / 1e9, e["dtc"], e["status"]) for e in self._bench.events if e["event"] == "dtc"]

    @property
    def failed(self) -> list[str]:
        """DTCs whose testFailed bit is set now."""
        last = {dtc: status for _, dtc, status in self.seen}
        return sorted(dtc for dtc, status in last.items() if status & Status.TEST_FAILED)

    def expect(self, dtc: str, *, by: float, after: float = 0.0, healed_by: float | None = None) -> float:
        """Let time pass until a DTC is set (and has healed).

        Args:
            dtc: e.g. ``"P0336-29"``.
            by: it must be set not later than this [s].
            after: and not before this [s].
            healed_by: its testFailed bit must be gone again by this [s].

        Returns:
            when it was set [s].

        Raises:
            AssertionError: it was not; names the DTC, the time expected, and the time seen.
            InputErrors: no fault of the configuration has this DTC.
        """
        __tracebackhide__ = True  # pytest shows the line of the test
        self._check(dtc)
        line = Expectation(dtc=dtc, after_s=after, by_s=by, healed_by_s=healed_by)
        end = max(by, healed_by or 0.0)
        findings = self._judged(line)
        while not all(finding.good for finding in findings) and self._bench.now_s < end:
            count = len(self._bench.events)
            self._bench.run_until(min(self._bench.now_s + STEP_NS / 1e9, end))
            if len(self._bench.events) > count or self._bench.now_s >= end:
                findings = self._judged(line)
        self._demand(findings)
        return next(t for t, seen, status in self.seen if seen == dtc and t >= after and status & Status.TEST_FAILED)

    def absent(self, dtc: str, *, until: float) -> None:
        """Let time pass to ``until`` [s]: a DTC must never be set.

        Raises:
            AssertionError: it was; names the DTC and the time.
            InputErrors: no fault of the configuration has this DTC.
        """
        __tracebackhide__ = True  # pytest shows the line of the test
        self._check(dtc)
        self._bench.run_until(until)
        self._demand(self._judged(Expectation(dtc=dtc, absent=True)))

    def none(self, *, until: float | None = None, but: tuple[str, ...] = ()) -> None:
        """Let time pass to ``until`` [s]: no DTC must be set.

        Args:
            until: None: nothing more is waited for.
            but: those that may.

        Raises:
            AssertionError: one was; names DTCs and times.
            InputErrors: no fault of the configuration has a DTC of ``but``.
        """
        __tracebackhide__ = True  # pytest shows the line of the test
        for dtc in but:
            self._check(dtc)
        if until is not None:
            self._bench.run_until(until)
        failed = [(t, dtc) for t, dtc, status in self.seen if status & Status.TEST_FAILED and dtc not in but]
        first = {dtc: t for t, dtc in reversed(failed)}
        assert not first, "; ".join(f"{dtc} set at {t:.3f} s, not expected" for dtc, t in sorted(first.items()))

    def _check(self, dtc: str) -> None:
        refuse_impossible([dtc], self._bench.gateway.catalogue, key="dtc")

    def _judged(self, line: Expectation) -> list[Finding]:
        scenario = Scenario.model_construct(
            name="test", ecu=(), duration_s=max(self._bench.now_s, 1e-9), expect=(line,), unexpected="allow"
        )
        judge = Judge(scenario)
        for event in self._bench.events:
            if event["event"] == "dtc":
                judge.report(event["t_ns"] / 1e9, event["dtc"], event["status"], event["occurrence"])
        return judge.findings()

    def _demand(self, findings: list[Finding]) -> None:
        __tracebackhide__ = True  # pytest shows the line of the test
        wrong = [finding.text for finding in findings if not finding.good]
        if wrong:
            first = {dtc: t for t, dtc, status in reversed(self.seen) if status & Status.TEST_FAILED}
            shown = ", ".join(f"{dtc} at {t:.3f} s" for dtc, t in sorted(first.items(), key=lambda pair: pair[1]))
            raise AssertionError(f"{'; '.join(wrong)} (set so far: {shown or 'none'}; now {self._bench.now_s:.3f} s)")
