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
    add_completion=False,
    help="Measure how good the methods are: tables and figures.",
    no_args_is_help=True,
)


@evaluate.command("crank")
def crank(
    seeds: Annotated[int, typer.Option(min=0, help="Number of faults per wheel, kind, speed and ramp; 0: none.")] = 20,
    pulses: Annotated[
        int, typer.Option(min=0, help="Number of healthy pulses per wheel and jitter; 0: none.")
    ] = 200_000,
    outside: Annotated[
        int, typer.Option(min=0, help="Number of runs per engine, defect and wheel outside the regular sweep; 0: none.")
    ] = 0,
    pairs: Annotated[
        int, typer.Option(min=0, help="Number of runs per configured wheel, real wheel and speed; 0: none.")
    ] = 0,
    seed: Annotated[int, typer.Option(min=0, help="Seed of all randomness.")] = 2026,
    json: Json = False,
    plot: Annotated[Path | None, typer.Option(help="Draw Figs. 2 to 5 of the paper into this folder.")] = None,
) -> None:
    """Evaluate crankshaft methods: missed and added pulses.

    It compares our two methods with those of open engine controllers.
    """
    from gateway_studies.crank.command import crank as work

    raise typer.Exit(work(runs=seeds, pulses=pulses, outside=outside, pairs=pairs, seed=seed, json=json, plot=plot))


@evaluate.command("learn")
def learn(
    cars: Annotated[int, typer.Option(min=1, help="Number of virtual cars.")] = 3,
    seconds: Annotated[float, typer.Option(min=30, help="Length of the drive that is learned of [s].")] = 300.0,
    hours: Annotated[float, typer.Option(min=0, help="Other healthy drives, together [h].")] = 20.0,
    ways: Annotated[str, typer.Option(help="What becomes of the frames: clean,lost,sleeps,host,all.")] = "lost,all",
    seed: Annotated[int, typer.Option(min=0, help="Seed of the first car.")] = 2026,
    json: Json = False,
) -> None:
    """Evaluate what is learned of virtual cars of 40 messages: claims and truth, codes of healthy drives."""
    from gateway_studies.learn.command import learn as work

    raise typer.Exit(work(cars=cars, seconds=seconds, hours=hours, ways=tuple(ways.split(",")), seed=seed, json=json))


@evaluate.command("pedal")
def pedal(
    seeds: Annotated[int, typer.Option(min=0, help="Number of runs per case; 0: none.")] = 300,
    seed: Annotated[
        int,
        typer.Option(min=0, help="First seed; no parameter was chosen with seeds from 100000 up."),
    ] = 100_000,
    roads: Annotated[
        int, typer.Option(min=0, help="Number of runs per fault with frames that are lost, late or swapped; 0: none.")
    ] = 0,
    hours: Annotated[float, typer.Option(min=0, help="Length of healthy drives with such frames [h].")] = 0.0,
    json: Json = False,
    plot: Annotated[Path | None, typer.Option(help="Draw Figs. 9 to 14 of the paper into this folder.")] = None,
) -> None:
    """Evaluate pedal voters with faulty sensors.

    It compares our voter with average, median, predictive and Kalman hybrid voters; and it shows how faults are named
    where frames are lost, late or swapped.
    """
    from gateway_studies.pedal.command import pedal as work

    raise typer.Exit(work(runs=seeds, seed=seed, roads=roads, hours=hours, json=json, plot=plot))


@evaluate.command("steering")
def steering(
    runs: Annotated[int, typer.Option(min=0, help="Number of runs per fault; 0: none.")] = 40,
    healthy: Annotated[int, typer.Option(min=0, help="Number of healthy runs, each of 24 s.")] = 120,
    seed: Annotated[
        int,
        typer.Option(min=0, help="First seed; no parameter was chosen with seeds from 100000 up."),
    ] = 100_000,
    rules: Annotated[
        bool, typer.Option("--rules", help="Also compare all filters, distances and stopping rules.")
    ] = False,
    json: Json = False,
    plot: Annotated[
        Path | None, typer.Option(help="Draw Figs. 4 to 7 of the paper, and our own figures, into this folder.")
    ] = None,
) -> None:
    """Evaluate steering: the motor angle and faults of its sensors.

    It shows estimators, faults found and named, and the operations of Table 1 of the paper.
    """
    from gateway_studies.steering.command import steering as work

    raise typer.Exit(work(runs=runs, healthy=healthy, seed=seed, rules=rules, json=json, plot=plot))


@evaluate.command("truck")
def truck(
    seeds: Annotated[int, typer.Option(min=1, help="Number of noise seeds per case.")] = 1,
    seed: Annotated[int, typer.Option(min=0, help="First seed; nothing was chosen with seeds from 30000 up.")] = 30_000,
    json: Json = False,
    plot: Annotated[
        Path | None, typer.Option(help="Draw Figs. 5 to 9 of the paper, and our own figures, into this folder.")
    ] = None,
) -> None:
    """Evaluate fault isolation in a hybrid truck.

    It shows which system of tests isolates which fault, on trucks as modelled and on others.
    """
    from gateway_studies.truck.command import truck as work

    raise typer.Exit(work(seeds=seeds, seed=seed, json=json, plot=plot))


@evaluate.command("linear")
def linear(
    cases: Annotated[int, typer.Option(min=0, help="Number of random cases; 0: none.")] = 600,
    hours: Annotated[float, typer.Option(min=0, help="Length of healthy flight, for each noise [h].")] = 20.0,
    seed: Annotated[
        int,
        typer.Option(min=0, help="First seed; nothing was chosen with seeds from 100000 up."),
    ] = 100_000,
    json: Json = False,
    plot: Annotated[
        Path | None, typer.Option(help="Draw Figs. 3 to 11 of the paper, and our own figures, into this folder.")
    ] = None,
) -> None:
    """Evaluate the bank of PI observers on linear plants.

    It shows the figures of the paper, random faults of actuators and sensors, and false alarms.
    """
    from gateway_studies.linear.command import linear as work

    raise typer.Exit(work(cases=cases, hours=hours, seed=seed, json=json, plot=plot))


@evaluate.command("cause")
def cause(
    seeds: Annotated[int, typer.Option(min=0, help="Number of runs of each fault; 0: none.")] = 3,
    pairs: Annotated[int, typer.Option(min=0, help="Number of runs with two faults; 0: none.")] = 200,
    healthy: Annotated[int, typer.Option(min=0, help="Number of healthy runs of each scenario; 0: none.")] = 3,
    seed: Annotated[int, typer.Option(min=0, help="Seed of all randomness.")] = 2026,
    work: Annotated[Path, typer.Option(help="Folder for the two cars that are learned.")] = Path("cause"),
    json: Json = False,
) -> None:
    """Evaluate causes: one or two faults of plants and learned cars, and which component is named."""
    from gateway_studies.cause.command import cause as run

    raise typer.Exit(run(seeds=seeds, pair_runs=pairs, healthy_runs=healthy, seed=seed, work=work, json=json))
