"""``gateway calibrate``: thresholds from healthy logs."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from math import isnan
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TextColumn
from rich.table import Table

from gateway.cli.present import print_json, say, wide_console
from gateway.common.extras import need
from gateway_api.thresholds import Targets
from gateway_bench.cli.study import headed, tabulate
from gateway_calibration import cusum, plants, sensors, stopping
from gateway_calibration.configuration import Found, anything, as_dict, calibrate, keep
from gateway_calibration.earlier import load_afresh
from gateway_calibration.logs import refuse
from gateway_fdi.errors import InputError
from gateway_fdi.stopping import assured
from gateway_logs.corpus import find

if TYPE_CHECKING:
    from gateway_fleet.fleet.healthy import Answer

#: Time between two lines of progress [s].
PERIOD_S = 5.0
#: States of logs that may fare better another time.
_FAILED = ("failed", "killed", "unreadable")


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
    return tabulate(
        "",
        proposals,
        {
            "monitor": lambda p: p.monitor,
            "symptom": lambda p: p.symptom,
            "now": lambda p: f"{p.now:.4g}",
            "alarms now": lambda p: p.alarms_now,
            "largest level": lambda p: f"{p.largest:.4g}",
            "proposed": lambda p: f"{p.threshold:.4g}" + (" *" if p.beyond > 1.0 else ""),
            "alarms": lambda p: p.alarms,
            "assured MTFA [s]": lambda p: f"{p.assured_s:.0f}",
        },
        texts=2,
    )


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.4g}"


def _cusum_table(rows: tuple[cusum.Quantity, ...]) -> Table:
    return tabulate(
        "CUSUM tests; T and J in units of nu",
        rows,
        {
            "monitor": lambda row: row.monitor,
            "quantity": lambda row: row.name,
            "samples": lambda row: row.samples,
            "nu now": lambda row: _number(row.nu_now),
            "nu": lambda row: _number(row.nu),
            "J now": lambda row: _number(row.now),
            "largest T": lambda row: f"{row.largest:.3g}",
            "J": lambda row: f"{row.threshold:.4g}",
            "T / J": lambda row: f"{row.margin:.2f}",
        },
        texts=2,
    )


def _plant_table(plant: plants.Plant) -> Table:
    """Return what logs say of a plant."""
    table = headed(f"plant of {plant.monitor}", ["entry"], ["told", "found", "standard deviation"])
    for name, told, found, sure in plant.rows:
        table.add_row(name, f"{told:.5g}", f"{found:.5g}", f"{sure:.2g}" if sure else "")
    return table


def _sensor_table(measured: sensors.Sensors) -> Table:
    """Return what logs say of a monitor's sensors."""
    table = headed(f"sensors of {measured.monitor}", ["key"], ["told", "found", "standard deviation"])
    for name, *numbers in measured.rows:
        table.add_row(escape(name), *("" if isnan(number) else f"{number:.4g}" for number in numbers))
    return table


def _plant_claim(plant: plants.Plant) -> str:
    """Say how well the model explains the logs."""
    fits = ", ".join(f"{fit:.2f}" for fit in plant.fit)
    return (
        f"{plant.monitor}: innovations squared over what the noise explains, log by log: {fits} (1 is all of them; "
        "more: the model lacks something, and the noise is widened; much less: the noise told is too large)"
    )


@dataclass(frozen=True)
class _Fleet:
    """How the logs of a fleet are read.

    Attributes:
        out: folder of what each log said.
        scheduler: address of a scheduler.
        workers: of this machine, None: a core each.
    """

    out: Path
    scheduler: str | None
    workers: int | None


def _learn(file: Path, logs: list[Path], targets: Targets, maps: Sequence[str]) -> Found:
    """Calibrate in this process, and show how far it is."""
    columns = (TextColumn("frames"), BarColumn(), TextColumn("{task.completed}"))
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("frames", total=None)
        return calibrate(file, logs, targets, maps, lambda count: bar.advance(task, count))


class _Reading:
    """Tells how far the logs are read.

    Args:
        silent: without output.
    """

    def __init__(self, *, silent: bool) -> None:
        self._silent = silent
        self._said = time.monotonic()

    def __call__(self, answer: Answer, left: int) -> None:
        """Take an answer, and how many are to come."""
        now = time.monotonic()
        if self._silent or (left and now - self._said < PERIOD_S):
            return
        self._said = now
        say(f"{answer.ask.kind}: {left} logs left")


