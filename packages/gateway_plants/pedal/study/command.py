"""``gateway evaluate pedal``."""

from __future__ import annotations

from math import isnan
from pathlib import Path

from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from gateway_bench.cli.study import Claim, beside, headed, show, tabulate
from gateway_plants.pedal.study import paper
from gateway_plants.pedal.study.cases import STROKES
from gateway_plants.pedal.study.follow import VOTERS
from gateway_plants.pedal.study.outside.roads import HOURS, Named, drives, jobs, names
from gateway_plants.pedal.study.table import FAULTS, RATES, VALUES, Score, monte_carlo, plan

#: Voters whose judgements are shown.
_JUDGED = ("KHR", "KHR*", "tracking")


def _share(value: float) -> str:
    return "-" if isnan(value) else f"{100 * value:.3f}"


def _errors(scores: list[Score], title: str) -> Table:
    """Return the IAE of all voters, a row a case."""
    table = headed(title, ["case"], ["oracle"])
    for voter in VOTERS:
        table.add_column(voter, justify="right", style="bold" if "tracking" in voter else None)
    for case in dict.fromkeys(score.case for score in scores):
        by = {score.voter: score for score in scores if score.case == case}
        cells = [f"{by[voter].iae:.3f} ({by[voter].median:.3f})" for voter in VOTERS]
        table.add_row(case, f"{by['tracking'].oracle:.2f}", *cells)
    return table


def _judgements(scores: list[Score], title: str) -> Table:
    """Return what the voters believed, a row a case."""
    judged = [f"{voter}\n{name}" for voter in _JUDGED for name in ("rejected", "accepted", "latched")]
    table = headed(title, ["case"], ["runs", *judged])
    for name in ("isolated\nwrongly", "isolated\nrightly", "drift\nseen", "after\n[ms]", "beyond\nd/2"):
        table.add_column(name, justify="right", style="bold")
    for case in dict.fromkeys(score.case for score in scores):
        by = {score.voter: score for score in scores if score.case == case}
        cells = []
        for voter in _JUDGED:
            s = by[voter]
            cells += [_share(s.rejected), _share(s.accepted), str(s.latched)]
        ours = by["tracking"]
        delay = "-" if isnan(ours.delay) else f"{ours.delay:.0f}"
        beyond = str(ours.beyond) if case == "drift" else "-"
        cells += [str(ours.false_isolations), str(ours.isolations), str(ours.drifts), delay, beyond]
        table.add_row(case, str(ours.runs), *cells)
    return table


def _tables(scores: list[Score]) -> list[Table]:
    tables = []
    faults = list(dict.fromkeys(map(str, FAULTS)))
    for environment in dict.fromkeys(score.environment for score in scores):
        mine = [s for s in scores if s.environment == environment and s.stroke == "exponential"]
        for cases, title in (
            (RATES, "Figs. 11, 13: fault rate, value 10 %"),
            (VALUES, "Figs. 12, 14: fault value, rate 10 %"),
        ):
            names = [str(case) for case in cases]
            rows = [next((s for s in mine if (s.case, s.voter) == (n, v)), None) for n in names for v in VOTERS]
            found = [row for row in rows if row is not None]
            if len(found) == len(rows):
                tables.append(_errors(found, f"IAE [V x sample], mean (median). {environment}. {title}"))
        rest = [s for name in faults for s in mine if s.case == name]
        tables.append(_errors(rest, f"IAE [V x sample], mean (median). {environment}"))
        if environment != "ideal, unclipped":
            tables.append(_judgements(rest, f"What was believed [%], and runs. {environment}"))
    for stroke in STROKES:
        for environment in dict.fromkeys(s.environment for s in scores if s.stroke == stroke):
            if stroke != "exponential":
                rest = [s for s in scores if (s.stroke, s.environment) == (stroke, environment)]
                tables.append(_errors(rest, f"IAE, mean (median). {environment}, {stroke} stroke"))
    return tables


def _seconds(value: float) -> str:
    return "-" if isnan(value) else f"{value:.3f}"


def _driven(rows: list[Named]) -> Table:
    """Return how faults were named, a row a fault."""
    return tabulate(
        "Faults and healthy drives, frames lost, late and swapped",
        rows,
        {
            "fault": lambda row: row.fault,
            "runs": lambda row: row.runs,
            "right first": lambda row: row.right,
            "visible": lambda row: row.visible,
            "right first\nof those": lambda row: row.visible_right,
            "its own channel": lambda row: row.own,
            "median [s]": lambda row: _seconds(row.median),
            "longest [s]": lambda row: _seconds(row.longest),
            "wrong": lambda row: row.wrong,
        },
    )


def pedal(*, runs: int, seed: int, roads: int, hours: float, json: bool, plot: Path | None) -> int:
    """Evaluate the voters, and the whole monitor; returns the exit code."""
    todo = plan(runs, seed) if runs else []
    trips = jobs(roads, hours, seed)
    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("voters", total=len(todo) + len(trips))
        scores = monte_carlo(todo, lambda: bar.advance(task))
        named = names(drives(trips, lambda: bar.advance(task)))
    files: list[Path] = []
    if plot is not None:
        from gateway_plants.pedal.study.figures import draw  # noqa: PLC0415 - slow to load

        files = draw(plot, scores, seed)
    claims: list[Claim] = paper.claims(scores) if scores else []
    document = {
        "study": "voters", "seeds": runs, "first_seed": seed, "paper": claims, "rows": scores, "roads": named,
    }  # fmt: skip
    tables, notes = [*([beside(claims)] if claims else []), *_tables(scores)], []
    if named:
        tables.append(_driven(named))
        last = seed + max(roads, round(hours / HOURS)) - 1
        notes.append(
            f"seeds {seed} to {last}; visible: the fault makes the channels differ by more than 2 % of the travel and"
            "\nfive standard deviations for 0.2 s, or both jump at once. wrong: runs in which a healthy channel was"
            f" named, or\nanything before the fault; of healthy drives, each {HOURS:g} h, those with a code."
        )
    if scores:
        notes.append(
            f"seeds {seed} to {seed + runs - 1}; runs of 1000 samples of 1 ms, 0 to 5 V. average, median: three"
            " channels, the others two. predictive, KHR: the\npaper's schemes as printed; KHR*: repaired."
            " oracle: mean of the two channels' healthy readings.\nrejected: healthy samples not used; accepted:"
            " faulty ones, more than 20 mV off, used; latched, isolated, drift: runs; beyond d/2: samples."
        )
    return show(document, tables, notes, files=files, json=json)
