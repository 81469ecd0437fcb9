"""Commands of many cars: one function each, whose work is imported only when it is called."""

from pathlib import Path
from typing import Annotated

import typer

from gateway.cli.commands import does
from gateway.cli.options import ConfigOption, EcuOption, HtmlOption, Json, JsonEvents, Maps

FalsePerHour = Annotated[
    float,
    typer.Option(min=1e-9, max=1e6, help="False codes that all limits of signals together may set in an hour."),
]


@does("gateway_fleet.cli.learn:learn_car", bus="buses")
def learn(
    files: Annotated[
        list[Path],
        typer.Argument(help="Logs of healthy drives, and databases (.dbc, .kcd, .sym, .arxml) if there are any."),
    ],
    out: Annotated[Path, typer.Option("--out", "-o", help="Configuration file to write.")] = Path("car.toml"),
    bus: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME[=FILE[,FILE]]", help="Name of a bus and its databases; may be repeated."),
    ] = None,
    ecu: EcuOption = None,
    hold_out: Annotated[
        float,
        typer.Option(min=0.0, max=0.9, help="Share of each log that is not learned from, but used to test the result."),
    ] = 0.3,
    maps: Maps = None,
    pgn: Annotated[bool, typer.Option("--pgn", help="Match extended identifiers by their J1939 PGN.")] = False,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the faults that are injected into the test share.")] = 1,
    false_per_hour: FalsePerHour = 1e-3,
    update: Annotated[
        bool, typer.Option("--update", help="Add the logs to a configuration learned earlier; edited lines stay.")
    ] = False,
    force: Annotated[bool, typer.Option("--force", help="Overwrite an existing file.")] = False,
    json: Json = False,
) -> None:
    """Learn a configuration from a database and healthy logs."""


@does("gateway_fleet.cli.calibrate:calibrate_logs", config="config_path", into="write")
def calibrate(
    config: Annotated[Path, typer.Argument(help="Configuration file.")],
    logs: Annotated[
        list[str], typer.Argument(help="Logs of healthy drives: files, folders, or patterns, e.g. 'logs/**'.")
    ],
    mtfa: Annotated[float, typer.Option(min=1, help="Mean time between false alarms of a monitor [s].")] = 3600.0,
    margin: Annotated[
        float, typer.Option(min=0.01, max=1, help="CUSUM tests: largest healthy T as a share of the threshold J.")
    ] = 0.5,
    floor: Annotated[
        float, typer.Option(min=1, help="CUSUM tests: lower limit of the largest healthy T, in units of nu.")
    ] = 25.0,
    into: Annotated[bool, typer.Option("--write", help="Write the thresholds into the configuration.")] = False,
    write_to: Annotated[
        Path | None,
        typer.Option(
            "--write-to", help="Write the thresholds into this copy of the configuration, in the same folder."
        ),
    ] = None,
    parts: Annotated[
        Path | None,
        typer.Option(help="Folder for the result of each log, for a fleet: workers read only logs that are new."),
    ] = None,
    scheduler: Annotated[
        str | None, typer.Option(help="With --parts: address of a Dask scheduler, e.g. tcp://10.0.0.1:8786.")
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option(
            min=0,
            help="With --parts: number of workers on this machine; 0: none, use this process; default: one per core.",
        ),
    ] = None,
    maps: Maps = None,
    json: Json = False,
) -> None:
    """Find thresholds from healthy logs, and how reliable they are.

    It calibrates stopping rules, CUSUM tests, models of plants and redundant sensors. With --parts, a log that is
    damaged or ends its worker is left out and reported; without --parts, it is an error.
    """


@does("gateway_fleet.cli.fleet:fleet_run")
def fleet_run(
    logs: Annotated[
        list[str], typer.Argument(metavar="LOG...", help="Logs, folders of logs, or patterns, e.g. 'logs/**'.")
    ],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the results.")],
    config: ConfigOption = None,
    scheduler: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS",
            help="Address of a Dask scheduler, as tcp://HOST:PORT; default: a local cluster on this machine.",
        ),
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option(min=0, help="Number of workers of the local cluster; 0: no cluster.  [default: one per core]"),
    ] = None,
    memory: Annotated[
        str,
        typer.Option(
            help="Fault memory: fresh (a new one for each log) or carried (one per device, through its logs in order)."
        ),
    ] = "fresh",
    maps: Maps = None,
    device: Annotated[
        str | None,
        typer.Option(
            "--device", help="Name of the device (car) of the logs.  [default: first folder below the pattern]"
        ),
    ] = None,
    retry: Annotated[bool, typer.Option("--retry", help="Try logs again that failed or ended their worker.")] = False,
    dashboard: Annotated[
        int | None, typer.Option(min=1, max=65535, help="Port of the Dask dashboard on 127.0.0.1.")
    ] = None,
    json: JsonEvents = False,
) -> None:
    """Run many logs through the monitors, each log once.

    It tells which cars have what (gateway fleet report). The results are Parquet tables of logs, DTCs, tests, events
    and errors. If called again, it runs only new logs. Exit
    code 2: a log could not be run; all others were.
    """


@does("gateway_fleet.cli.fleet:fleet_report")
def fleet_report(
    folder: Annotated[Path, typer.Argument(help="Folder with the results of gateway fleet run.")],
    html: HtmlOption = None,
    csv: Annotated[Path | None, typer.Option(help="Write the findings as a table, e.g. findings.csv.")] = None,
    json: Json = False,
) -> None:
    """Tell which cars have what, since when, and which log to open.

    Causes come first, then DTCs without a proven cause, values far from those of all other cars, and logs that could
    not be judged.
    """


