"""Results of studies: tables that show their units, and one document."""

import json
from dataclasses import dataclass
from pathlib import Path

from gateway_bench.cli.study import show, tabulate


@dataclass
class Run:
    name: str
    delay_s: float


RUNS = [Run("gap", 0.25), Run("noise", 1.5)]


def table():
    return tabulate("Delays [s]", RUNS, {"fault": lambda run: run.name, "delay\n[s]": lambda run: f"{run.delay_s:.2f}"})


def test_a_table_shows_units_in_brackets(capsys):
    assert show({}, [table()], ["delay: to the DTC"], files=[Path("a.svg")], json=False) == 0
    shown = capsys.readouterr().out
    assert "Delays [s]" in shown
    assert "[s]" in shown.split("Delays [s]")[1]
    assert "0.25" in shown
    assert shown.rstrip().endswith("delay: to the DTC\ndrawn: a.svg")


def test_a_document_has_rows_and_files(capsys):
    assert show({"seed": 1, "rows": RUNS}, [table()], files=[Path("a.svg")], json=True) == 0
    rows = [{"name": "gap", "delay_s": 0.25}, {"name": "noise", "delay_s": 1.5}]
    assert json.loads(capsys.readouterr().out) == {"seed": 1, "rows": rows, "files": ["a.svg"]}
