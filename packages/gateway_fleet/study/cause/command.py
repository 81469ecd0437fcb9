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
from gateway_fleet.study.cause.judge import Verdict
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
        families: dict[str, list[Verdict]] = defaultdict(list)
        for row in apart:
            families[f"{kind}, {FAMILIES.get(row.plant, row.plant)}"].append(row.verdict)
        families[f"{kind} that can be told apart"] = [row.verdict for row in apart]
        families[kind] = [row.verdict for row in told]
        for family, verdicts in families.items():
            if verdicts and (family != kind or len(apart) < len(told)):
                console.print(_reliability(family, verdicts, [1.0] * len(verdicts)))
        rates = _rates(apart)
        if any(rates):
            console.print(_reliability(f"{kind}, each as often as its part fails", [r.verdict for r in apart], rates))
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


def _reliability(kind: str, verdicts: Sequence[Verdict], rates: Sequence[float]) -> Table:
    """Return how often what was told last is right, by the tenths of its probability; with Wilson's interval.

    Where runs count more or less, by their rates, the interval is of as many that count alike (Kish, "Survey sampling"
    (1965), section 11.7).
    """
    title = f"{kind}: is what was told last right as often as its probability says?"
    table = headed(title, ["told with"], ["runs", "mean", "right", "95 %"])
    edges = [*(k / 10 for k in range(10)), 0.99, 1.0]
    for low, high in itertools.pairwise(edges):
        pairs = zip(verdicts, rates, strict=True)
        mine = [(one, rate) for one, rate in pairs if low <= one.chance < high or one.chance == high == 1.0]
        if not mine:
            continue
        every = sum(rate for _, rate in mine)
        n, share = every**2 / sum(rate**2 for _, rate in mine), sum(one.right * rate for one, rate in mine) / every
        middle, z2 = share + _Z**2 / (2 * n), _Z**2
        apart = _Z * math.sqrt(share * (1.0 - share) / n + z2 / (4 * n * n))
        ends = (f"{(middle + sign * apart) / (1.0 + z2 / n):.1%}" for sign in (-1, 1))
        mean = sum(one.chance * rate for one, rate in mine) / every
        table.add_row(f"{low:g} to {high:g}", str(len(mine)), f"{mean:.1%}", f"{share:.1%}", " to ".join(ends))
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