@does("gateway_fleet.cli.fleet:fleet_diff")
def fleet_diff(
    first: Annotated[Path, typer.Argument(help="Folder with the results of one configuration or version.")],
    second: Annotated[Path, typer.Argument(help="Folder with the results of the other one.")],
    json: Json = False,
) -> None:
    """List logs with different results in two runs.

    It shows the first event that differs in each log. Exit code 1: at least one log differs.
    """


@does("gateway_fleet.study.learn.command:learn")
def evaluate_learn(
    cars: Annotated[int, typer.Option(min=1, help="Number of virtual cars.")] = 3,
    seconds: Annotated[float, typer.Option(min=30, help="Length of the drive that is learned of [s].")] = 300.0,
    hours: Annotated[float, typer.Option(min=0, help="Other healthy drives, together [h].")] = 20.0,
    ways: Annotated[str, typer.Option(help="How frames reach the log: clean,lost,sleeps,host,all.")] = "lost,all",
    seed: Annotated[int, typer.Option(min=0, help="Seed of the first car.")] = 2026,
    database: Annotated[bool, typer.Option(help="Whether the car's database is there.")] = True,
    json: Json = False,
) -> None:
    """Evaluate what is learned of virtual cars.

    Cars have 40 messages; claims are compared with the truth, and healthy drives give codes or none.
    """


@does("gateway_fleet.study.senders.command:senders")
def evaluate_senders(
    files: Annotated[
        list[Path] | None,
        typer.Argument(
            help="Logs of one healthy car more, with databases (.dbc) if there are any. The first log is learned of,"
            " the others are attacked and replayed; of one log the second half."
        ),
    ] = None,
    cars: Annotated[int, typer.Option(min=0, help="Number of virtual cars.")] = 3,
    attacks: Annotated[int, typer.Option(min=1, help="Number of attacks of each kind.")] = 500,
    hours: Annotated[
        float, typer.Option(min=0, help="Other healthy drives, and replays of the logs by late hosts, together [h].")
    ] = 20.0,
    seed: Annotated[int, typer.Option(min=0, help="Seed of all randomness.")] = 2026,
    json: Json = False,
) -> None:
    """Judge what is seen of other senders, by injected frames."""


@does("gateway_fleet.study.drives.command:drives")
def evaluate_drives(
    folder: Annotated[
        Path, typer.Argument(help="A folder a vehicle in it: logs of healthy drives, with databases if there are any.")
    ],
    faults: Annotated[
        int, typer.Option(min=0, help="Faults of each kind that are put into a vehicle's other drives; 0: none.")
    ] = 1,
    seed: Annotated[int, typer.Option(min=0, help="Seed of all randomness.")] = 2026,
    workers: Annotated[
        int | None,
        typer.Option(min=0, help="Workers on this machine; 0: none, use this process.  [default: one per core]"),
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Folder that keeps what is learned.  [default: kept nowhere]")
    ] = None,
    false_per_hour: FalsePerHour = 1e-3,
    column: Annotated[
        list[str] | None,
        typer.Option(
            metavar="ROLE=NAME",
            help="Of tables of values (CSV): time=NAME, truth=NAME (not 0 where something is wrong), out=NAME (no"
            " signal); may be repeated.",
        ),
    ] = None,
    json: Json = False,
) -> None:
    """Judge what is learned of vehicles, on their other drives.

    It tells the false codes and causes of the healthy drives, and what comes of everyday faults that are put into them.
    Of each vehicle the largest log is learned of; a single log is halved. A CSV of values is a machine of its own: with
    a column of truth it is learned of the begin. Exit code 2: a vehicle or drive could not be judged; all others were.
    """


@does("gateway_fleet.study.senders.road:road")
def evaluate_road(
    folder: Annotated[Path, typer.Argument(help="Folder of the ROAD dataset, with ambient and attacks in it.")],
    json: Json = False,
) -> None:
    """Judge what is seen of the ROAD dataset's attacks."""


def evaluate_cause(
    seeds: Annotated[int, typer.Option(min=0, help="Number of runs of each fault; 0: none.")] = 3,
    pairs: Annotated[int, typer.Option(min=0, help="Number of runs with two faults; 0: none.")] = 200,
    healthy: Annotated[int, typer.Option(min=0, help="Number of healthy runs of each scenario; 0: none.")] = 3,
    seed: Annotated[int, typer.Option(min=0, help="Seed of all randomness.")] = 2026,
    work: Annotated[Path, typer.Option(help="Folder for the two cars that are learned.")] = Path("cause"),
    figures: Annotated[
        Path | None, typer.Option(help="Draw the pictures of docs/cause.md into this folder, only.")
    ] = None,
    json: Json = False,
) -> None:
    """Evaluate which component is named as the cause.

    One or two faults are put into plants and learned cars.
    """
    from gateway_fleet.study.cause.command import cause as run
    from gateway_fleet.study.cause.command import draw

    if figures is not None:
        raise typer.Exit(draw(figures, work))
    raise typer.Exit(run(seeds=seeds, pair_runs=pairs, healthy_runs=healthy, seed=seed, work=work, json=json))
