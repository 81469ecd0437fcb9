"""``gateway calibrate``: thresholds from healthy logs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn
from rich.table import Table

from gateway.calibration import cusum, stopping
from gateway.calibration.file import write
from gateway.calibration.logs import digest, of_kind, refuse
from gateway.cli.present import print_json, wide_console
from gateway.config.load import load_config
from gateway.fdi.stopping import assured
from gateway.monitors.contract import Calibration, CusumCalibration


def _alarmed(failed: tuple[str, ...]) -> list[str]:
    if not failed:
        return []
    return [
        f"These logs set {', '.join(failed)}. If that was no false alarm, they are not healthy, and the "
        "thresholds are too high."
    ]


def _claim(seconds: float, target: float) -> list[str]:
    """Say what the data carry for stopping rules."""
    lines = [
        f"The logs hold {seconds:.0f} s. Without an alarm in them, a mean time between false alarms of "
        f"{assured(seconds, 0):.0f} s is sure with 95 %."
    ]
    if target > seconds:
        lines.append(
            f"The target of {target:.0f} s lies beyond the data: thresholds are continued from the levels' tail, "
            f"and nothing here proves them. {3.0 * target:.0f} s of healthy logs would."
        )
    return lines


def _cusum_claim(found: cusum.Found, margin: float, floor: float) -> list[str]:
    """Say what the data carry for CUSUM tests."""
    worst = max(found.rows, key=lambda row: row.margin)
    floored = sum(row.floored for row in found.rows)
    few = sorted({row.residual or row.name for row in found.rows if row.samples == 0})
    lines = [
        f"The logs hold {found.seconds:.0f} s. With these thresholds no test fires in them: the largest healthy T is "
        f"{worst.margin:.2f} of its threshold ({worst.name}), {margin:g} at most was asked for. A mean time between "
        f"false alarms of {assured(found.seconds, 0):.0f} s is sure with 95 %.",
        f"The floor of {floor:g} nu decides for {floored} of {len(found.rows)} quantities.",
    ]
    if few:
        lines.append(f"Nothing in them updated {', '.join(few)}: nu stays as it was.")
    return lines


def _table(proposals: list[stopping.Proposal]) -> Table:
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


def _cusum_table(rows: tuple[cusum.Quantity, ...]) -> Table:
    table = Table(title="CUSUM tests; T and J in units of nu")
    for name in ("monitor", "quantity"):
        table.add_column(name)
    for name in ("samples", "nu now", "nu", "J now", "largest T", "J", "T / J"):
        table.add_column(name, justify="right")
    for row in rows:
        table.add_row(
            row.monitor,
            row.name,
            str(row.samples),
            "-" if row.nu_now is None else f"{row.nu_now:.4g}",
            "-" if row.nu is None else f"{row.nu:.4g}",
            f"{row.now:.4g}",
            f"{row.largest:.3g}",
            f"{row.threshold:.4g}",
            f"{row.margin:.2f}",
        )
    return table


def calibrate_logs(
    config_path: Path,
    logs: list[Path],
    *,
    mtfa: float,
    margin: float,
    floor: float,
    into: bool,
    maps: Sequence[str] = (),
    json: bool,
) -> int:
    """Propose thresholds, and write them if wanted; returns the exit code."""
    config = load_config(config_path)
    rules, tests = of_kind(config, Calibration), of_kind(config, CusumCalibration)
    if not rules and not tests:
        raise refuse("thresholds", config_path)
    columns = (TextColumn("frames"), BarColumn(), TextColumn("{task.completed}"))
    seen, found = None, None
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("frames", total=None)

        def progress(count: int) -> None:
            bar.advance(task, count)

        if rules:
            seen = stopping.levels(config, logs, file=config_path, maps=maps, progress=progress)
        if tests:
            found = cusum.learn(
                config,
                logs,
                margin=margin,
                floor=floor,
                file=config_path,
                maps=maps,
                progress=progress,
            )
    proposals = stopping.calibrate(config, seen, mtfa) if seen else []
    seconds = max(part.seconds for part in (seen, found) if part is not None)
    failed = tuple(
        sorted({dtc for part in (seen, found) if part is not None for dtc in part.failed})
    )
    if into:
        source = f"{seconds:.0f} s of healthy logs, sha256 {digest(logs)}"
        if seen:
            write(config_path, stopping.tables(proposals), f"{source}, target {mtfa:.0f} s")
        if found:
            write(config_path, found.tables, f"{source}, margin {margin:g}, floor {floor:g} nu")
    if json:
        said: dict[str, Any] = {"seconds": seconds, "data": digest(logs), "failed": list(failed)}
        if seen:
            said |= {"target_s": mtfa, "rows": [asdict(p) for p in proposals]}
        if found:
            said |= {"margin": margin, "floor": floor}
            said["cusum"] = [asdict(row) | {"margin": row.margin} for row in found.rows]
        print_json(said | {"assured_s": assured(seconds, 0), "written": into})
        return 0
    console = wide_console()
    lines = _alarmed(failed)
    if seen:
        console.print(_table(proposals))
        lines = _claim(seen.seconds, mtfa) + lines
        if any(p.beyond > 1.0 for p in proposals):
            lines.append(
                "* extrapolated: this symptom's share of the target is longer than the logs"
            )
    if found:
        console.print(_cusum_table(found.rows))
        lines = _cusum_claim(found, margin, floor) + lines
    for line in lines:
        console.print(line, soft_wrap=True)
    if into:
        console.print(f"written: {config_path}")
    return 0
