"""Options and arguments that several commands have; those of other packages take them from here.

Annotations are values, no texts: typer asks for all of them at each start, and would have each text compiled.
"""

from pathlib import Path
from typing import Annotated

import typer

Json = Annotated[bool, typer.Option("--json", help="Print one JSON document, on one line, instead of text.")]
JsonEvents = Annotated[bool, typer.Option("--json", help="Print JSON Lines, one event per line, instead of text.")]
Every = Annotated[bool, typer.Option("--all", help="Print each fault by itself, however many are alike.")]
FailOnDtc = Annotated[bool, typer.Option("--fail-on-dtc", help="Exit with code 1 if a DTC was set.")]
_CONFIG_HELP = "Configuration file; default: gateway.toml in this folder, or else the shipped one."
ConfigArgument = Annotated[Path | None, typer.Argument(help=_CONFIG_HELP)]
ConfigOption = Annotated[Path | None, typer.Option("--config", "-c", help=_CONFIG_HELP)]
MemoryOption = Annotated[
    Path | None, typer.Option("--memory", help="SQLite file of the fault memory; default: as configured.")
]
Zone = Annotated[
    str | None,
    typer.Option(
        "--zone", help="Time zone of the dates in the log, e.g. Europe/Berlin (ASC, BLF, TRC).  [default: UTC]"
    ),
]
Maps = Annotated[
    list[str] | None,
    typer.Option(
        "--map",
        metavar="CHANNEL=BUS",
        help="Read this channel of the log as this bus of the configuration; may be repeated.",
    ),
]
EcuOption = Annotated[
    Path | None,
    typer.Option(
        "--ecu", help="File of [[bus]] and [[ecu]], as gateway import and survey write: answers are read, too."
    ),
]
StatusOption = Annotated[
    Path | None,
    typer.Option("--status", help="Status socket; default: as configured in [status], or next to the fault memory."),
]
HtmlOption = Annotated[Path | None, typer.Option("--html", help="Write a report into this file, e.g. report.html.")]
LOG_HELP = (
    "CAN log: .log (candump), .asc, .blf, .mf4, .trc, .csv, .parquet, each also as .gz, .bz2, .xz, .zst, .zip; "
    "or a folder of segments."
)
LogArgument = Annotated[Path, typer.Argument(help=LOG_HELP)]
JunitOfFaults = Annotated[Path | None, typer.Option("--junit", help="Write a JUnit file with one test case per fault.")]
PortOption = Annotated[int, typer.Option(min=0, max=65535, help="Port of the page; 0: any free port.")]
Seed = Annotated[int | None, typer.Option(help="Seed of all randomness; default: the scenario's.")]
ScenarioArgument = Annotated[Path, typer.Argument(help="Scenario file, or the name of a shipped scenario.")]
