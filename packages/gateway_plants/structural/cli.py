"""Commands of the plant: one function each, whose work is imported only when it is called."""

from pathlib import Path
from typing import Annotated

import typer

from gateway.cli.options import Json


def evaluate_structural(
    hours: Annotated[float, typer.Option(min=0, help="Length of healthy drives of each plant [h].")] = 10.0,
    runs: Annotated[int, typer.Option(min=0, help="Number of drives with each fault.")] = 10,
    off: Annotated[list[float] | None, typer.Option(help="Share by which parameters are off: 0, 0.05 and 0.1.")] = None,
    plant: Annotated[list[str] | None, typer.Option(help="Plants: spring, buck, stiff_motor, quad, wind.")] = None,
    seed: Annotated[
        int, typer.Option(min=0, help="First seed; nothing was chosen with seeds from 100000 up.")
    ] = 100_000,
    json: Json = False,
) -> None:
    """Evaluate monitors from equations on plants of other make.

    Healthy drives and faults of plants that are lightly damped, stiff or not
    linear, solved by SciPy: exactly as their models, and off within the bounds
    of the configuration.
    """
    from gateway_plants.structural.study.command import structural as work

    raise typer.Exit(work(hours=hours, runs=runs, shares=off or [0.0, 0.05, 0.1], plants=plant, seed=seed, json=json))


def structure(
    model: Annotated[
        Path, typer.Argument(help="File of a structural model, or the name of a shipped one, e.g. truck.")
    ],
    json: Json = False,
    plot: Annotated[Path | None, typer.Option(help="Draw the analysis into this file (.svg, .png, .pdf).")] = None,
    limit: Annotated[
        int,
        typer.Option(
            min=1, help="Search all MSO sets up to this number; if there are more, search only as many as needed."
        ),
    ] = 20_000,
    residual: Annotated[
        str | None,
        typer.Option(help="Print the sequence and code of this residual generator, by its name or as SET:EQUATION."),
    ] = None,
    export: Annotated[
        str | None, typer.Option(metavar="LANGUAGE", help="With --residual: write its code in this language: c (C99).")
    ] = None,
    output: Annotated[Path | None, typer.Option("--output", "-o", help="With --export: file to write.")] = None,
    sensors: Annotated[
        str | None,
        typer.Option(help="Choose sensors among these unknowns (a,b,c or all) so that faults can be found."),
    ] = None,
) -> None:
    """Find the residual generators of a structural model.

    It shows which faults each generator finds, and which faults can be told apart.
    """
    from gateway_plants.structural.analysis.command import structure as work

    made = {"export": export, "output": None if output is None else str(output)}
    raise typer.Exit(work(model, json=json, plot=plot, limit=limit, residual=residual, sensors=sensors, **made))
