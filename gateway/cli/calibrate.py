"""``gateway calibrate``: thresholds from healthy logs."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn
from rich.table import Table

from gateway.calibration import Proposal, calibrate, digest, levels, write
from gateway.cli.present import print_json, say_if_cold, wide_console
from gateway.config import load_config
from gateway.fdi.stopping import assured


def _claim(seconds: float, target: float, failed: tuple[str, ...]) -> list[str]:
    """Say what the data carry."""
    lines = [
        f"The logs hold {seconds:.0f} s. Without an alarm in them, a mean time between false alarms of "
        f"{assured(seconds, 0):.0f} s is sure with 95 %."
    ]
    if target > seconds:
        lines.append(
            f"The target of {target:.0f} s lies beyond the data: thresholds are continued from the levels' tail, "
            f"and nothing here proves them. {3.0 * target:.0f} s of healthy logs would."
        )
    if failed:
        lines.append(
            f"These logs set {', '.join(failed)}. If that was no false alarm, they are not healthy, and the "
            "thresholds are too high."
        )
    return lines


def _table(proposals: list[Proposal]) -> Table:
    table = Table()
    for name in ("monitor", "symptom"):
        table.add_column(name)
    for name in ("now", "alarms", "largest level", "proposed", "alarms", "assured MTFA [s]"):
        table.add_column(name, justify="right")
    for p in proposals:
        table.add_row(
            p.monitor,
            p.symptom,
            f"{p.now:.4g}",
            str(p.alarms_now),
            f"{p.largest:.4g}",
            f"{p.threshold:.4g}" + (" *" if p.beyond > 1.0 else ""),
            str(p.alarms),
            f"{p.assured_s:.0f}",
        )
    return table


def calibrate_logs(
    config_path: Path, logs: list[Path], *, mtfa: float, into: bool, json: bool
) -> int:
    """Propose thresholds, and write them if wanted; returns the exit code."""
    config = load_config(config_path)
    say_if_cold()
    columns = (TextColumn("frames"), BarColumn(), TextColumn("{task.completed}"))
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("frames", total=None)
        seen = levels(
            config, logs, file=config_path, progress=lambda count: bar.advance(task, count)
        )
    proposals = calibrate(config, seen, mtfa)
    source = f"{seen.seconds:.0f} s of healthy logs, sha256 {digest(logs)}, target {mtfa:.0f} s"
    if into:
        write(config_path, proposals, source)
    if json:
        print_json(
            {
                "seconds": seen.seconds,
                "target_s": mtfa,
                "assured_s": assured(seen.seconds, 0),
                "data": digest(logs),
                "failed": list(seen.failed),
                "rows": [asdict(p) for p in proposals],
                "written": into,
            }
        )
        return 0
    console = wide_console()
    console.print(_table(proposals))
    for line in _claim(seen.seconds, mtfa, seen.failed):
        console.print(line, soft_wrap=True)
    if any(p.beyond > 1.0 for p in proposals):
        console.print("* extrapolated: this symptom's share of the target is longer than the logs")
    if into:
        console.print(f"written: {config_path}")
    return 0
