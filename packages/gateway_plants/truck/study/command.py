"""``gateway evaluate truck``."""

from __future__ import annotations

from dataclasses import asdict
from functools import partial
from math import inf, isinf
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn
from rich.table import Table

from gateway_bench.cli.study import beside, headed, show
from gateway_plants.truck.study.claims import claims
from gateway_plants.truck.study.conditions import EFFICIENCY, SENSOR, compare
from gateway_plants.truck.study.table import (
    DISTURBANCES,
    FAULTS,
    ONSETS,
    SYSTEMS,
    Row,
    disturbed,
    firing,
)


def _delay(seconds: float) -> str:
    return "-" if isinf(seconds) else f"{seconds:.1f}"


def _firing_table(rows: list[Row]) -> Table:
    title = "Isolated, of the runs with each onset; median delay to the DTC [s]"
    table = headed(title, ["fault", "onset [s]", "runs"], [name for system in SYSTEMS for name in (system, "delay")])
    for fault in (None, *FAULTS):
        for onset in ONSETS if fault else (0.0,):
            mine = [r for r in rows if (r.fault, r.onset) == (fault, onset)]
            cells = [fault or "none: silent", f"{onset:g}" if fault else "-", str(mine[0].runs)]
            for system in SYSTEMS:
                row = next(r for r in mine if r.system == system)
                cells += [str(row.right), _delay(row.delay_s)]
            table.add_row(*cells)
    return table


def _told(rows: list[Row]) -> str:
    """Say which faults a system does not isolate on a truck, and whether it is silent without one."""
    parts = []
    healthy = next(r for r in rows if r.fault is None)
    if healthy.right < healthy.runs:
        parts.append(f"false alarm in {healthy.runs - healthy.right} of {healthy.runs}")
    lost = [r.fault or "" for r in rows if r.fault is not None and r.right < r.runs]
    if len(lost) == len(FAULTS):
        parts.append("isolates none")
    elif lost:
        parts.append("lost: " + ", ".join(name.replace("machine_", "") for name in lost))
    return "; ".join(parts) or "all, silent without"


def _disturbed_table(rows: list[Row], title: str) -> Table:
    table = headed(title, ["truck"])
    for system in SYSTEMS:
        table.add_column(system, max_width=34)
    for name in DISTURBANCES:
        mine = [r for r in rows if r.disturbance == name]
        table.add_row(name, *(_told([r for r in mine if r.system == s]) for s in SYSTEMS))
    return table


def _finite(row: Row) -> dict[str, object]:
    return {key: None if value == inf else value for key, value in asdict(row).items()}


def truck(*, seeds: int, seed: int, json: bool, plot: Path | None) -> int:
    """Evaluate the tests of the hybrid powertrain; returns the exit code."""
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        cases = 1 + len(FAULTS) * len(ONSETS)
        task = bar.add_task("firing", total=cases)
        fired = firing(seeds, seed, partial(bar.advance, task))
        names = tuple(DISTURBANCES)
        told: list[list[Row]] = []
        for what, relearn in (("disturbed", 0), ("learned anew", 1)):
            each = bar.add_task(what, total=len(names) * (1 + len(FAULTS)))
            step = partial(bar.advance, each)
            told.append(disturbed(names, seeds, seed, relearn=relearn, progress=step))
    sensor, efficiency = (compare(fault, seed) for fault in (SENSOR, EFFICIENCY))
    found = claims(sensor, efficiency, fired, seed)
    files: list[Path] = []
    if plot is not None:
        from gateway_plants.truck.study.figures import draw  # noqa: PLC0415 - slow to load

        files = draw(plot, sensor, efficiency, seed)
    document = {
        "study": "hybrid", "seeds": seeds, "first_seed": seed, "paper": found,
        "firing": [_finite(row) for row in fired],
        "disturbed": [_finite(row) for rows in told for row in rows],
    }  # fmt: skip
    tables = [
        beside(found),
        _firing_table(fired),
        _disturbed_table(told[0], "Trucks that differ from the model; onset 400 s"),
        _disturbed_table(told[1], "The same, thresholds learned from a healthy drive of that truck"),
    ]
    note = (
        "isolated: the fault's own DTC, no other fault's, nothing before the onset; ICDS and MCDS:"
        " the paper's systems; RDS:"
        "\nT1, T2, T5, T6 and the observer T7"
    )
    return show(document, tables, [note], files=files, json=json)