def _learn_of_fleet(
    file: Path, logs: list[Path], targets: Targets, maps: Sequence[str], fleet: _Fleet, *, silent: bool
) -> Found:
    """Have workers run the logs through gateways, and propose thresholds.

    Raises:
        InputError: the configuration has nothing to calibrate, an extra is missing.
    """
    need("fleet", "fleets' logs")
    need("parquet", "tables of errors")
    from gateway_fleet.fleet import healthy  # noqa: PLC0415 - behind need()
    from gateway_replay.pool import Workers, default_workers  # noqa: PLC0415

    if fleet.scheduler is not None and fleet.workers is not None:
        raise InputError("a scheduler has workers of its own", key="--workers", value=fleet.workers)
    if not anything(load_afresh(file, told=True)):
        raise refuse("thresholds", file)
    workers = Workers(fleet.scheduler, default_workers() if fleet.workers is None else fleet.workers)
    return healthy.learn(file, find(logs), fleet.out, workers, targets, tuple(maps), _Reading(silent=silent))


def _show(targets: Targets, learned: Found, console: Console) -> None:
    """Print what was found, for people."""
    lines = _alarmed(learned.failed)
    if learned.levels:
        console.print(_table(learned.proposals))
        lines = _claim(learned.levels.seconds, targets.mtfa_s) + lines
        if any(p.beyond > 1.0 for p in learned.proposals):
            lines.append("* extrapolated: this symptom's share of the target is longer than the logs")
    if learned.tests:
        console.print(_cusum_table(learned.tests.rows))
        lines = _cusum_claim(learned.tests, targets.margin, targets.floor) + lines
    for plant in learned.plants:
        console.print(_plant_table(plant))
        lines.append(_plant_claim(plant))
    for one in learned.sensors:
        console.print(_sensor_table(one))
    for line in lines:
        console.print(line, soft_wrap=True)


def calibrate_logs(
    config_path: Path,
    logs: list[str],
    *,
    mtfa: float,
    margin: float,
    floor: float,
    write: bool = False,
    write_to: Path | None = None,
    parts: Path | None,
    scheduler: str | None,
    workers: int | None,
    maps: Sequence[str] = (),
    json: bool,
) -> int:
    """Propose thresholds, and write them if wanted; returns the exit code.

    Args:
        config_path: the configuration.
        logs: healthy ones: files, folders, patterns.
        mtfa: target of the mean time between false alarms [s], for stopping rules.
        margin: largest healthy T over its threshold, for CUSUM tests.
        floor: least threshold of these [nu].
        write: whether the configuration gets the thresholds.
        write_to: its copy that gets them instead.
        parts: folder of what each log said, None: all is done here, each time again.
        scheduler: address of Dask's scheduler.
        workers: of this machine.
        maps: channels of the logs taken as buses.
        json: the output is for programs.
    """
    targets, into = Targets(mtfa, margin, floor), write_to or (config_path if write else None)
    if parts is None:
        for key, value in (("--scheduler", scheduler), ("--workers", workers)):
            if value is not None:
                raise InputError("goes with --parts, the folder of what each log said", key=key, value=value)
        learned = _learn(config_path, [recording.path for recording in find(logs)], targets, maps)
    else:
        fleet = _Fleet(parts, scheduler, workers)
        learned = _learn_of_fleet(config_path, [Path(log) for log in logs], targets, maps, fleet, silent=json)
    if into is not None:
        keep(config_path, targets, learned, into)
    code = 2 if any(row["kind"] in _FAILED for row in learned.left_out) else 0
    if json:
        print_json(as_dict(targets, learned) | {"written": into is not None})
        return code
    console = wide_console()
    _show(targets, learned, console)
    if parts is not None:
        said = f"{learned.logs} logs, {learned.read} of them read now, {len(learned.left_out)} left out"
        console.print(f"{said} (kept in {parts})", soft_wrap=True)
        for row in learned.left_out:
            say(f"{row['path']}: left out, {row['kind']}: {row['text']}")
    if into is not None:
        console.print(f"written: {into}")
    return code
