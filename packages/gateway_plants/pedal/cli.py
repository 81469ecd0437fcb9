"""Commands of the plant: one function each, whose work is imported only when it is called."""

from pathlib import Path
from typing import Annotated

import typer

from gateway.cli.commands import does
from gateway.cli.options import Json


@does("gateway_plants.pedal.study.command:pedal", seeds="runs")
def evaluate_pedal(
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
