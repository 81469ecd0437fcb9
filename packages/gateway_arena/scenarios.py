"""The 44 scenarios of the DAMADICS valve: what methods that are fitted say of them, in the official indexes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from rich.table import Table

from gateway_arena.contract import Method
from gateway_arena.indexes import INDEXES, decided, middle
from gateway_arena.plants.valve import SCENARIOS, Scenario, ValvePlant
from gateway_arena.score import NAMED, diagnoses, number
from gateway_bench.cli.study import tabulate

#: Seeds from the first on, further than those of records; explanations of a scenario, if a method gives them in turn.
SEEDS, EXPLAINED = 50_000, 100


def judged_scenarios(
    plant: ValvePlant,
    fitted: Mapping[str, tuple[Method, float]],
    runs: int,
    seed: int,
    off: float,
    scenarios: Sequence[Scenario] = SCENARIOS,
) -> list[dict[str, Any]]:
    """Return what methods say of the scenarios: how often the fault is detected, and its diagnosis named, at the end.

    Args:
        plant: the valve.
        fitted: name -> method that is fitted, and the score above which it alarms.
        runs: of each scenario that is not incipient; an incipient one is run once.
        seed: the first one.
        off: share by which parameters differ from the model's.
        scenarios: some of the 44.
    """
    faults = list(plant.sizes)
    alike = diagnoses(plant.model, faults)
    rows = []
    for nth, scenario in enumerate(scenarios):
        count, own = 1 if scenario.develop_s else runs, faults.index(scenario.fault)
        made = [plant.scenario(scenario, seed + SEEDS + 1000 * nth + k, off) for k in range(count)]
        for name, (method, limit) in fitted.items():
            if hasattr(method, "every"):
                method.every = max(scenario.lasts_s // EXPLAINED, 15)
            said = [method.run(record) for record, _ in made]
            found = [decided(one, limit, own, alike, strength) for one, (_, strength) in zip(said, made, strict=True)]
            last = [one.score[-1] > limit for one in said]
            named = [
                bool(there) and one.weights is not None and one.weights[-1, alike[own]].sum() > NAMED
                for one, there in zip(said, last, strict=True)
            ]
            rows.append({
                "method": name, "fault": scenario.fault, "mode": scenario.mode, "runs": count,
                "detected": sum(map(bool, last)), "isolated": sum(map(bool, named)), **middle(found),
            })  # fmt: skip
    return rows


def narrow(wide: Table) -> Table:
    """Return a table without lines, which fits a terminal of 80 columns."""
    wide.box, wide.pad_edge, wide.padding = None, False, (0, 1, 0, 0)
    return wide


def table(rows: Sequence[Mapping[str, Any]], name: str, told: str) -> Table:
    """Return the table of a method."""
    first = {"fault": "fault", "mode": "mode", "runs": "runs", "det.": "detected", "isol.": "isolated"}
    heads: dict[str, Any] = {head: lambda row, key=key: row[key] for head, key in first.items()}
    for key in INDEXES:
        head, digits = (f"{key}\n[s]", 0) if key.startswith("t_") else (key, 2)
        heads[head] = lambda row, key=key, digits=digits: number(row[key], digits)
    return narrow(tabulate(f"DAMADICS: {name}, {told}", [row for row in rows if row["method"] == name], heads, texts=2))
