"""``gateway evaluate steering``."""

from __future__ import annotations

from dataclasses import asdict
from math import isnan
from pathlib import Path

from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from gateway.cli.present import print_json, wide_console
from gateway_fdi.stopping import RULES
from gateway_plants.steering.study import operations
from gateway_plants.steering.study.estimators import Accuracy, accuracy
from gateway_plants.steering.study.estimators import jobs as accuracy_jobs
from gateway_plants.steering.study.symptoms import Combination
from gateway_plants.steering.study.table import CASES, Health, Score, monte_carlo, plan, structure

#: Seeds of the estimators' table.
SEEDS = 3


def _number(value: float, form: str = ".0f") -> str:
    return "-" if isnan(value) or abs(value) == float("inf") else format(value, form)


def _percent(value: float) -> str:
    return "-" if isnan(value) else f"{100 * value:.1f}"


def _estimators(rows: list[Accuracy]) -> list[Table]:
    tables = []
    for key in dict.fromkeys((row.period_ms, row.voltages) for row in rows):
        period, voltages = key
        table = Table(title=f"Estimators at {period:.0f} ms, mean voltages {voltages}, nominal motor")
        table.add_column("estimator")
        for name in (
            "angle rms\n[deg]",
            "max",
            "speed rms\n[rad/s]",
            "moving",
            "worst drift in\n1 s of rest [deg]",
            "note:\nrms",
        ):
            table.add_column(name, justify="right")
        for row in rows:
            if (row.period_ms, row.voltages) == key:
                table.add_row(
                    row.estimator,
                    _number(row.angle_rms, ".2f"),
                    _number(row.angle_max, ".1f"),
                    _number(row.speed_rms, ".2f"),
                    _number(row.moving, ".2f"),
                    _number(row.standstill, ".1f"),
                    _number(row.note, ".4g"),
                )
        tables.append(table)
    return tables


def _scores(scores: list[Score]) -> list[Table]:
    tables = []
    for temperature, period in dict.fromkeys((s.temperature, s.period_ms) for s in scores):
        table = Table(title=f"Faults at {period:.0f} ms, resistance {temperature}")
        table.add_column("fault")
        for name in (
            "runs",
            "detected\nin 2 s [%]",
            "in 100 ms\n[%]",
            "delay\nmean [ms]",
            "max",
            "isolated\n[%]",
            "after\n[ms]",
            "wrong\n[runs]",
            "kind right\n[%]",
            "note: ms [%]",
        ):
            table.add_column(name, justify="right")
        for s in scores:
            if (s.temperature, s.period_ms) != (temperature, period):
                continue
            note = "-" if isnan(s.note_ms) else f"{s.note_ms:.0f} [{s.note_percent:.0f}]"
            table.add_row(
                s.case,
                str(s.runs),
                _percent(s.detected),
                _percent(s.within_100_ms),
                _number(s.delay_ms),
                _number(s.delay_max_ms),
                _percent(s.isolated),
                _number(s.isolated_after_ms),
                str(s.wrong),
                _percent(s.kind),
                note,
            )
        tables.append(table)
    return tables


def _health(rows: list[Health]) -> Table:
    table = Table(title="Healthy runs with spread parameters")
    for name in (
        "resistance",
        "period\n[ms]",
        "runs",
        "hours",
        "false\nalarms",
        "MTFA sure with\n95 % [s]",
        "angle\nlost",
        "worst angle\n[deg]",
        "symptom nearest to its threshold",
    ):
        table.add_column(name, justify="left" if "nearest" in name else "right")
    for row in rows:
        near = max(row.peaks, key=row.peaks.__getitem__)
        table.add_row(
            row.temperature,
            f"{row.period_ms:.0f}",
            str(row.runs),
            f"{row.hours:.2f}",
            str(row.alarms),
            f"{row.mtfa_s:.0f}",
            str(row.lost),
            f"{row.worst_deg:.2f}",
            f"{near}: {100 * row.peaks[near]:.0f} %",
        )
    return table


def _structure(rows: list[Combination]) -> Table:
    length = rows[0].mtfa_s
    table = Table(
        title=f"One filter, one distance, one rule: mean delay [ms] (detected in 2 s, %), "
        f"no alarm in {length:.0f} healthy s, in-sample"
    )
    table.add_column("symptom")
    table.add_column("rule")
    names = [case.name for case in CASES[:7]]
    for name in names:
        table.add_column(name, justify="right")
    by = {(r.symptom, r.rule, r.fault): r for r in rows}
    for symptom in dict.fromkeys(r.symptom for r in rows):
        for rule in RULES:
            cells = []
            for name in names:
                r = by[symptom, rule, name]
                cells.append(f"{_number(r.delay_ms)} ({100 * r.detected:.0f})")
            table.add_row(symptom, rule, *cells, end_section=rule == RULES[-1])
    return table


def _operations(rows: list[operations.Load]) -> Table:
    table = Table(title="Table 1: operations of a step (the paper's in brackets)")
    table.add_column("method")
    for name in (
        "multiplications",
        "additions",
        "divisions",
        "trigonometric, logic",
        "integrators",
    ):
        table.add_column(name, justify="right")

    def beside(ours: int, paper: int) -> str:
        return str(ours) if paper < 0 else f"{ours} ({paper})"

    for r in rows:
        table.add_row(
            r.method,
            beside(r.multiplications, r.paper_multiplications),
            str(r.additions),
            str(r.divisions),
            beside(r.trigonometric_and_logic, r.paper_trigonometric_and_logic),
            beside(r.integrators, r.paper_integrators),
        )
    return table


def steering(*, runs: int, healthy: int, seed: int, rules: bool, json: bool, plot: Path | None) -> int:
    """Evaluate the steering monitor; returns the exit code."""
    todo = [job for job in plan(runs, healthy, seed) if runs or not job[0]]
    first = accuracy_jobs(SEEDS)
    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("estimators", total=len(first))
        estimators = accuracy(first, lambda: bar.advance(task))
        task = bar.add_task("runs", total=len(todo))
        scores, health = monte_carlo(todo, lambda: bar.advance(task))
        combinations: list[Combination] = []
        if rules and runs and healthy:
            task = bar.add_task("rules", total=9)
            combinations = structure(runs, healthy, seed, lambda: bar.advance(task))
    loads = operations.table()
    files: list[Path] = []
    if plot is not None:
        from gateway_plants.steering.study.figures import draw  # noqa: PLC0415 - slow to load

        files = draw(plot, scores, seed)
    if json:
        print_json(
            {
                "study": "steering",
                "seeds": runs,
                "first_seed": seed,
                "estimators": [asdict(row) for row in estimators],
                "rows": [asdict(row) for row in scores],
                "healthy": [asdict(row) for row in health],
                "rules": [asdict(row) for row in combinations],
                "operations": [asdict(row) for row in loads],
                "files": [str(file) for file in files],
            }
        )
        return 0
    console = wide_console()
    for table in (*_estimators(estimators), *_scores(scores)):
        console.print(table)
    if health:
        console.print(_health(health))
    if combinations:
        console.print(_structure(combinations))
    console.print(_operations(loads))
    console.print(
        f"seeds from {seed} on. Resistance unknown: -10 to +30 %, the winding's temperature not"
        f" used; known: within 5 %."
        " isolated: of the runs in which\n"
        "anything was detected, the component that is at fault was named by the end, and no"
        " other; note: the best of the prototype's rules, mean delay, and percentage detected in brackets."
    )
    for file in files:
        console.print(f"drawn: {file}")
    return 0
