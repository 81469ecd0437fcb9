"""Commands of a fleet on the road: one function each, whose work is imported only when it is called."""

from pathlib import Path
from typing import Annotated

import typer

from gateway.cli.commands import does
from gateway.cli.options import ConfigOption, Json, StatusOption

Fleet = Annotated[str, typer.Option("--fleet", help="Name of the fleet.")]
User = Annotated[str, typer.Option(help="User name for the broker.")]
PasswordFile = Annotated[Path | None, typer.Option("--password-file", help="File with the password for the broker.")]
Ca = Annotated[Path | None, typer.Option("--ca", help="Connect with TLS: file with the certificates to trust (PEM).")]
Certificate = Annotated[Path | None, typer.Option("--certificate", help="Own certificate for TLS (PEM).")]
Key = Annotated[Path | None, typer.Option("--key", help="Key of the certificate (PEM).")]


@does("gateway_fleet.cli.road:fleet_join", config="config_path")
def fleet_join(
    to: Annotated[str, typer.Argument(help="Broker, as HOST or HOST:PORT; or the collector's URL, http://HOST:PORT.")],
    config: ConfigOption = None,
    status: StatusOption = None,
    user: User = "",
    password_file: PasswordFile = None,
    ca: Ca = None,
    certificate: Certificate = None,
    key: Key = None,
    keys: Annotated[
        Path | None, typer.Option("--keys", help="The fleet's signed keys: campaigns that they sign are taken.")
    ] = None,
) -> None:
    """Have a car take part in a fleet.

    It sends events that the fault memory keeps for the fleet ([fleet]) again and again until the collector has them,
    and statistics of the tests of each drive.
    """


@does("gateway_fleet.cli.road:fleet_collect")
def fleet_collect(
    folder: Annotated[Path, typer.Argument(help="Folder of the tables.")],
    fleet: Fleet,
    broker: Annotated[str | None, typer.Option(help="Broker, as HOST or HOST:PORT.")] = None,
    http: Annotated[str | None, typer.Option(help="Also, or only, take events by HTTP at HOST:PORT.")] = None,
    every: Annotated[float, typer.Option(min=1, max=86400, help="Time between two files of a table [s].")] = 3600.0,
    user: User = "",
    password_file: PasswordFile = None,
    ca: Ca = None,
    certificate: Certificate = None,
    key: Key = None,
    json: Json = False,
) -> None:
    """Collect events of a fleet's cars into Parquet tables.

    DuckDB reads the tables as they are; gateway fleet ask has the usual questions.
    """


@does("gateway_fleet.cli.road:fleet_key")
def fleet_key(path: Annotated[Path, typer.Argument(help="File to write.")]) -> None:
    """Make the key by which a fleet's owner makes ids of cars."""


@does("gateway_fleet.cli.road:fleet_id")
def fleet_id(
    vin: Annotated[str, typer.Argument(help="VIN of the car.")],
    key: Annotated[Path, typer.Option("--key", help="File of the owner's key (gateway fleet key).")],
) -> None:
    """Print the id by which a fleet knows a car, instead of its VIN."""


@does("gateway_fleet.cli.road:fleet_contract")
def fleet_contract(
    asyncapi: Annotated[
        bool, typer.Option("--asyncapi", help="The channels of a fleet, as an AsyncAPI document.")
    ] = False,
) -> None:
    """Print the JSON Schema of all events."""


Tables = Annotated[Path, typer.Argument(help="Folder of the tables (gateway fleet collect).")]
Private = Annotated[Path, typer.Option("--key", help="Private key (gateway fleet signer).")]
Model = Annotated[str, typer.Option(help="Only cars of this model; * stands for others.")]
Software = Annotated[str, typer.Option(help="Only cars of this software; * stands for others.")]


