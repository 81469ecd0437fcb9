"""``gateway evaluate steering``."""

from __future__ import annotations

from math import isnan
from pathlib import Path

from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from gateway_bench.cli.study import beside, show, tabulate
from gateway_plants.steering.study import operations, paper
from gateway_plants.steering.study.estimators import Accuracy, accuracy
from gateway_plants.steering.study.estimators import jobs as accuracy_jobs
from gateway_plants.steering.study.table import Health, Score, monte_carlo, plan

#: Seeds of the estimators' table.
SEEDS = 3


def _number(value: float, form: str = ".0f") -> str:
    return "-" if isnan(value) or abs(value) == float("inf") else format(value, form)


def _percent(value: float) -> str:
    return "-" if isnan(value) else f"{100 * value:.1f}"


def _estimators(rows: list[Accuracy]) -> list[Table]:
    return [
        tabulate(
            f"Estimators at {key[0]:.0f} ms, mean voltages {key[1]}, resistance {100 * key[2]:.0f} %",
            (row for row in rows if (row.period_ms, row.voltages, row.resistance) == key),
            {
                "estimator": lambda row: row.estimator,
                "angle rms\n[deg]": lambda row: _number(row.angle_rms, ".2f"),
                "max": lambda row: _number(row.angle_max, ".1f"),
                "speed rms\n[rad/s]": lambda row: _number(row.speed_rms, ".2f"),
                "moving": lambda row: _number(row.moving, ".2f"),
                "worst drift in\n1 s of rest [deg]": lambda row: _number(row.standstill, ".1f"),
                "drift in 50 ms\nabove 20 rad/s": lambda row: _number(row.fast, ".2f"),
                "note:\nrms": lambda row: _number(row.note, ".4g"),
            },
        )
        for key in dict.fromkeys((row.period_ms, row.voltages, row.resistance) for row in rows)
    ]


def _noted(s: Score) -> str:
    """Return the delay of the prototype's rules, and how often they detect."""
    return "-" if isnan(s.note_ms) else f"{s.note_ms:.0f} [{s.note_percent:.0f}]"


def _scores(scores: list[Score]) -> list[Table]:
    return [
        tabulate(
            f"Faults at {key[1]:.0f} ms, resistance {key[0]}",
            (s for s in scores if (s.temperature, s.period_ms) == key),
            {
                "fault": lambda s: s.case,
                "runs": lambda s: s.runs,
                "detected\nin 2 s [%]": lambda s: _percent(s.detected),
                "in 100 ms\n[%]": lambda s: _percent(s.within_100_ms),
                "delay\nmean [ms]": lambda s: _number(s.delay_ms),
                "max": lambda s: _number(s.delay_max_ms),
                "isolated\n[%]": lambda s: _percent(s.isolated),
                "after\n[ms]": lambda s: _number(s.isolated_after_ms),
                "wrong\n[runs]": lambda s: s.wrong,
                "kind right\n[%]": lambda s: _percent(s.kind),
                "note: ms [%]": _noted,
            },
        )
        for key in dict.fromkeys((s.temperature, s.period_ms) for s in scores)
    ]


def _nearest(row: Health) -> str:
    """Return the symptom that came nearest to its threshold."""
    near = max(row.peaks, key=row.peaks.__getitem__)
    return f"{near}: {100 * row.peaks[near]:.0f} %"


def _health(rows: list[Health]) -> Table:
    return tabulate(
        "Healthy runs with spread parameters",
        rows,
        {
            "resistance": lambda row: row.temperature,
            "period\n[ms]": lambda row: f"{row.period_ms:.0f}",
            "runs": lambda row: row.runs,
            "hours": lambda row: f"{row.hours:.2f}",
            "false\nalarms": lambda row: row.alarms,
            "MTFA sure with\n95 % [s]": lambda row: f"{row.mtfa_s:.0f}",
            "angle\nlost": lambda row: row.lost,
            "worst angle\n[deg]": lambda row: f"{row.worst_deg:.2f}",
            "symptom nearest to its threshold": _nearest,
        },
        texts=0,
    )


def _operations(rows: list[operations.Load]) -> Table:
    return tabulate(
        "Operations of a step",
        rows,
        {
            "method": lambda r: r.method,
            "multiplications": lambda r: r.multiplications,
            "additions": lambda r: r.additions,
            "divisions": lambda r: r.divisions,
            "trigonometric, logic": lambda r: r.trigonometric_and_logic,
            "integrators": lambda r: r.integrators,
        },
    )


def steering(*, runs: int, healthy: int, seed: int, json: bool, plot: Path | None) -> int:
    """Evaluate the steering monitor; returns the exit code."""
    todo = [job for job in plan(runs, healthy, seed) if runs or not job[0]]
    first = accuracy_jobs(SEEDS)
    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("estimators", total=len(first))
        estimators = accuracy(first, lambda: bar.advance(task))
        task = bar.add_task("runs", total=len(todo))
        scores, health = monte_carlo(todo, lambda: bar.advance(task))
    loads = operations.table()
    claims = paper.claims(estimators, loads)
    files: list[Path] = []
    if plot is not None:
        from gateway_plants.steering.study.figures import draw  # noqa: PLC0415 - slow to load

        files = draw(plot, scores, seed)
    document = {
        "study": "steering", "seeds": runs, "first_seed": seed, "paper": claims, "estimators": estimators,
        "rows": scores, "healthy": health, "operations": loads,
    }  # fmt: skip
    tables = [beside(claims), *_estimators(estimators), *_scores(scores)]
    tables += [_health(health)] if health else []
    note = (
        f"seeds from {seed} on. Resistance unknown: -10 to +30 %, the winding's temperature not"
        f" used; known: within 5 %."
        " isolated: of the runs in which\n"
        "anything was detected, the component that is at fault was named by the end, and no"
        " other; note: the best of the prototype's rules, mean delay, and percentage detected in brackets."
    )
    return show(document, [*tables, _operations(loads)], [note], files=files, json=json)
