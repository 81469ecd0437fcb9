"""The story of a demo: faults injected, the gateway's observations, its conclusion, what to do next."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from gateway.bus.frames import Frames
from gateway.cli.dtc_words import few, state_in_words
from gateway.cli.events import EventPrinter
from gateway.cli.lines import HANG
from gateway.faults.status import Status
from gateway.runtime.app import Gateway
from gateway.servers.dtc_frame import DtcReport
from gateway_bench.vecu.contract import Truth
from gateway_bench.vecu.expectations import Finding
from gateway_bench.vecu.player import Player, TruthReader
from gateway_bench.vecu.scenario import Scenario
from gateway_bench.vecu.words import fault_of, injected

#: How long after a fault without an end a DTC is told beside it [s].
SOON_S = 1.0


class Story(EventPrinter):
    """Prints a demo for people, each line with the scenario's time."""

    def __init__(self, scenario: Scenario, player: Player, gateway: Gateway) -> None:
        super().__init__(as_json=False)
        self._scenario, self._player = scenario, player
        self._truth = TruthReader(player)
        self._last: Truth | None = None
        self._frames = self._injected = 0
        self._set: set[str] = set()
        self.definition, self.ecus = gateway.catalogue.get, gateway.senders

    def begin(self, speed: float) -> None:
        """Introduce the scenario and its ECUs; ``speed``: times real time, 0: as fast as it goes."""
        scenario = self._scenario
        self._lines.print(f"{scenario.name}: {scenario.description}", mark=scenario.name, colour="bold", hang=2)
        several = len(scenario.ecu) > 1
        names = "; ".join(f"{ecu.name} ({ecu.summary})" for ecu in scenario.ecu)
        pace = "as fast as it goes" if not speed else f"at {speed:g} times real time"
        self._lines.print(
            f"{'Virtual ECUs send' if several else 'A virtual ECU sends'} {self._player.count} frames in"
            f" {scenario.duration_s:g} s: {names}. A gateway in this process monitors them, {pace}."
            f" Seed {self._player.seed}.",
            hang=2,
        )
        self._lines.print(
            "A DTC (diagnostic trouble code) names a fault: first where it is, after the dash how it shows.", hang=2
        )
        self._lines.print("")

    def on_frames(self, frames: Frames) -> None:
        """Tell what was injected before the gateway can have seen it."""
        if len(frames):
            self.on_time(int(frames["t_ns"][-1]))
        self._frames += len(frames)

    def on_time(self, t_ns: int) -> None:
        """Tell what was injected until a time [ns]."""
        for fact in self._truth.until(t_ns):
            self.flush()
            if not self._injected and not self._set:
                text = f"healthy so far: {self._frames} frames, no DTC"
                self._lines.print(f"{fact.t_ns / 1e9:10.4f} s  {text}", mark="healthy", colour="green")
            self._injected += 1
            self._last = fact
            text = injected(fact, self._scenario)
            self._lines.print(f"{fact.t_ns / 1e9:10.4f} s  INJECTED: {text}", mark="INJECTED", colour="bold yellow")

    def on_report(self, report: DtcReport) -> None:
        """Show a DTC frame that tells a change; the whole list is repeated every second."""
        if report.dtc is None or report.index:
            return
        self.flush()
        state = f"status 0x{report.status:02X} ({state_in_words(report.status)})"
        self._lines.print(
            f"{report.t_ns / 1e9:10.4f} s  sent on CAN  {report.dtc}  {state}", mark="sent on CAN", colour="cyan"
        )

    def __call__(self, event: dict[str, Any]) -> None:
        """Print one event."""
        if event["event"] == "dtc" and event["status"] & Status.TEST_FAILED:
            self._set.add(event["dtc"])
        super().__call__(event)

    def _aside(self, event: dict[str, Any]) -> str:
        fact = self._last
        if fact is None or not event["status"] & Status.TEST_FAILED:
            return ""
        ends_s = getattr(fault_of(fact, self._scenario), "to_s", None) or fact.t_ns / 1e9 + SOON_S
        after_s = (event["t_ns"] - fact.t_ns) / 1e9
        if after_s < 0 or event["t_ns"] / 1e9 > ends_s:
            return ""  # another cause is as likely
        return f"  {_duration(after_s)} after the fault"

    def _status(self, event: dict[str, Any]) -> str:
        return ""  # the line with what is sent on the bus has it

    def _evidence(self, event: dict[str, Any], tested: str) -> str:
        return few(event["evidence"], tested, self._lines.width - HANG - 10)

    def end(self, findings: Sequence[Finding], scenario: Path) -> None:
        """Conclude.

        Args:
            findings: the verdict on what the scenario expects.
            scenario: as it was asked for.
        """
        wrong = sum(not finding.good for finding in findings)
        judged = bool(findings) or self._scenario.unexpected == "fail"
        verdict = "all as expected" if judged else "nothing is expected of it"
        if wrong:
            verdict = f"{wrong} NOT as expected"
        self._lines.print(
            f"Conclusion: {_counted(self._injected, 'fault')} injected,"
            f" {_counted(len(self._set), 'DTC')} set: {verdict}.",
            mark="Conclusion",
            colour="bold",
            hang=2,
        )
        command = f"gateway demo {shlex.quote(str(scenario))}"
        self._lines.print(f"Next: all numbers:  {command} --json", mark="Next", colour="bold", hang=6)
        self._lines.print(f"      on a page:    {command} --serve", hang=6)


def _counted(count: int, what: str) -> str:
    return f"{count or 'no'} {what}{'s' if count > 1 else ''}"


def _duration(seconds: float) -> str:
    return f"{seconds * 1e3:.3g} ms" if seconds < 1.0 else f"{seconds:.3g} s"
