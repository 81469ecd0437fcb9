"""``gateway evaluate cause``."""

from __future__ import annotations

import itertools
import math
from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn
from rich.table import Table

from gateway.cli.present import print_json, wide_console
from gateway_bench.cli.study import headed
from gateway_fleet.study.cause.cars import learned
from gateway_fleet.study.cause.cases import FAMILIES
from gateway_fleet.study.cause.matrix import Job, Row, done, folder_of, healthy, pairs, singles

#: Of a normal distribution, 95 % on both sides.
_Z = 1.96


def cause(*, seeds: int, pair_runs: int, healthy_runs: int, seed: int, work: Path, json: bool) -> int:
    """Run the matrix and print it; returns the exit code."""
    cars = learned(folder_of(work))
    kinds: dict[str, list[Job]] = {
        "one fault": list(singles(range(seed, seed + seeds), cars)),
        "two faults": list(pairs(pair_runs, seed, cars)),
        "healthy": list(healthy(range(seed, seed + healthy_runs))),
    }
    console = wide_console()
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
    with Progress(*columns, console=console, disable=json) as progress:
        rows: dict[str, list[Row]] = {}
        for kind, jobs in kinds.items():
            task = progress.add_task(kind, total=len(jobs))
            rows[kind] = done(jobs, lambda task=task: progress.advance(task)) if jobs else []  # type: ignore[misc]
    if json:
        print_json({"seed": seed, **{kind: [asdict(row) for row in some] for kind, some in rows.items()}})
        return 0
    for kind, some in rows.items():
        apart = [row for row in some if row.verdict.told_apart]
        if some:
            console.print(_table(kind, some))
        if len(apart) < len(some):
            console.print(_table(f"{kind} that the models' structure tells apart", apart))
    for kind, some in rows.items():
        told = [row for row in some if row.verdict.chance > 0.0]
        apart = [row for row in told if row.verdict.told_apart]
        families: dict[str, list[Row]] = defaultdict(list)
        for row in apart:
            families[f"{kind}, {FAMILIES.get(row.plant, row.plant)}"].append(row)
        families[f"{kind} that can be told apart"] = apart
        families[kind] = told
        for family, mine in families.items():
            if mine and (family != kind or len(apart) < len(told)):
                console.print(_reliability(family, mine, [1.0] * len(mine)))
        rates = _rates(apart)
        if any(rates):
            console.print(_reliability(f"{kind}, each as often as its part fails", apart, rates))
    return 0


def draw(figures: Path, work: Path) -> int:
    """Draw the pictures of docs/cause.md; returns the exit code."""
    from gateway_fleet.study.cause.figures import draw_all  # noqa: PLC0415 - matplotlib is slow to load

    for path in draw_all(figures, folder_of(work)):
        wide_console().print(path)
    return 0


def _table(kind: str, rows: Sequence[Row]) -> Table:
    title = f"{kind}: {len(rows)} runs, {sum(row.seconds for row in rows) / 3600:.1f} h"
    numbers = ("runs", "seen", "first", "in three", "alone", "told", "healthy named", "before")
    table = headed(title, ["plant"], numbers)
    by_plant: dict[str, list[Row]] = defaultdict(list)
    for row in rows:
        by_plant[row.plant].append(row)
    for plant, mine in by_plant.items():
        table.add_row(plant, *_counts(mine))
    table.add_row("all", *_counts(rows), style="bold")
    return table


def _rates(rows: Sequence[Row]) -> list[float]:
    """Return how often each run would be, where parts fail as often as their priors say."""
    alike = Counter((row.plant, row.part) for row in rows)
    return [row.rate / alike[row.plant, row.part] for row in rows]


def _reliability(kind: str, rows: Sequence[Row], rates: Sequence[float]) -> Table:
    """Return how often what was told last is right, by the tenths of its probability; with Wilson's interval.

    Runs of one case are much alike, and runs count more or less, by their rates: the interval is of as many cases that
    count alike (Kish, "Survey sampling" (1965), section 11.7).
    """
    title = f"{kind}: is what was told last right as often as its probability says?"
    table = headed(title, ["told with"], ["runs", "cases", "mean", "right", "95 %"])
    edges = [*(k / 10 for k in range(10)), 0.99, 1.0]
    for low, high in itertools.pairwise(edges):
        cases: dict[tuple[str, frozenset[str]], float] = defaultdict(float)
        runs, mean, right = 0, 0.0, 0.0
        for row, rate in zip(rows, rates, strict=True):
            told = row.verdict
            if low <= told.chance < high or told.chance == high == 1.0:
                cases[row.plant, frozenset(row.name.split(" + "))] += rate
                runs, mean, right = runs + 1, mean + rate * told.chance, right + rate * told.right
        if not cases:
            continue
        every = sum(cases.values())
        n, share = every**2 / sum(rate**2 for rate in cases.values()), right / every
        middle, z2 = share + _Z**2 / (2 * n), _Z**2
        apart = _Z * math.sqrt(max(share * (1.0 - share), 0.0) / n + z2 / (4 * n * n))
        ends = (f"{(middle + sign * apart) / (1.0 + z2 / n):.1%}" for sign in (-1, 1))
        counts = str(runs), str(len(cases)), f"{mean / every:.1%}", f"{share:.1%}"
        table.add_row(f"{low:g} to {high:g}", *counts, " to ".join(ends))
    return table


def _counts(rows: Sequence[Row]) -> list[str]:
    verdicts = [row.verdict for row in rows]
    seen = [one for one in verdicts if one.seen]

    def of_seen(count: int) -> str:
        return f"{count} ({count / len(seen):.0%})" if seen else "-"

    return [
        str(len(verdicts)),
        str(len(seen)),
        of_seen(sum(one.place == 1 for one in seen)),
        of_seen(sum(1 <= one.place <= 3 for one in seen)),
        of_seen(sum(one.alone for one in seen)),
        of_seen(sum(one.cause for one in seen)),
        str(sum(bool(one.healthy) for one in verdicts)),
        str(sum(one.before for one in verdicts)),
    ]
