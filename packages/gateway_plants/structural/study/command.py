"""``gateway evaluate structural``."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from tempfile import TemporaryDirectory

from rich.table import Table

from gateway.cli.present import print_json, say, wide_console
from gateway_fdi.errors import InputError, nearest
from gateway_plants.structural.study.foreign import PLANTS
from gateway_plants.structural.study.roads import Row, evaluate


def _table(rows: list[Row]) -> Table:
    table = Table(title="Plants of other make")
    table.add_column("plant")
    for name in (
        "off by\n[%]", "healthy\n[h]", "drives\nwith a code", "faults", "named", "behind\nanother", "group", "unseen",
        "wrong", "median\ndelay [s]",
    ):  # fmt: skip
        table.add_column(name, justify="right")
    for row in rows:
        counts = (row.runs, row.named, row.later, row.group, row.unseen, len(row.wrong))
        table.add_row(
            row.plant, f"{100 * row.share:g}", f"{row.hours:.1f}", str(len(row.false)), *map(str, counts),
            f"{row.delay_s:.2f}",
        )  # fmt: skip
    return table


def structural(
    *, hours: float, runs: int, shares: Sequence[float], plants: Sequence[str] | None, seed: int, json: bool
) -> int:
    """Evaluate monitors from equations; returns the exit code.

    Raises:
        InputError: there is no such plant.
    """
    rows = []
    for name in plants or PLANTS:
        if name not in PLANTS:
            raise InputError(f"the plants are {', '.join(PLANTS)}{nearest(name, PLANTS)}", key="--plant", value=name)
        for share in shares:
            say(f"{name}, parameters off by {100 * share:g} % ...")
            with TemporaryDirectory() as folder:
                rows.append(evaluate(PLANTS[name], share, hours, runs, seed, Path(folder)))
    if json:
        found = [asdict(row) | {"delay_s": None if math.isnan(row.delay_s) else row.delay_s} for row in rows]
        print_json({"study": "structural", "first_seed": seed, "rows": found})
        return 0
    console = wide_console()
    console.print(_table(rows))
    for row in rows:
        for number, code in row.false:
            console.print(f"{row.plant}, {100 * row.share:g} %: healthy drive of seed {number} has {code}")
        for fault, number, codes in row.wrong:
            console.print(f"{row.plant}, {100 * row.share:g} %: {fault} of seed {number} has {', '.join(codes)}")
    console.print("named: first and only by its name, or that of its group; group: only unisolated, or a larger group")
    return 0
