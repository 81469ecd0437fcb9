"""Commands of the plant: one function each, whose work is imported only when it is called."""

from pathlib import Path
from typing import Annotated

import typer

from gateway.cli.commands import does
from gateway.cli.options import Json


@does("gateway_plants.linear.study.command:linear")
def evaluate_linear(
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
