"""A scenario played for a test, and the files of one that failed: its frames as a log, and a report."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from gateway.bus.frames import Frames
from gateway.bus.logs import open_writer
from gateway.common.extras import installed
from gateway.config.model import Config
from gateway.runtime.app import Gateway
from gateway_bench.drive import drive, reports_among
from gateway_bench.pytest_plugin.bench import Bench
from gateway_bench.scenario_session import player_of
from gateway_bench.vecu.contract import Truth
from gateway_bench.vecu.expectations import Finding, Judge, refuse_impossible
from gateway_bench.vecu.scenario import Scenario


@dataclass(frozen=True)
class ScenarioRun:
    """Outcome of a scenario.

    Attributes:
        findings: the verdict.
        truth: injected faults.
        frames: on real buses, all of them; else none: it can be played again.
    """

    findings: list[Finding]
    truth: list[Truth]
    frames: tuple[Frames, ...] = ()


def inside(scenario: Scenario, config: Config, seed: int | None) -> ScenarioRun:
    """Play a scenario in this process, as fast as it goes.

    Raises:
        InputError: an ECU or a fault that is wrong.
    """
    player, judge = player_of(scenario, config, seed=seed), Judge(scenario)
    gateway = Gateway(config, file=scenario.config)
    refuse_impossible([line.dtc for line in scenario.expect], gateway.catalogue)
    try:
        drive(gateway, player, judge=judge)
    finally:
        gateway.close()
    return ScenarioRun(judge.findings(), player.truth)


def on_buses(scenario: Scenario, config: Config, seed: int | None, buses: Sequence[str]) -> ScenarioRun:
    """Play a scenario on real buses, in real time; wait for expectations later than its end.

    Raises:
        InputError: an ECU or a fault that is wrong, a bus that is none.
        BusError: a bus that cannot be opened, or is gone.
    """
    judge, frames = Judge(scenario), list[Frames]()
    bench = Bench(scenario.config, buses=buses)

    def hear(batch: Frames) -> None:
        frames.append(batch.copy())
        for report in reports_among(batch):
            if report.dtc is not None:
                judge.report(report.t_ns / 1e9, str(report.dtc), report.status, report.occurrence)

    bench.on_frames(hear)
    try:
        name = bench.play(scenario, seed)
        bench.run_until(scenario.duration_s)
        truth = bench.truth
        bench.switch_off(name)
        while bench.now_s < judge.waits_until_s:
            bench.run(0.1)
    finally:
        bench.close()
    return ScenarioRun(judge.findings(), truth, tuple(frames))


def leave(
    folder: Path, scenario: Scenario, config: Config, seed: int | None, run: ScenarioRun
) -> Iterator[tuple[str, Path]]:
    """Leave frames and report of a scenario in a folder; yields what each file is.

    One that was played in this process is played again for it, with the same seed: it is the same.

    Raises:
        GatewayError, OSError: a file that cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    log = folder / "can.log"
    with open_writer(log) as writer:
        for batch in run.frames:
            writer.write(batch)
        if run.frames:
            yield "recording", log
            return
        player, judge = player_of(scenario, config, seed=seed), Judge(scenario)
        gateway = Gateway(config, file=scenario.config)
        refuse_impossible([line.dtc for line in scenario.expect], gateway.catalogue)
        collector = None
        if installed("serve"):
            from gateway_serve.report.collect import Collector  # noqa: PLC0415 - an extra

            collector = Collector(gateway)
        try:
            drive(gateway, player, judge=judge, on_frames=writer.write, fed=collector)
            yield "recording", log
            if collector is not None:
                from gateway_serve.report.page import Words, write_report  # noqa: PLC0415 - an extra

                report = folder / "report.html"
                source = [("scenario", f"{scenario.name}: {scenario.description}"), ("seed", str(player.seed))]
                findings = [(finding.good, finding.text) for finding in judge.findings()]
                truth = [(f"{fact.kind.replace('_', ' ')}, {fact.count}", fact.t_ns) for fact in player.truth]
                events = [gateway.summary(scenario.duration_s)]
                told = Words(scenario.name, source, scenario.config, events=events, findings=findings, truth=truth)
                write_report(report, gateway, collector, told)
                yield "report", report
        finally:
            gateway.close()
