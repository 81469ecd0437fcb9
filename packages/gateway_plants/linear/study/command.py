"""``gateway evaluate linear``."""

from __future__ import annotations

from pathlib import Path

from rich.table import Table

from gateway.cli.present import say
from gateway_bench.cli.study import beside, show, tabulate
from gateway_plants.linear.study import example, paper
from gateway_plants.linear.study.bank import Quiet, quiet
from gateway_plants.linear.study.holdout import Row, holdout


def _holdout_table(rows: list[Row]) -> Table:
    return tabulate(
        "Random cases that nothing was chosen on",
        rows,
        {
            "at fault": lambda row: row.case,
            "decided by": lambda row: row.method,
            "cases": lambda row: row.cases,
            "clean [%]": lambda row: f"{100 * row.clean:.1f}",
            "not\nmasked": lambda row: row.unmasked,
            "clean of\nthose [%]": lambda row: f"{100 * row.clean_unmasked:.1f}",
            "missed": lambda row: row.missed,
            "false": lambda row: row.false,
            "dropped": lambda row: row.dropped,
            "mean delay\n[s]": lambda row: f"{row.delay_s:.2f}",
        },
        texts=2,
    )


def _quiet_table(rows: list[Quiet]) -> Table:
    return tabulate(
        "Healthy flight, commands moving, plant stabilised",
        rows,
        {
            "noise of each sensor": lambda row: f"{row.noise:g}",
            "hours judged": lambda row: f"{row.hours:.2f}",
            "false alarms": lambda row: row.alarms,
        },
        texts=0,
    )


def linear(*, cases: int, hours: float, seed: int, json: bool, plot: Path | None) -> int:
    """Evaluate the bank of PI observers; returns the exit code."""
    figures = paper.figures()
    claims = paper.claims(figures)
    if cases:
        say(f"{cases} random cases, seeds from {seed} on ...")
    rows = holdout(cases, seed) if cases else []
    flown = [quiet(sigma, hours, seed) for sigma in (0.005, example.NOISE)] if hours else []
    files: list[Path] = []
    if plot is not None:
        from gateway_plants.linear.study.figures import draw  # noqa: PLC0415 - slow to load

        files = draw(plot, rows)
    document = {
        "study": "pi-bank", "seeds": cases, "first_seed": seed, "paper": claims, "figures": figures,
        "rows": rows, "healthy": flown,
    }  # fmt: skip
    tables = [beside(claims)]
    tables += [_holdout_table(rows)] if rows else []
    tables += [_quiet_table(flown)] if flown else []
    note = (
        "clean: the right flags, no other, none that goes down again; products: (15) latched, (16)"
        " over all observers, or as"
        "\nprinted; masked: (16) loses the actuator's fault in the stationary state of an observer"
    )
    return show(document, tables, [note], files=files, json=json)