@does("gateway_fleet.cli.fleet_tables:fleet_ask")
def fleet_ask(
    folder: Tables,
    what: Annotated[str, typer.Argument(help="rates of causes, cars that told one, or one car with all it told.")],
    of: Annotated[str, typer.Argument(help="A cause, for cars; the id of a car, for car.")] = "",
    by: Annotated[
        list[str] | None, typer.Option("--by", help="Rates by model, software, week, limits; may be repeated.")
    ] = None,
    json: Json = False,
) -> None:
    """Answer the usual questions from a fleet's tables."""


@does("gateway_fleet.cli.fleet_tables:fleet_learn")
def fleet_learn(
    folder: Tables,
    out: Annotated[Path, typer.Option("--out", "-o", help="Campaign to write.")],
    fleet: Fleet,
    name: Annotated[str, typer.Option(help="Name of the campaign.")],
    serial: Annotated[int, typer.Option(min=1, help="Its number, above all before.")],
    days: Annotated[float, typer.Option(min=0.01, max=3650, help="How long its limits judge [days].")] = 365.0,
    model: Model = "*",
    software: Software = "*",
    condition: Annotated[str, typer.Option(help="Only blocks under this condition of [fleet].")] = "",
    false_per_hour: Annotated[
        float, typer.Option(min=1e-9, max=1e6, help="False codes that all tests together may set in an hour.")
    ] = 1e-3,
    json: Json = False,
) -> None:
    """Make limits of many cars, as a campaign that is not signed yet.

    Each limit has its false alarm rate and the interval of that. Below 100 cars each car gets a limit from its own
    centre.
    """


@does("gateway_fleet.cli.fleet_tables:fleet_page")
def fleet_page(
    folder: Tables, out: Annotated[Path, typer.Option("--out", "-o", help="HTML file to write.")] = Path("fleet.html")
) -> None:
    """Write a page of a fleet: causes, cars, campaigns."""


@does("gateway_fleet.cli.owner:fleet_signer")
def fleet_signer(path: Annotated[Path, typer.Argument(help="File of the private key to write.")]) -> None:
    """Make a key that signs; print its public half."""


@does("gateway_fleet.cli.owner:fleet_sign")
def fleet_sign(
    file: Annotated[Path, typer.Argument(help="Campaign or keys (TOML).")],
    key: Private,
    out: Annotated[Path, typer.Option("--out", "-o", help="Signed document to write.")],
) -> None:
    """Sign a campaign, or the fleet's keys."""


@does("gateway_fleet.cli.owner:fleet_publish")
def fleet_publish(
    file: Annotated[Path, typer.Argument(help="Signed document.")],
    broker: Annotated[str, typer.Argument(help="Broker, as HOST or HOST:PORT.")],
    user: User = "",
    password_file: PasswordFile = None,
    ca: Ca = None,
    certificate: Certificate = None,
    key: Key = None,
) -> None:
    """Publish a signed campaign, or keys, to all cars of a fleet."""


@does("gateway_fleet.cli.owner:fleet_next")
def fleet_next(
    file: Annotated[Path, typer.Argument(help="Signed campaign as it is now.")],
    folder: Tables,
    key: Private,
    out: Annotated[Path, typer.Option("--out", "-o", help="Signed document to write.")],
    least_hours: Annotated[
        float, typer.Option(min=0, help="Time that its limits must have judged before a larger share has them [h].")
    ] = 100.0,
) -> None:
    """Sign the next stage of a campaign, or its end.

    It is withdrawn where cars with its limits tell more causes than cars without. Exit code 1: it is not time.
    """


@does("gateway_fleet.cli.owner:fleet_forget")
def fleet_forget(folder: Tables, car: Annotated[str, typer.Argument(help="Id of the car.")]) -> None:
    """Delete all data of a car; what comes of it later is not kept."""


@does("gateway_fleet.cli.owner:fleet_leave", config="config_path")
def fleet_leave(config: ConfigOption = None) -> None:
    """Delete what waits in a car for its fleet.

    Limits that came from there go, too.
    """
