"""The arena's commands, whose work is imported only when it is called."""

from pathlib import Path
from typing import Annotated

import typer

from gateway.cli.commands import does
from gateway.cli.options import LOG_HELP, Json


@does("gateway_arena.study:arena", method="methods")
def evaluate_arena(
    plants: Annotated[
        list[str] | None,
        typer.Option(
            "--plant",
            "--plants",
            help="Plants: spring, buck, stiff_motor, quad, wind, motor, tanks, cooling, battery, brake, turbo,"
            " valve, tennessee. Default: all. A list with commas is several.",
        ),
    ] = None,
    method: Annotated[
        list[str] | None,
        typer.Option(
            help="Methods: structural, courses, pi_bank, fixed, selected, toolbox, ekf, pca, svm, forest,"
            " kalman, or FILE.py:CLASS. Default: all that have a name."
        ),
    ] = None,
    runs: Annotated[int, typer.Option(min=1, help="Number of records with each fault.")] = 20,
    healthy: Annotated[
        int, typer.Option(min=2, help="Number of records without a fault for the threshold; as many judge it.")
    ] = 60,
    train: Annotated[int, typer.Option(min=4, help="Number of records without a fault to learn from.")] = 10,
    false_alarm: Annotated[
        float, typer.Option(min=0.001, max=0.5, help="Share of healthy records in which each method may alarm.")
    ] = 0.05,
    off: Annotated[
        float, typer.Option(min=0, max=0.2, help="Share by which parameters differ from the model's.")
    ] = 0.0,
    size: Annotated[float, typer.Option(min=0.01, max=10, help="Size of the faults, in the usual ones.")] = 1.0,
    seed: Annotated[
        int, typer.Option(min=0, help="First seed; nothing was chosen with seeds from 100000 up.")
    ] = 100_000,
    scenarios: Annotated[
        int, typer.Option(min=0, help="Runs of each of valve's 44 scenarios; an incipient one is run once. 0: none.")
    ] = 5,
    data: Annotated[
        Path | None,
        typer.Option(exists=True, file_okay=False, help="Folder with the files of LiU-ICE, as a plant."),
    ] = None,
    plot: Annotated[Path | None, typer.Option(help="Draw ROC curves into this file (.svg, .png, .pdf).")] = None,
    json: Json = False,
) -> None:
    """Compare methods of fault diagnosis, on thirteen plants.

    Each method learns from the same records, and its threshold is set by
    the same healthy ones; a method of your own is one file.
    """


@does("gateway_arena.monitor.fit:fit", fault="faults")
def fit(
    config: Annotated[Path, typer.Argument(help="Configuration file.")],
    logs: Annotated[list[Path], typer.Argument(help=f"Logs of healthy drives. {LOG_HELP}")],
    monitor: Annotated[str | None, typer.Option(help='Monitor of type "method", if there are several.')] = None,
    fault: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=LOG@SECONDS", help="A log with a fault, and when it begins; may be repeated."),
    ] = None,
    json: Json = False,
) -> None:
    """Have a method of the arena learn from healthy logs.

    The file that it writes is what the monitor runs with.
    """
