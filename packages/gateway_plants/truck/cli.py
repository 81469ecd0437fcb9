"""Commands of the plant: one function each, whose work is imported only when it is called."""

from pathlib import Path
from typing import Annotated

import typer

from gateway.cli.commands import does
from gateway.cli.options import Json


@does("gateway_plants.truck.study.command:truck")
def evaluate_truck(
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
