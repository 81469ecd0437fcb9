"""``gateway evaluate arena``."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from gateway.cli.present import say
from gateway_arena.contract import Plant
from gateway_arena.methods import METHODS, method
from gateway_arena.plants import NAMES, plant
from gateway_arena.plants.engine import Engine
from gateway_arena.plants.tennessee import NAME as TENNESSEE
from gateway_arena.plants.tennessee import is_there
from gateway_arena.plants.valve import ValvePlant
from gateway_arena.scenarios import judged_scenarios, narrow, table
from gateway_arena.score import Row, number, plain, threshold
from gateway_arena.trial import records, trial
from gateway_bench.cli.study import show, tabulate
from gateway_fdi.errors import InputError


def _table(rows: Sequence[Row], title: str) -> Table:
    columns: dict[str, Callable[[Row], object]] = {
        "plant": lambda row: row.plant,
        "method": lambda row: row.method,
        "runs": lambda row: row.runs,
        "det.\n[%]": lambda row: f"{100 * row.detected / row.runs:.0f}",
        "early": lambda row: row.early,
        "delay": lambda row: number(row.delay, 0),
        "P\ntrue": lambda row: number(row.true),
        "P\ngroup": lambda row: number(row.group),
        "wrong\nname": lambda row: "-" if math.isnan(row.true) else row.wrong,
        "false\nalarm": lambda row: f"{row.false}/{row.healthy}",
        "ROC\narea": lambda row: number(row.auc, 3),
        "CPU\n[us]": lambda row: number(row.us, 1),
    }
    return narrow(tabulate(title, (row for row in rows if not row.refused), columns, texts=2))


def _enough(count: int, false_alarm: float, key: str) -> None:
    """Refuse fewer healthy records than a threshold takes."""
    if threshold(np.zeros(count), false_alarm) == math.inf:
        least = math.ceil(1 / false_alarm) - 1
        raise InputError(f"{false_alarm:g} false alarms take {least} healthy records at least", key=key, value=count)


def _plants(names: Sequence[str], data: Path | None) -> list[Plant]:
    """Return the plants: those named, recordings; by default all that are installed."""
    if not names and data is None and not is_there():
        say(f"{TENNESSEE} is left out: pip install tep-studio")
        names = [name for name in NAMES if name != TENNESSEE]
    names = [each for name in names for each in name.split(",")]
    wanted = names if names or data is not None else NAMES
    return [*(plant(name) for name in wanted), *([] if data is None else [Engine(data)])]


def arena(
    *,
    plants: Sequence[str],
    methods: Sequence[str],
    runs: int,
    healthy: int,
    train: int,
    off: float,
    size: float,
    false_alarm: float,
    seed: int,
    scenarios: int,
    data: Path | None,
    plot: Path | None,
    json: bool,
) -> int:
    """Compare methods on plants; returns the exit code.

    Raises:
        InputError: no such plant or method; too few records for a threshold; a method that breaks its contract.
    """
    _enough(healthy, false_alarm, "--healthy")
    names = tuple(methods or METHODS)
    for name in names:
        method(name)
    rows: list[Row] = []
    of_scenarios: list[dict[str, Any]] = []
    for each in _plants(plants, data):
        say(f"{each.name} ({each.source}): {len(each.sizes)} faults ...")
        if isinstance(each, Engine):
            given = each.records()
            _enough(len(given.validated), false_alarm, "--data")
        else:
            given = records(each, seed, runs=runs, healthy=healthy, train=train, off=off, size=size)
        fitted = {name: method(name) for name in names}
        mine = [trial(name, made, each, given, false_alarm) for name, made in fitted.items()]
        rows += mine
        if isinstance(each, ValvePlant) and scenarios:
            judges = {row.method: (fitted[row.method], row.limit) for row in mine if not row.refused}
            of_scenarios = judged_scenarios(each, judges, scenarios, seed, off)
    if plot:
        from gateway_arena.figure import draw  # noqa: PLC0415 - drawing is slow to load

        draw(rows, plot)
    told = f"seeds from {seed}, {false_alarm:.0%} false alarms, parameters off {off:.0%}, faults times {size:g}"
    tables = [_table(rows, f"Arena: {told}")]
    for name in dict.fromkeys(row["method"] for row in of_scenarios):
        tables.append(table(of_scenarios, name, f"seeds from {seed}, parameters off {off:.0%}"))
    notes = [f"{row.plant}: {row.method} is not for it: {row.refused}" for row in rows if row.refused]
    for row in rows:
        if row.missed:
            missed = ", ".join(f"{fault} {count}" for fault, count in row.missed)
            notes.append(f"{row.plant}: {row.method} did not detect {missed}")
    notes.append(
        "det.: detected; early: alarms before the fault; delay: median, in samples; P: probability of the true fault,"
        " and of all that equations cannot tell from it, at the end, 0 where nothing is detected; CPU: of a sample"
    )
    document = {
        "study": "arena", "first_seed": seed, "false_alarm": false_alarm, "off": off, "size": size, "train": train,
        "rows": [plain(asdict(row)) for row in rows], "scenarios": [*map(plain, of_scenarios)],
    }  # fmt: skip
    return show(document, tables, notes, files=[plot] if plot else [], json=json)
