"""The report of a fleet: its findings, the unusual values beside those of all cars, and its drives; and as CSV."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from html import escape
from pathlib import Path

from gateway_fdi.errors import InputError
from gateway_fleet.fleet.answer import Answer, clock
from gateway_fleet.fleet.peers import Unusual
from gateway_fleet.fleet.verdicts import Row
from gateway_fleet.html import table, write

#: Unusual values that are drawn.
_MOST_DRAWN = 30


def write_csv(path: Path, found: Answer) -> None:
    """Write the findings, a row each.

    Raises:
        InputError: it cannot be written.
    """
    try:
        with path.open("w", encoding="utf-8", newline="") as file:
            rows = csv.writer(file)
            rows.writerow(("car", "kind", "finding", "since", "DTCs", "logs", "log"))
            rows.writerows(one.row().values() for one in found.findings)
    except OSError as error:
        raise InputError(error.strerror or str(error), file=path) from error


def write_report(path: Path, found: Answer, source: Path) -> None:
    """Write the page.

    Args:
        path: of it.
        found: what the tables say.
        source: folder of the tables.

    Raises:
        InputError: it cannot be written.
    """
    hours = sum(row["seconds"] for row in found.logs) / 3600.0
    parts = [
        f'<p class="lead">{escape(found.verdict())}</p>',
        f"<p>{len(found.cars)} cars, {len(found.logs)} logs, {hours:.1f} h; times are UTC. Tables:"
        f" {escape(str(source))}</p>",
        "<h2>Findings</h2>",
        table([one.row() for one in found.findings]),
    ]
    if found.unusual:
        parts += [
            "<h2>Unusual values</h2><p>Each dot is a car; the red one is the car that is named. Unusual is no fault:"
            " cars that are used otherwise are unusual, too.</p>",
            *(_strip(one, found.tests) for one in found.unusual[:_MOST_DRAWN]),
        ]
    parts += ["<h2>Drives</h2>", table([_drive(row) for row in found.logs])]
    write(path, "Report of a fleet", parts)


def _drive(row: Row) -> dict[str, object]:
    return {
        "car": row["device"], "begin": clock(row["begin"]), "minutes": round(row["seconds"] / 60.0, 1),
        "km": None if row["km"] is None else round(row["km"], 1), "state": row["state"], "DTCs": row["dtcs"],
        "log": row["path"],
    }  # fmt: skip


def _strip(one: Unusual, tests: Sequence[Row]) -> str:
    """Return a line of all cars' values of a test, with the axis' ends and its unit."""
    side = "low" if one.value < one.low else "high"
    pick = min if side == "low" else max
    cars: dict[str, float] = {}
    for row in tests:
        if row["fault"] == one.fault and row[side] is not None:
            cars[row["device"]] = pick(cars.get(row["device"], row[side]), row[side])
    begin, end = min(cars.values()), max(cars.values())
    dots = "".join(
        f'<i{" class=odd" if car == one.device else ""} title="{escape(car)}: {value:.4g}"'
        f' style="left:{100 * (value - begin) / ((end - begin) or 1.0):.1f}%"></i>'
        for car, value in sorted(cars.items(), key=lambda item: item[0] == one.device)
    )
    name = escape(one.tested or "value of the test")
    return (
        f"<h3>{escape(one.device)}: {escape(one.fault)}</h3>"
        f'<div class="strip" role="img" aria-label="{escape(one.device)} {one.value:.4g}, others {one.low:.4g} to'
        f' {one.high:.4g}">{dots}</div>'
        f'<div class="axis"><span>{begin:.4g}</span><span>{name}, {"lowest" if side == "low" else "highest"} of each'
        f" car</span><span>{end:.4g}</span></div>"
    )
