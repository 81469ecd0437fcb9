"""``gateway evaluate crank``."""

from __future__ import annotations

from math import isnan
from pathlib import Path

from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from gateway_bench.cli.study import beside, headed, show
from gateway_plants.crank.study import outside as beyond
from gateway_plants.crank.study import paper
from gateway_plants.crank.study.follow import METHODS
from gateway_plants.crank.study.table import (
    KINDS,
    Alarms,
    Score,
    alarm_jobs,
    false_alarms,
    fault_jobs,
    monte_carlo,
)


def _share(value: float) -> str:
    return "-" if isnan(value) else f"{100 * value:.2f}"


def _scores(scores: list[Score]) -> list[Table]:
    tables = []
    for group in dict.fromkeys(score.group for score in scores):
        table = headed(f"Faults: {group}", ["wheel", "fault"], ["runs"])
        for name in ("detected", "named", "labelled", "delay", "at once"):
            table.add_column(f"adaptive\n{name}", justify="right", style="bold")
        for method in ("ratio", "threshold"):
            table.add_column(f"{method}\nlabelled", justify="right")
            table.add_column("wrong/\nno sync", justify="right")
        mine = [score for score in scores if score.group == group]
        for key in dict.fromkeys((score.wheel, score.kind, score.count) for score in mine):
            by = {s.method: s for s in mine if (s.wheel, s.kind, s.count) == key}
            ours = by["adaptive"]
            row = [key[0], f"{key[2]} {key[1]}", str(ours.runs)]
            row += [_share(v) for v in (ours.detected, ours.named, ours.labelled)]
            row += [f"{ours.delay:.2f}", _share(ours.at_once)]
            for method in ("ratio", "threshold"):
                peer = by[method]
                row += [_share(peer.labelled), f"{peer.wrong:.2f}/{peer.unsynced:.2f}"]
            table.add_row(*row, end_section=(key[1], key[2]) == KINDS[-1])
        tables.append(table)
    return tables


def _alarm_table(rows: list[Alarms]) -> Table:
    methods = list(dict.fromkeys(row.method for row in rows))
    title = "Healthy engine: false alarms per million pulses (wrong labels in brackets)"
    table = headed(title, ["case"], ["wheel", "jitter", "pulses", *methods])
    for key in dict.fromkeys((row.case, row.wheel, row.jitter) for row in rows):
        mine = {row.method: row for row in rows if (row.case, row.wheel, row.jitter) == key}
        shown = [f"{mine[m].per_million:.1f} ({mine[m].wrong})" for m in methods]
        pulses = str(mine[methods[0]].pulses)
        table.add_row(key[0], key[1], f"{100 * key[2]:.0f} %", pulses, *shown)
    return table


def _outside_table(rows: list[beyond.Outcome]) -> Table:
    """Return the cases outside the regular sweep: runs with a report, and with a wrong tooth that was proven."""
    title = "Outside the regular sweep: runs with a report / with a wrong proven tooth / % of pulses unproven"
    table = headed(title, ["group", "case", "runs", *METHODS, "adaptive reported"])
    sums = list(beyond.summed(rows))
    for group, case in dict.fromkeys((row.group, row.case) for row in sums):
        mine = {row.method: row for row in sums if (row.group, row.case) == (group, case)}
        shown = [f"{r.reports} / {r.wrong} / {100 * r.unsynced:.1f}" for r in mine.values()]
        named = ", ".join(f"{name} {count}" for name, count in mine["adaptive"].named.items())
        table.add_row(group, case, str(mine["adaptive"].runs), *shown, named)
    return table


def crank(*, runs: int, pulses: int, outside: int, seed: int, json: bool, plot: Path | None) -> int:
    """Evaluate the crankshaft methods; returns the exit code."""
    faults, healthy = fault_jobs(runs, seed), alarm_jobs(pulses, seed)
    others = beyond.jobs(outside, seed) if outside else []
    with Progress(console=Console(stderr=True), transient=True) as bar:
        total = (len(faults) if runs else 0) + len(healthy) + len(others)
        task = bar.add_task("crank", total=total)
        scores = monte_carlo(runs, seed, lambda: bar.advance(task)) if runs else []
        alarms = false_alarms(pulses, seed, lambda: bar.advance(task)) if pulses else []
        rows = beyond.outside(outside, seed, lambda: bar.advance(task)) if outside else []
    files: list[Path] = []
    if plot is not None:
        from gateway_plants.crank.study.figures import draw  # noqa: PLC0415 - slow to load

        files = draw(plot, seed)
    claims = paper.claims()
    document = {
        "paper": claims, "seed": seed,
        "faults": scores, "healthy": alarms,
        "outside": rows,
    }  # fmt: skip
    tables = [beside(claims), *_scores(scores)]
    tables += [_alarm_table(alarms)] if alarms else []
    tables += [_outside_table(rows)] if rows else []
    notes = [_explained(seed)] if scores or alarms else []
    return show(document, tables, notes, files=files, json=json)


def _explained(seed: int) -> str:
    return (
        f"seed {seed}. adaptive: the method of crank_sync; ratio: as FOME and rusEFI find the gap;"
        " threshold: as Speeduino does, filter 50 %.\n"
        "detected, named (direction and count), labelled (every tooth right from 4 pulses after the"
        " fault for 3 turns), at once: % of runs; delay: pulses from\nthe fault's last pulse to the"
        " report; wrong, no sync: turns after the fault with a wrong tooth, with none."
    )
