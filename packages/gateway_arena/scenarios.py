"""The 44 scenarios of the DAMADICS valve: what methods that are fitted say of them, in the official indexes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from typing import Any

from rich.table import Table

from gateway.cli.study import tabulate
from gateway_arena.contract import Method
from gateway_arena.indexes import Indexes, decided, middle
from gateway_arena.plants.valve import SCENARIOS, Scenario, ValvePlant
from gateway_arena.score import NAMED, diagnoses, number, plain

#: Seeds from the first on, further than those of records; explanations of a scenario, if a method gives them in turn.
SEEDS, EXPLAINED = 50_000, 100


@dataclass(frozen=True)
class ScenarioRow:
    """A method on a scenario.

    Attributes:
        method: its name.
        scenario: the scenario.
        runs: with other noise.
        detected: of these with the detection decision at the end.
        isolated: of these with the fault's diagnosis at the end.
        indexes: their medians.
    """

    method: str
    scenario: Scenario
    runs: int
    detected: int
    isolated: int
    indexes: Indexes

    def plain(self) -> dict[str, Any]:
        """Return it as JSON has it."""
        return {
            "method": self.method, "fault": self.scenario.fault, "mode": self.scenario.mode, "runs": self.runs,
            "detected": self.detected, "isolated": self.isolated, **plain(asdict(self.indexes)),
        }  # fmt: skip


def judged_scenarios(
    plant: ValvePlant,
    fitted: Mapping[str, tuple[Method, float]],
    runs: int,
    seed: int,
    off: float,
    scenarios: Sequence[Scenario] = SCENARIOS,
) -> list[ScenarioRow]:
    """Return what methods say of the scenarios.

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
            rows.append(ScenarioRow(name, scenario, count, sum(map(bool, last)), sum(map(bool, named)), middle(found)))
    return rows


def narrow(wide: Table) -> Table:
    """Return a table without lines, which fits a terminal of 80 columns."""
    wide.box, wide.pad_edge, wide.padding = None, False, (0, 1, 0, 0)
    return wide


def table(rows: Sequence[ScenarioRow], name: str, told: str) -> Table:
    """Return the table of a method."""
    heads: dict[str, Any] = {
        "fault": lambda row: row.scenario.fault, "mode": lambda row: row.scenario.mode, "runs": lambda row: row.runs,
        "det.": lambda row: row.detected, "isol.": lambda row: row.isolated,
    }  # fmt: skip
    for key in (field.name for field in fields(Indexes)):
        head, digits = (f"{key}\n[s]", 0) if key.startswith("t_") else (key, 2)
        heads[head] = lambda row, key=key, digits=digits: number(getattr(row.indexes, key), digits)
    return narrow(tabulate(f"DAMADICS: {name}, {told}", [row for row in rows if row.method == name], heads, texts=2))
