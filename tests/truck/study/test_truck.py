"""gateway evaluate truck: the drive it follows is the bus's, and what the command prints and draws.

Seeds from 30000 on: nothing was chosen on them.
"""

import json
from dataclasses import replace

import numpy as np
import paper_tables
import pytest
from amount import amount
from truck_runs import NAMES, TRUCK, driven, run
from typer.testing import CliRunner

from gateway.cli import app
from gateway_bench.cli.study import Claim
from gateway_fdi.jit import COMPILED
from gateway_plants.truck.ecu.params import TruckFault
from gateway_plants.truck.monitor.faults import faults_of
from gateway_plants.truck.monitor.isolation import TESTS
from gateway_plants.truck.monitor.params import Params
from gateway_plants.truck.study import command, paper, table
from gateway_plants.truck.study.follow import DURATION, calibrated, follow, inputs
from gateway_plants.truck.study.table import FAULTS, SYSTEMS, Case, judge

pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(not COMPILED, reason="hundreds of thousands of sets"),
]


def test_the_drive_is_the_one_that_the_engine_sees():
    """Peaks to the last bit, and the second in which each DTC came, through frames, database and engine."""
    seed = 30_500
    fault = TruckFault(kind="machine_resistance", from_s=400.0)
    found = follow(inputs(TRUCK, fault, seed), Params())
    peak, sets, events = run(driven("machine_resistance", 400.0), seed)
    assert sets == round(DURATION * 100)
    assert dict(zip(NAMES, map(float, found.peak), strict=True)) == peak
    for place, known in enumerate(faults_of(TESTS)):
        times = [t for t, code, now in events if now and code == known.dtc]
        if times:
            assert times[0] == pytest.approx(found.first[place], abs=0.002)
        else:
            assert np.isinf(found.first[place])


def test_faults_are_in_the_monitors_order():
    assert [fault.name for fault in faults_of(TESTS)][:-1] == list(FAULTS)


def test_thresholds_can_be_learned_anew():
    """A truck with 5 % more torque: ICDS alarms, and does not with thresholds of that truck, which it pays for
    (the note).
    """
    rows = {r.system: r for r in judge(Case("engine +5 %", None, 0.0, (30_001,)))}
    assert [rows[s].right for s in SYSTEMS] == [0, 0, 1]
    healthy = Case("engine +5 %", None, 0.0, (30_001,), (40_001,))
    assert [r.right for r in judge(healthy)] == [1, 1, 1]
    lost = judge(replace(healthy, fault="machine_voltage_sensor", onset=400.0))
    assert [r.right for r in lost] == [0, 1, 1]


def test_calibration_here_is_that_of_the_command():
    """nu and J of the shipped parameters come back from healthy drives."""
    drives = [inputs(TRUCK, None, seed) for seed in (1000, 1005)]
    found = calibrated(Params(), drives)
    for residual, value in found.nu.model_dump().items():
        assert value == pytest.approx(getattr(Params().nu, residual), rel=0.02)
    assert found.thresholds.T7 == Params().thresholds.T7
    assert 50.0 <= found.thresholds.T2 <= Params().thresholds.T2
    assert paper.calibrated(paper.Paper(), drives).nu == pytest.approx(paper.Paper().nu, rel=0.02)


def test_the_command(tmp_path, monkeypatch):
    """One truck of the twelve, and one system of three, two in the full size; the rest takes minutes."""
    systems = amount(("ICDS", "RDS"), ("RDS",))
    few = {name: table.DISTURBANCES[name] for name in ("slope 0.3 %",)}
    monkeypatch.setattr(command, "DISTURBANCES", few)
    for module in (command, table):
        monkeypatch.setattr(module, "ONSETS", (400.0,))
        monkeypatch.setattr(module, "SYSTEMS", systems)
    said = CliRunner().invoke(app, ["evaluate", "hybrid", "--json", "--plot", str(tmp_path)], env={"COLUMNS": "200"})
    assert said.exit_code == 0, said.output
    told = json.loads(said.stdout)
    assert {(r["system"], r["right"]) for r in told["firing"]} == {(name, 1) for name in systems}
    robust = [r for r in told["disturbed"] if r["system"] == "RDS"]
    assert len(robust) == 2 * 6
    mine = [Claim(**each) for each in told["paper"] if not each["what"].startswith("VI-E")]
    made = paper_tables.text("gateway evaluate truck", mine)
    page = (paper_tables.DOCS / "truck/paper.txt").read_text()
    assert [line for line in made.splitlines() if line not in page] == []
    assert len(mine) == 7
    assert all(r["right"] == r["runs"] and r["wrong"] == 0 for r in robust)
    integral = [
        r
        for r in told["disturbed"]
        if (r["system"], r["disturbance"], r["relearned"]) == ("ICDS", "slope 0.3 %", False)
    ]
    assert {r["right"] for r in integral} == {0 for name in systems if name == "ICDS"}
    drawn = sorted(path.name for path in tmp_path.iterdir())
    assert drawn == ["fig5.png", "fig6.png", "fig7.png", "fig8.png", "fig9.png", "observer.png"]
    assert all((tmp_path / name).stat().st_size > 20_000 for name in drawn)


@pytest.mark.full("13 s")
def test_the_tables(monkeypatch):
    monkeypatch.setattr(command, "DISTURBANCES", {"none": {}})
    for module in (command, table):
        monkeypatch.setattr(module, "ONSETS", (1200.0,))
        monkeypatch.setattr(module, "SYSTEMS", ("MCDS",))
    said = CliRunner().invoke(app, ["evaluate", "hybrid"], env={"COLUMNS": "200"})
    assert said.exit_code == 0, said.output
    assert "Trucks that differ from the model" in said.output
    assert said.output.count("all, silent without") == 2
    assert "none: silent" in said.output
