"""Commands of the crankshaft: one function each, whose work is imported only when it is called."""

from pathlib import Path
from typing import Annotated

import typer

from gateway.cli.commands import does
from gateway.cli.options import Json


@does("gateway_plants.crank.convert:convert_teeth")
def convert_teeth(
    capture: Annotated[
        Path, typer.Argument(help="CSV file of a logic analyser, with the columns time [s], level[, ...].")
    ],
    log: Annotated[Path, typer.Argument(help="CAN log to write, e.g. engine.log.")],
    channel: Annotated[str, typer.Option(help="Channel, by its number from 0 or its name in the header.")] = "0",
    edge: Annotated[str, typer.Option(help="Edge that a tooth causes: rising or falling.")] = ("falling"),
    frame: Annotated[str, typer.Option(help="Frames to write: classic (CTW_PT4) or fd (CTW_FD27).")] = "classic",
    json: Json = False,
) -> None:
    """Convert a capture of a crank sensor into CAN frames.

    The frames are those of dbc/crank/crank.dbc.
    """


@does("gateway_plants.crank.study.command:crank", seeds="runs")
def evaluate_crank(
    seeds: Annotated[int, typer.Option(min=0, help="Number of faults per wheel, kind, speed and ramp; 0: none.")] = 20,
    pulses: Annotated[
        int, typer.Option(min=0, help="Number of healthy pulses per wheel and jitter; 0: none.")
    ] = 200_000,
    outside: Annotated[
        int, typer.Option(min=0, help="Number of runs per engine, defect and wheel outside the regular sweep; 0: none.")
    ] = 0,
    seed: Annotated[int, typer.Option(min=0, help="Seed of all randomness.")] = 2026,
    json: Json = False,
    plot: Annotated[Path | None, typer.Option(help="Draw Figs. 2 to 5 of the paper into this folder.")] = None,
) -> None:
    """Evaluate crankshaft methods: missed and added pulses.

    It compares our method with those of open engine controllers.
    """
