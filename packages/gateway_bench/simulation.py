"""The function behind :func:`gateway_api.simulate`: a scenario and a gateway, of which all is kept that it tells."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

from gateway.bus.frames import Frames
from gateway.bus.logs import open_writer
from gateway_api.event_collector import EventCollector
from gateway_api.progress import Progress, shown
from gateway_api.run import Run
from gateway_api.table import Table
from gateway_bench.drive import drive
from gateway_bench.scenario_session import opened
from gateway_bench.vecu.expectations import Judge
from gateway_bench.vecu.words import injected


def simulate(
    scenario: Path, *, seed: int | None, series: bool, signals: Sequence[str], record: Path | None, progress: Progress
) -> Run:
    """Play a scenario to a gateway; see :func:`gateway_api.simulate`."""
    found, config, player = opened(scenario, seed)
    observed = EventCollector(config, found.config, series=series, signals=signals)
    judge, count = Judge(found), 0

    def on_frames(frames: Frames) -> None:
        nonlocal count
        count += len(frames)
        if writer is not None:
            writer.write(frames)

    try:
        with shown(progress) as report, nullcontext() if record is None else open_writer(record) as writer:
            drive(
                observed.gateway,
                player,
                judge=judge,
                on_frames=on_frames,
                on_step=lambda t_ns: report(t_ns / 1e9 / found.duration_s),
                fed=observed.fed,
            )
        judged = bool(found.expect) and config.output.dtc_frame is not None
        if found.expect and not judged:
            observed.notes.append("its expectations are not judged: the configuration has no [output.dtc_frame]")
        run = observed.run(count)
    finally:
        observed.close()
    facts = [(fact.t_ns / 1e9, fact.kind, injected(fact, found)) for fact in player.truth]
    findings = judge.findings() if judged else []
    return replace(
        run,
        expectations=Table.of({"met": bool, "text": str}, [(one.good, one.text) for one in findings]),
        injected=Table.of({"t_s": float, "kind": str, "text": str}, facts),
    )
