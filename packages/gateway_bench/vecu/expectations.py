"""Did the expected DTCs come? Judged from what is reported on the bus, as a tester sees it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

from gateway.faults.catalogue import FaultDefinition
from gateway.faults.status import Status
from gateway_bench.vecu.scenario import Expectation, Scenario
from gateway_fdi.errors import InputError, InputErrors
from gateway_fdi.errors import named as among

#: Expectation of DTCs that no line names.
OTHERS = "no other DTC"


def refuse_impossible(
    dtcs: Iterable[str], catalogue: Iterable[FaultDefinition], file: Path | None = None, key: str = "expect[{}].dtc"
) -> None:
    """Refuse expectations that no fault of a gateway can meet.

    Args:
        dtcs: the expected ones.
        catalogue: the gateway's faults.
        file: with the expectations.
        key: of a DTC, with its place.

    Raises:
        InputErrors: each DTC that no fault has; names close ones.
    """
    known = sorted({str(definition.dtc) for definition in catalogue})
    wrong = [
        InputError(among("the configuration's faults have", dtc, known), file=file, key=key.format(k), value=dtc)
        for k, dtc in enumerate(dtcs)
        if dtc not in known
    ]
    if wrong:
        raise InputErrors(wrong)


@dataclass
class _Seen:
    occurrence: int
    failed: bool
    set_s: list[float] = field(default_factory=list)
    healed_s: list[float] = field(default_factory=list)


@dataclass(frozen=True)
class Finding:
    """One line of the verdict.

    Attributes:
        good: whether it is as expected.
        text: observation, and expectation where that is not the same; with the DTC and times.
        expected: the expectation, the same in each run: a name for it in reports.
    """

    good: bool
    text: str
    expected: str


def named(line: Expectation) -> str:
    """Return what an expectation says of its DTC being set, in words."""
    if line.absent:
        return f"{line.dtc} never set"
    after = f" after {line.after_s:g} s" if line.after_s else ""
    by = "" if line.by_s is None else f" by {line.by_s:g} s"
    return f"{line.dtc} set{after}{by}"


class Judge:
    """Compares reported DTCs with a scenario's expectations.

    A DTC counts as set when its testFailed bit goes up, or its occurrence counter does, after the start;
    reports before the start are the state to compare with.
    """

    def __init__(self, scenario: Scenario) -> None:
        self._scenario = scenario
        self._seen: dict[str, _Seen] = {}

    def report(self, t_s: float, dtc: str, status: int, occurrence: int) -> None:
        """Take one report.

        Args:
            t_s: time since the start [s]; negative before it.
            dtc: text.
            status: status byte.
            occurrence: its counter.
        """
        failed = bool(status & Status.TEST_FAILED)
        seen = self._seen.get(dtc)
        if t_s < 0:
            self._seen[dtc] = _Seen(occurrence, failed)
            return
        if seen is None:
            seen = self._seen[dtc] = _Seen(0, False)
        if occurrence > seen.occurrence or (failed and not seen.failed):
            seen.set_s.append(t_s)
        if not failed and (seen.failed or occurrence > seen.occurrence):
            seen.healed_s.append(t_s)
        seen.occurrence, seen.failed = occurrence, failed

    @property
    def waits_until_s(self) -> float:
        """The last deadline [s] of a DTC that was not set, or has not healed; 0: all came."""
        last = 0.0
        for line in self._scenario.expect:
            if line.absent:
                continue
            seen = self._seen.get(line.dtc)
            if seen is None or not any(t >= line.after_s for t in seen.set_s):
                last = max(last, line.by_s or 0.0)
            elif line.healed_by_s is not None and seen.failed:
                last = max(last, line.healed_by_s)
        return last

    def findings(self) -> list[Finding]:
        """Return the verdict, line by line."""
        found = []
        expected = set()
        for line in self._scenario.expect:
            expected.add(line.dtc)
            seen = self._seen.get(line.dtc)
            times = seen.set_s if seen else []
            if line.absent:
                times = [t for t in times if t <= self._scenario.duration_s]
                good = not times
                text = "never set" if good else f"set at {times[0]:.3f} s, should never be"
                found.append(Finding(good, f"{line.dtc} {text}", named(line)))
                continue
            limit = self._scenario.duration_s if line.by_s is None else line.by_s
            inside = [t for t in times if line.after_s <= t <= limit]
            early = [t for t in times if t < line.after_s]
            if early:
                found.append(
                    Finding(False, f"{line.dtc} set at {early[0]:.3f} s, before {line.after_s} s", named(line))
                )
            elif not inside:
                late = f", but at {times[0]:.3f} s" if times else ""
                found.append(Finding(False, f"{line.dtc} not set by {limit} s{late}", named(line)))
            else:
                found.append(Finding(True, f"{line.dtc} set at {inside[0]:.3f} s", named(line)))
            if line.healed_by_s is not None and inside and seen is not None:
                healed = [t for t in seen.healed_s if inside[0] <= t <= line.healed_by_s]
                # DTCs set after the drive are about ECUs that have been switched off.
                again = [t for t in seen.set_s if healed and healed[-1] < t <= self._scenario.duration_s]
                good = bool(healed) and (not again or any(t > again[-1] for t in seen.healed_s))
                later = [t for t in seen.healed_s if t > line.healed_by_s]
                when = f", but at {later[0]:.3f} s" if later else f", set at {inside[0]:.3f} s"
                text = f"healed at {healed[0]:.3f} s" if good else f"not healed by {line.healed_by_s} s{when}"
                found.append(Finding(good, f"{line.dtc} {text}", f"{line.dtc} healed by {line.healed_by_s:g} s"))
        if self._scenario.unexpected == "fail":
            for dtc, seen in sorted(self._seen.items()):
                # DTCs set after the drive are about ECUs that have been switched off.
                times = [t for t in seen.set_s if t <= self._scenario.duration_s]
                if dtc not in expected and times:
                    found.append(Finding(False, f"{dtc} set at {times[0]:.3f} s, not expected", OTHERS))
        return found
