"""Commands of the plant: one function each, whose work is imported only when it is called."""

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
