"""``gateway evaluate linear``."""

from __future__ import annotations

from dataclasses import asdict
from math import isinf
from pathlib import Path

from rich.table import Table

from gateway.cli.present import print_json, say, wide_console
from gateway_plants.linear.study import example
from gateway_plants.linear.study.bank import Quiet, quiet
from gateway_plants.linear.study.continuous import observe, spans
from gateway_plants.linear.study.holdout import Row, holdout


def _span(found: list[tuple[float, float]]) -> str:
    return " ".join(f"[{on:g}, {'end' if isinf(off) else f'{off:g}'})" for on, off in found) or "-"


def _paper() -> list[dict[str, str]]:
    rows = []
    for name, parts in example.FIGURES.items():
        told = observe(*example.held(example.case(*parts)))
        row = {"figure": name, "case": " ".join(parts)}
        for i in range(2):
            row[f"r_a{i + 1}"] = _span(spans(told.actuators[:, i]))
            row[f"r_a{i + 1} as printed"] = _span(spans(told.printed[:, i]))
        for i in range(3):
            row[f"r_s{i + 1}"] = _span(spans(told.sensors[:, i]))
        rows.append(row)
    return rows


def _figures_table(rows: list[dict[str, str]]) -> Table:
    table = Table(title="The paper's Figs. 3 to 11: flags by (15) and (16), continuous observers [s]")
    for name in rows[0]:
        table.add_column(name)
    for row in rows:
        table.add_row(*row.values())
    return table


def _holdout_table(rows: list[Row]) -> Table:
    table = Table(title="Random cases that nothing was chosen on")
    table.add_column("at fault")
    table.add_column("decided by")
    for name in (
        "cases",
        "clean [%]",
        "not\nmasked",
        "clean of\nthose [%]",
        "missed",
        "false",
        "dropped",
        "mean delay\n[s]",
    ):
        table.add_column(name, justify="right")
    for row in rows:
        table.add_row(
            row.case,
            row.method,
            str(row.cases),
            f"{100 * row.clean:.1f}",
            str(row.unmasked),
            f"{100 * row.clean_unmasked:.1f}",
            str(row.missed),
            str(row.false),
            str(row.dropped),
            f"{row.delay_s:.2f}",
        )
    return table


def _quiet_table(rows: list[Quiet]) -> Table:
    table = Table(title="Healthy flight, commands moving, plant stabilised")
    for name in ("noise of each sensor", "hours judged", "false alarms"):
        table.add_column(name, justify="right")
    for row in rows:
        table.add_row(f"{row.noise:g}", f"{row.hours:.2f}", str(row.alarms))
    return table


def linear(*, cases: int, hours: float, seed: int, json: bool, plot: Path | None) -> int:
    """Evaluate the bank of PI observers; returns the exit code."""
    paper = _paper()
    if cases:
        say(f"{cases} random cases, seeds from {seed} on ...")
    rows = holdout(cases, seed) if cases else []
    flown = [quiet(sigma, hours, seed) for sigma in (0.005, example.NOISE)] if hours else []
    files: list[Path] = []
    if plot is not None:
        from gateway_plants.linear.study.figures import draw  # noqa: PLC0415 - slow to load

        files = draw(plot, rows)
    if json:
        print_json(
            {
                "study": "pi-bank",
                "seeds": cases,
                "first_seed": seed,
                "figures": paper,
                "rows": [asdict(row) for row in rows],
                "healthy": [asdict(row) for row in flown],
                "files": [str(file) for file in files],
            }
        )
        return 0
    console = wide_console()
    console.print(_figures_table(paper))
    if rows:
        console.print(_holdout_table(rows))
    if flown:
        console.print(_quiet_table(flown))
    console.print(
        "clean: the right flags, no other, none that goes down again; products: (15) latched, (16)"
        " over all observers, or as"
        "\nprinted; masked: (16) loses the actuator's fault in the stationary state of an observer"
    )
    for file in files:
        console.print(f"drawn: {file}")
    return 0
