"""Commands of the plant: one function each, whose work is imported only when it is called."""

from pathlib import Path
from typing import Annotated

import typer

from gateway.cli.commands import does
from gateway.cli.options import Json


@does("gateway_plants.steering.study.command:steering")
def evaluate_steering(
    runs: Annotated[int, typer.Option(min=0, help="Number of runs per fault; 0: none.")] = 40,
    healthy: Annotated[int, typer.Option(min=0, help="Number of healthy runs, each of 24 s.")] = 120,
    seed: Annotated[
        int,
        typer.Option(min=0, help="First seed; no parameter was chosen with seeds from 100000 up."),
    ] = 100_000,
    json: Json = False,
    plot: Annotated[
        Path | None, typer.Option(help="Draw Figs. 4 to 7 of the paper, and our own figures, into this folder.")
    ] = None,
) -> None:
    """Evaluate steering: the motor angle and faults of its sensors.

    It shows estimators, faults found and named, and the operations of Table 1 of the paper.
    """
