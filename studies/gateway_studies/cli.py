"""``gateway evaluate``: one function per study; each imports its work only when called."""

from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from gateway.cli import Json

#: Studies that were called otherwise before version 0.2.
RENAMED = {"voters": "pedal", "hybrid": "truck", "pi-bank": "linear"}


class _Studies(TyperGroup):
    """The studies; an old name is one still, and says the new one."""

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return a study, None if there is none."""
        if cmd_name in RENAMED:
            typer.echo(f"gateway evaluate {cmd_name} is {RENAMED[cmd_name]} now", err=True)
        return super().get_command(ctx, RENAMED.get(cmd_name, cmd_name))


evaluate = typer.Typer(
    cls=_Studies,
    rich_markup_mode=None,
    help="How good the methods are: figures and tables of our own data.",
    no_args_is_help=True,
)


@evaluate.command("crank")
def crank(
    seeds: Annotated[int, typer.Option(min=0, help="Faults for each wheel, kind, speed and ramp; 0: none.")] = 20,
    pulses: Annotated[int, typer.Option(min=0, help="Healthy pulses for each wheel and jitter; 0: none.")] = 200_000,
    outside: Annotated[
        int, typer.Option(min=0, help="Runs of each engine, defect and wheel outside the regular sweep; 0: none.")
    ] = 0,
    seed: Annotated[int, typer.Option(min=0, help="Seed of all randomness.")] = 2026,
    json: Json = False,
    plot: Annotated[Path | None, typer.Option(help="Draw the paper's Figs. 2 to 5 into this folder.")] = None,
) -> None:
    """Crankshaft: missed and added pulses.

    Our two methods beside those of open engine controllers.
    """
    from gateway_studies.crank.command import crank as work

    raise typer.Exit(work(runs=seeds, pulses=pulses, outside=outside, seed=seed, json=json, plot=plot))


@evaluate.command("pedal")
def pedal(
    seeds: Annotated[int, typer.Option(min=0, help="Runs of each case; 0: none.")] = 300,
    seed: Annotated[
        int,
        typer.Option(min=0, help="First seed; no parameter was chosen on those from 100000 on."),
    ] = 100_000,
    json: Json = False,
    plot: Annotated[Path | None, typer.Option(help="Draw the paper's Figs. 9 to 14 into this folder.")] = None,
) -> None:
    """Pedal: voters with faulty sensors.

    Ours beside average, median, predictive and Kalman hybrid.
    """
    from gateway_studies.pedal.command import pedal as work

    raise typer.Exit(work(runs=seeds, seed=seed, json=json, plot=plot))


@evaluate.command("steering")
def steering(
    runs: Annotated[int, typer.Option(min=0, help="Runs of each fault; 0: none.")] = 40,
    healthy: Annotated[int, typer.Option(min=0, help="Healthy runs of 24 s.")] = 120,
    seed: Annotated[
        int,
        typer.Option(min=0, help="First seed; no parameter was chosen on those from 100000 on."),
    ] = 100_000,
    rules: Annotated[bool, typer.Option("--rules", help="Also all filters, distances and stopping rules.")] = False,
    json: Json = False,
    plot: Annotated[Path | None, typer.Option(help="Draw the paper's Figs. 4 to 7 and ours into this folder.")] = None,
) -> None:
    """Steering: the motor's angle, and faults of its sensors.

    Estimators, faults found and named, operations of the paper's Table 1.
    """
    from gateway_studies.steering.command import steering as work

    raise typer.Exit(work(runs=runs, healthy=healthy, seed=seed, rules=rules, json=json, plot=plot))


@evaluate.command("truck")
def truck(
    seeds: Annotated[int, typer.Option(min=1, help="Noises of each case.")] = 1,
    seed: Annotated[int, typer.Option(min=0, help="First seed; nothing was chosen on those from 30000 on.")] = 30_000,
    json: Json = False,
    plot: Annotated[Path | None, typer.Option(help="Draw the paper's Figs. 5 to 9 and ours into this folder.")] = None,
) -> None:
    """Hybrid powertrain: which system isolates which fault.

    On trucks as modelled, and on others.
    """
    from gateway_studies.truck.command import truck as work

    raise typer.Exit(work(seeds=seeds, seed=seed, json=json, plot=plot))


@evaluate.command("linear")
def linear(
    cases: Annotated[int, typer.Option(min=0, help="Random cases; 0: none.")] = 600,
    hours: Annotated[float, typer.Option(min=0, help="Healthy flight, for each noise [h].")] = 20.0,
    seed: Annotated[
        int,
        typer.Option(min=0, help="First seed; nothing was chosen on those from 100000 on."),
    ] = 100_000,
    json: Json = False,
    plot: Annotated[Path | None, typer.Option(help="Draw the paper's Figs. 3 to 11 and ours into this folder.")] = None,
) -> None:
    """Bank of PI observers: actuators and sensors of a linear plant.

    The paper's figures, random faults, false alarms.
    """
    from gateway_studies.linear.command import linear as work

    raise typer.Exit(work(cases=cases, hours=hours, seed=seed, json=json, plot=plot))
