"""Commands that ask a car: one function each, whose work is imported only when it is called."""

from pathlib import Path
from typing import Annotated

import typer

from gateway.cli.commands import does
from gateway.cli.options import Json


@does("gateway_ask.cli.survey:survey", bus="uri")
def survey(
    bus: Annotated[str, typer.Argument(help="URI of the bus, e.g. socketcan:can0.")],
    out: Annotated[Path | None, typer.Option("--out", "-o", help="Write a configuration that asks them.")] = None,
    rate: Annotated[float, typer.Option(min=0.1, max=1000, help="Most requests a second.")] = 10.0,
    yes: Annotated[bool, typer.Option("--yes", help="Ask also where there is traffic on the bus.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Overwrite an existing file.")] = False,
    json: Json = False,
) -> None:
    """Find the ECUs of a bus by asking them: identity, PIDs, DTCs."""


@does("gateway_ask.cli.import_layouts:import_layouts")
def import_(
    source: Annotated[
        Path,
        typer.Argument(
            help="Layouts of answers: .dbc, .kcd, .sym, .arxml, .cdd, .odx, .pdx, or a signal set of OBDb (.json)."
        ),
    ],
    out: Annotated[Path, typer.Option("--out", "-o", help="Configuration file to write.")] = Path("ecu.toml"),
    bus: Annotated[str, typer.Option(metavar="NAME[=URI]", help="Bus that the ECUs are on.")] = "can0",
    request: Annotated[
        str | None, typer.Option(help="Identifier of requests, e.g. 0x7E0, where the file has none.")
    ] = None,
    response: Annotated[str | None, typer.Option(help="Identifier of answers, e.g. 0x7E8.")] = None,
    year: Annotated[
        int | None, typer.Option(min=1900, max=2200, help="Model year, where the file has several.")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite existing files.")] = False,
    json: Json = False,
) -> None:
    """Make a configuration from a file of ECUs' answers."""
