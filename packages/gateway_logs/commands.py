"""Commands on logs: one function each, whose work is imported only when it is called."""

from pathlib import Path
from typing import Annotated

import typer

from gateway.cli.commands import does
from gateway.cli.options import EcuOption, JsonEvents, Maps, Zone


@does("gateway_logs.cli.decode:decode", database="databases")
def decode(
    logs: Annotated[
        list[str], typer.Argument(metavar="LOG...", help="Logs, folders of logs, or patterns, e.g. 'logs/**/*.mf4'.")
    ],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the tables.")],
    database: Annotated[
        list[Path] | None,
        typer.Option(
            "--database",
            "-d",
            help="Database for the frames of all buses (.dbc, .kcd, .sym, .arxml); may be repeated. One bus of"
            " several: car.kcd#Motor.",
        ),
    ] = None,
    config: Annotated[
        Path | None,
        typer.Option("--config", "-c", help="Take buses and databases from this configuration, instead of --database."),
    ] = None,
    ecu: EcuOption = None,
    maps: Maps = None,
    device: Annotated[
        str | None, typer.Option("--device", help="Name of the device (car) of the logs.  [default: folder of the log]")
    ] = None,
    numbers: Annotated[bool, typer.Option("--numbers", help="Write numbers instead of the names of values.")] = False,
    zone: Zone = None,
    json: JsonEvents = False,
) -> None:
    """Decode logs into Parquet tables, one table per message.

    The files are device/message/YYYY/MM/DD/log.parquet, with the time t in UTC and one column per signal. Exit code 2:
    a log is damaged; its whole frames are decoded all the same.
    """
