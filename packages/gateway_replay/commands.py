"""Commands that replay logs: one function each, whose work is imported only when it is called."""

from pathlib import Path
from typing import Annotated

import typer

from gateway.cli.commands import does
from gateway.cli.options import (
    LOG_HELP,
    ConfigOption,
    Every,
    FailOnDtc,
    HtmlOption,
    JsonEvents,
    JunitOfFaults,
    Maps,
)

INJECT_HELP = (
    "Inject a fault into the frames, from and to a time [s]: 'drop SPEED @10..12', 'offset SPEED.SPEED=40 @10'; "
    "kinds: drop, repeat, freeze, flip, stuck, offset, value, jump; may be repeated."
)
MemoryOfReplay = Annotated[
    Path | None, typer.Option("--memory", help="SQLite file of a fault memory to use; default: none is used.")
]
SeriesOption = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE", help="Write what the monitors compute over time, as .parquet or .csv (docs/series.md)."
    ),
]
SeriesPlot = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE", help="Draw what the monitors compute: values against limits, DTCs marked (.svg, .png, .pdf)."
    ),
]
SeriesSignals = Annotated[
    list[str] | None,
    typer.Option(metavar="MESSAGE.SIGNAL", help="With --signals or --plot: add this signal; may be repeated."),
]


@does("gateway_replay.cli.replays:replays", only="monitor", inject="injections", signals="series", signal="chosen")
def replay(
    logs: Annotated[list[Path], typer.Argument(metavar="LOG...", help=LOG_HELP)],
    config: ConfigOption = None,
    maps: Maps = None,
    memory: MemoryOfReplay = None,
    allow_empty: Annotated[
        bool,
        typer.Option("--allow-empty", help="Accept a log without a frame of a configured bus."),
    ] = False,
    allow_cut: Annotated[bool, typer.Option("--allow-cut", help="Accept a log that is cut off at its end.")] = False,
    only: Annotated[
        str | None, typer.Option("--only", metavar="MONITOR", help="Run only the monitor with this name.")
    ] = None,
    trace: Annotated[
        bool,
        typer.Option("--trace", help="With --only: print inputs, state and results of each step."),
    ] = False,
    inject: Annotated[
        list[str] | None,
        typer.Option(
            metavar="FAULT",
            help=INJECT_HELP,
        ),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the injected faults.")] = 1,
    html: HtmlOption = None,
    signals: SeriesOption = None,
    plot: SeriesPlot = None,
    signal: SeriesSignals = None,
    junit: JunitOfFaults = None,
    jobs: Annotated[
        int, typer.Option("--jobs", "-j", min=0, help="Number of processes for several logs; 0: one per core.")
    ] = 1,
    every: Every = False,
    json: JsonEvents = False,
    fail_on_dtc: FailOnDtc = False,
) -> None:
    """Run recorded logs through the monitors, one by one.

    Without --memory, no fault memory is read or written. Exit code 2: a log is damaged, cut off, or has no frame of a
    configured bus; its frames are replayed all the same.
    """


@does("gateway_replay.cli.signal_plot:plot_file")
def plot_command(
    series: Annotated[Path, typer.Argument(help="File written by gateway replay --signals: .parquet or .csv.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="Picture to write: .svg, .png, .pdf.")],
    only: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="Draw only this monitor, fault, quantity or signal; may be repeated."),
    ] = None,
) -> None:
    """Draw what the monitors computed over time.

    The picture shows values against their limits, with DTCs marked.
    """
