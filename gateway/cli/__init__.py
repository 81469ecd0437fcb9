"""The ``gateway`` command: one function per sub-command, no logic.

Each function imports its work only when called, so that ``--help`` answers at once. Exit codes:
0 fine, 1 faults found (``--fail-on-dtc``, ``--check``), 2 bad usage, configuration or input, 70 an error of the
gateway itself.

Annotations are values here, no texts: typer asks for all of them at each start, and would have each text compiled.
"""

import gc
import os
import sys
from pathlib import Path
from typing import Annotated

import typer

from gateway import __version__
from gateway.cli.commands import Commands
from gateway.cli.failure import DEBUG, ended_by, install_hooks
from gateway.common import log

app = typer.Typer(
    name="gateway",
    cls=Commands,
    rich_markup_mode=None,  # it takes units in brackets, [s], for markup, and swallows them
    help="CAN-bus ECU diagnostic gateway: fault detection, fault memory, DTCs back on the bus.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    add_completion=False,
)
faults_app = typer.Typer(help="Read and clear a fault memory.", no_args_is_help=True, rich_markup_mode=None)
fleet_app = typer.Typer(help="Judge the logs of many cars.", no_args_is_help=True, rich_markup_mode=None)
convert_app = typer.Typer(
    help="Turn recordings into CAN logs.",
    no_args_is_help=True,
    rich_markup_mode=None,
)
app.add_typer(faults_app, name="faults")
app.add_typer(convert_app, name="convert")
app.add_typer(fleet_app, name="fleet")

Json = Annotated[bool, typer.Option("--json", help="Print JSON instead of text: one document, on one line.")]
JsonEvents = Annotated[bool, typer.Option("--json", help="Print JSON Lines instead of text: one event a line.")]
FailOnDtc = Annotated[bool, typer.Option("--fail-on-dtc", help="Exit with 1 if a DTC was set.")]
ConfigArgument = Annotated[
    Path | None, typer.Argument(help="Configuration; default: gateway.toml here, else the shipped.")
]
MemoryOption = Annotated[Path | None, typer.Option("--memory", help="SQLite file of the fault memory.")]
Maps = Annotated[
    list[str] | None,
    typer.Option(
        "--map",
        metavar="CHANNEL=BUS",
        help="Take a channel of the log as a bus of the configuration; may be repeated.",
    ),
]
StatusOption = Annotated[
    Path | None,
    typer.Option("--status", help="Status socket; default: [status] of the configuration, or beside the fault memory."),
]
HtmlOption = Annotated[Path | None, typer.Option("--html", help="Write a report of it: one file, e.g. report.html.")]
LOG_HELP = "candump .log, .asc, .blf, .mf4, .trc, .csv, .parquet; also as .gz, .bz2, .xz, .zst, .zip; or a folder."
LogArgument = Annotated[Path, typer.Argument(help=LOG_HELP)]
JunitOfFaults = Annotated[Path | None, typer.Option("--junit", help="Write a JUnit file, a test case a fault.")]
PortOption = Annotated[int, typer.Option(min=0, max=65535, help="Port of the page; 0: any that is free.")]
Seed = Annotated[int | None, typer.Option(help="Seed instead of the scenario's.")]
ScenarioArgument = Annotated[Path, typer.Argument(help="Scenario file, or the name of a shipped one.")]


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"gateway {__version__}")
        raise typer.Exit


@app.callback()
def _main(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
    debug: Annotated[
        bool,
        typer.Option("--debug", help="Show the traceback of an error of the gateway; or GATEWAY_DEBUG=1."),
    ] = False,
) -> None:
    from gateway.cli.progress import tell_of_kernels

    if debug:
        os.environ[DEBUG] = "1"  # also for processes that it starts
    log.to_stderr()
    tell_of_kernels()


@app.command()
def demo(
    scenario: ScenarioArgument = Path("crank_missed_tooth"),
    speed: Annotated[float, typer.Option(min=0, help="Times real time; 0: as fast as it goes.")] = 2.0,
    seed: Seed = None,
    page: Annotated[bool, typer.Option("--serve", help="Show it on a page, which stays until Ctrl-C.")] = False,
    port: PortOption = 8808,
    open_page: Annotated[
        bool, typer.Option("--open/--no-open", help="With --serve: open the page in a browser.")
    ] = True,
    json: JsonEvents = False,
) -> None:
    """Show the whole chain in one process, virtual ECU to DTC frame."""
    from gateway.cli.simulate import demo as work

    shown = port if page else None
    raise typer.Exit(work(scenario, speed=speed, seed=seed, page=shown, open_page=open_page, json=json))


@app.command()
def run(
    config: ConfigArgument = None,
    bus: Annotated[str | None, typer.Option(help="URI instead of the configured one (one bus only).")] = None,
    memory: MemoryOption = None,
    record: Annotated[Path | None, typer.Option(help="Write every frame to this log, e.g. drive.log.")] = None,
    duration: Annotated[float | None, typer.Option(min=0, help="End after so many seconds.")] = None,
    status: StatusOption = None,
    page: Annotated[
        bool, typer.Option("--serve", help="Show what happens on a page, in a process of its own.")
    ] = False,
    port: PortOption = 8808,
    json: JsonEvents = False,
    fail_on_dtc: FailOnDtc = False,
) -> None:
    """Monitor live buses until SIGINT or SIGTERM."""
    from gateway.cli.run import run as work

    raise typer.Exit(
        work(
            config,
            bus=bus,
            memory=memory,
            record=record,
            duration=duration,
            status=status,
            page=port if page else None,
            json=json,
            fail_on_dtc=fail_on_dtc,
        )
    )


@app.command()
def serve(
    config: ConfigArgument = None,
    status: StatusOption = None,
    host: Annotated[str, typer.Option(help="Address to listen at; not loopback: with tokens and TLS.")] = "127.0.0.1",
    port: PortOption = 8808,
    name: Annotated[list[str] | None, typer.Option(help="A further name of this server; may be repeated.")] = None,
    read_token_file: Annotated[
        Path | None, typer.Option("--read-token-file", help="File of the token for reading; none: on loopback anybody.")
    ] = None,
    control_token_file: Annotated[
        Path | None,
        typer.Option("--control-token-file", help="File of the token for clearing; none: on loopback a new one, said."),
    ] = None,
    cert: Annotated[Path | None, typer.Option("--cert", help="Certificate for TLS (PEM).")] = None,
    key: Annotated[Path | None, typer.Option("--key", help="Its private key (PEM).")] = None,
    open_page: Annotated[bool, typer.Option("--open", help="Open the page in a browser.")] = False,
    parent: Annotated[int | None, typer.Option("--parent", hidden=True)] = None,
) -> None:
    """Serve the page of a running gateway.

    It shows residuals against their thresholds, DTCs with their evidence, buses and messages, and has metrics for
    Prometheus at /metrics. The gateway may be started, stopped and started again meanwhile.
    """
    from gateway.cli.serve import serve as work

    raise typer.Exit(
        work(
            config,
            status=status,
            host=host,
            port=port,
            names=name or (),
            read_token_file=read_token_file,
            control_token_file=control_token_file,
            certificate=cert,
            key=key,
            open_page=open_page,
            parent=parent,
        )
    )


@app.command()
def watch(
    config: ConfigArgument = None,
    status: StatusOption = None,
    once: Annotated[bool, typer.Option("--once", help="Show it once; as where the output is no terminal.")] = False,
    json: Json = False,
) -> None:
    """Show in the terminal what a running gateway sees.

    DTCs, the tests that are nearest to a fault, buses.
    """
    from gateway.cli.watch import watch as work

    raise typer.Exit(work(config, status=status, once=once, json=json))


@app.command()
def mqtt(
    broker: Annotated[str, typer.Argument(help="HOST or HOST:PORT of the broker.")],
    config: Annotated[
        Path | None,
        typer.Option("--config", "-c", help="Configuration; default: gateway.toml here, else the shipped."),
    ] = None,
    status: StatusOption = None,
    base: Annotated[str, typer.Option("--topic", help="First part of all topics.  [default: gateway/NAME]")] = "",
    signals: Annotated[
        list[str] | None, typer.Option("--signal", help="A signal to tell, Message.Signal; may be repeated.")
    ] = None,
    rate: Annotated[float, typer.Option(min=0.01, max=20, help="How often each signal is told at most [Hz].")] = 1.0,
    user: Annotated[str, typer.Option(help="User at the broker.")] = "",
    password_file: Annotated[Path | None, typer.Option("--password-file", help="File of the password.")] = None,
    tls: Annotated[bool, typer.Option("--tls", help="By TLS.")] = False,
    ca: Annotated[Path | None, typer.Option("--ca", help="With --tls: certificates to trust (PEM).")] = None,
) -> None:
    """Tell an MQTT broker what a running gateway knows.

    Trouble codes and online or offline as retained messages, chosen signals at a limited rate.
    """
    from gateway.cli.mqtt import mqtt as work

    raise typer.Exit(
        work(
            broker,
            config,
            status=status,
            base=base,
            signals=signals or (),
            rate=rate,
            user=user,
            password_file=password_file,
            tls=tls,
            ca=ca,
        )
    )


@app.command()
def simulate(
    scenario: ScenarioArgument,
    bus: Annotated[
        str | None,
        typer.Option(
            help='Bus to drive, default that of the scenario\'s configuration; "inside": '
            "with a gateway of its own, in this process, as fast as it goes."
        ),
    ] = None,
    check: Annotated[bool, typer.Option("--check", help="Exit with 1 unless the expected DTCs come.")] = False,
    wait: Annotated[float, typer.Option(min=0, help="With --check: wait so long for a gateway [s].")] = 60.0,
    record: Annotated[Path | None, typer.Option(help="Write the ECUs' frames to this log.")] = None,
    seed: Seed = None,
    html: HtmlOption = None,
    junit: Annotated[
        Path | None,
        typer.Option(help="Write a JUnit file, a test case an expectation; as --check."),
    ] = None,
    control: Annotated[
        Path | None, typer.Option(help="Listen at this socket for signals and faults to be set (gateway control).")
    ] = None,
    priority: Annotated[
        int | None,
        typer.Option(min=1, max=99, help="Real-time priority (SCHED_RR): even cycles on a busy machine."),
    ] = None,
    json: JsonEvents = False,
) -> None:
    """Drive a bus with virtual ECUs and injected faults in real time."""
    from gateway.cli.simulate import simulate as work

    raise typer.Exit(
        work(
            scenario,
            bus=bus,
            check=check,
            wait=wait,
            record=record,
            seed=seed,
            html=html,
            json=json,
            junit=junit,
            control=control,
            priority=priority,
        )
    )


@app.command()
def control(
    socket: Annotated[Path, typer.Argument(help="Socket of a running gateway simulate --control.")],
    words: Annotated[
        list[str] | None,
        typer.Argument(help="set A.x=5 ..., release A.x, inject kind=lost message=A, heal; none: what is set."),
    ] = None,
) -> None:
    """Set signals and faults of a running simulation."""
    from gateway.cli.control import ask, request_of
    from gateway.cli.present import print_json

    print_json(ask(socket, request_of(words or ())))


@app.command()
def structure(
    model: Annotated[Path, typer.Argument(help="Structural model, or the name of a shipped one: truck.")],
    json: Json = False,
    plot: Annotated[Path | None, typer.Option(help="Draw the analysis into this file (.svg, .png, .pdf).")] = None,
    limit: Annotated[
        int, typer.Option(min=1, help="Look at all MSO sets up to this number; of more, at as many as are enough.")
    ] = 20_000,
    residual: Annotated[
        str | None,
        typer.Option(help="A residual generator's sequence and code: its name, or SET:EQUATION."),
    ] = None,
    export: Annotated[
        str | None, typer.Option(metavar="LANGUAGE", help="With --residual: its code in another language: c (C99).")
    ] = None,
    output: Annotated[Path | None, typer.Option("--output", "-o", help="With --export: the file to write.")] = None,
    sensors: Annotated[
        str | None,
        typer.Option(help="Which of these unknowns to measure (a,b,c or all) so that faults are found."),
    ] = None,
) -> None:
    """Find which residual generators a model has, and what they tell."""
    from gateway.cli.structure import structure as work

    made = {"export": export, "output": None if output is None else str(output)}
    raise typer.Exit(work(model, json=json, plot=plot, limit=limit, residual=residual, sensors=sensors, **made))


@app.command()
def learn(
    files: Annotated[
        list[Path], typer.Argument(help="Databases (.dbc, .kcd, .sym, .arxml) and logs of healthy drives.")
    ],
    out: Annotated[Path, typer.Option("--out", "-o", help="Configuration to write.")] = Path("car.toml"),
    bus: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=FILE[,FILE]", help="A bus with its databases; may be repeated."),
    ] = None,
    hold_out: Annotated[
        float, typer.Option(min=0.0, max=0.9, help="Share of each log that is kept back to prove what was learned.")
    ] = 0.3,
    maps: Maps = None,
    pgn: Annotated[bool, typer.Option("--pgn", help="Extended identifiers match by J1939 PGN.")] = False,
    seed: Annotated[int, typer.Option(min=0, help="Of the faults that are put into what was kept back.")] = 1,
    update: Annotated[
        bool, typer.Option("--update", help="Add the logs to a configuration learned before; edited lines stay.")
    ] = False,
    force: Annotated[bool, typer.Option("--force", help="Write over a file that is there.")] = False,
    json: Json = False,
) -> None:
    """Learn a configuration from a database and healthy logs."""
    from gateway.cli.learn import learn_car as work

    raise typer.Exit(
        work(
            files,
            out=out,
            buses=bus or (),
            hold_out=hold_out,
            maps=maps or (),
            pgn=pgn,
            seed=seed,
            update=update,
            force=force,
            json=json,
        )
    )


@app.command()
def calibrate(
    config: Annotated[Path, typer.Argument(help="Configuration.")],
    logs: Annotated[list[str], typer.Argument(help="Logs of healthy drives: files, folders, patterns as 'logs/**'.")],
    mtfa: Annotated[float, typer.Option(min=1, help="Mean time between false alarms of a monitor [s].")] = 3600.0,
    margin: Annotated[float, typer.Option(min=0.01, max=1, help="Largest healthy T of a CUSUM test over its J.")] = 0.5,
    floor: Annotated[float, typer.Option(min=1, help="Least largest T of a CUSUM test, in units of nu.")] = 25.0,
    into: Annotated[bool, typer.Option("--write", help="Put the thresholds into the configuration.")] = False,
    write_to: Annotated[
        Path | None, typer.Option("--write-to", help="Put them into a copy of it, a file beside it.")
    ] = None,
    parts: Annotated[
        Path | None,
        typer.Option(help="A fleet's logs, by workers: folder that keeps what each said; only new logs are read."),
    ] = None,
    scheduler: Annotated[
        str | None, typer.Option(help="With --parts: Dask's scheduler, e.g. tcp://10.0.0.1:8786.")
    ] = None,
    workers: Annotated[
        int | None, typer.Option(min=0, help="With --parts: processes on this machine; 0: this one; default: cores.")
    ] = None,
    maps: Maps = None,
    json: Json = False,
) -> None:
    """Find thresholds from healthy logs, and say how far these carry.

    Those of stopping rules and of CUSUM tests, models of plants, redundant sensors. With --parts a log that is damaged
    or kills its worker is left out and told; without, it is an error.
    """
    from gateway.cli.calibrate import calibrate_logs as work

    raise typer.Exit(
        work(
            config,
            logs,
            mtfa=mtfa,
            margin=margin,
            floor=floor,
            into=write_to or (config if into else None),
            parts=parts,
            scheduler=scheduler,
            workers=workers,
            maps=maps or (),
            json=json,
        )
    )


@app.command()
def bus(
    address: Annotated[str, typer.Argument(help="Loopback address and port.")] = "127.0.0.1:29536",
    duration: Annotated[float | None, typer.Option(min=0, help="End after so many seconds.")] = None,
    json: JsonEvents = False,
) -> None:
    """Run a CAN bus between processes, where the kernel has none.

    It speaks the socketcand protocol, on this machine only; it does not ask local users who they are.
    """
    from gateway.cli.bus import bus as work

    raise typer.Exit(work(address, duration=duration, json=json))


@app.command()
def record(
    buses: Annotated[list[str], typer.Argument(help="URIs, e.g. socketcan:can0 socketcan:can1.")],
    out: Annotated[
        Path | None, typer.Option(help="Log to write: .log, .blf, .asc, .mf4, .trc, .csv, .parquet.")
    ] = None,
    ring: Annotated[Path | None, typer.Option(help="Folder: segments, the oldest given up for the newest.")] = None,
    keep_mb: Annotated[float, typer.Option(help="With --ring: size of all segments [MB].")] = 256.0,
    segment_mb: Annotated[float, typer.Option(help="With --ring: size of a segment [MB].")] = 16.0,
    form: Annotated[str, typer.Option("--format", help="With --ring: log or blf.")] = "log",
    duration: Annotated[float | None, typer.Option(min=0, help="End after so many seconds.")] = None,
    json: JsonEvents = False,
) -> None:
    """Record buses without monitoring them.

    A bus that goes away is waited for.
    """
    from gateway.cli.record import record as work

    raise typer.Exit(
        work(
            buses,
            out=out,
            ring=ring,
            keep_mb=keep_mb,
            segment_mb=segment_mb,
            form=form,
            duration=duration,
            json=json,
        )
    )


SeriesOption = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help="Write what the monitors compute over time: .parquet or .csv (docs/series.md)."),
]
SeriesPlot = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help="Draw it: values against limits, DTCs marked; .svg, .png, .pdf."),
]
SeriesSignals = Annotated[
    list[str] | None,
    typer.Option(metavar="MESSAGE.SIGNAL", help="With --signals, --plot: this signal too. May be repeated."),
]


@app.command()
def replay(
    logs: Annotated[list[Path], typer.Argument(metavar="LOG...", help=LOG_HELP)],
    config: Annotated[
        Path | None,
        typer.Option("--config", "-c", help="Configuration; default: gateway.toml here, else the shipped."),
    ] = None,
    maps: Maps = None,
    memory: MemoryOption = None,
    allow_empty: Annotated[
        bool,
        typer.Option("--allow-empty", help="A log without a frame of a configured bus is no error."),
    ] = False,
    allow_cut: Annotated[
        bool, typer.Option("--allow-cut", help="A log that is cut off at its end is no error.")
    ] = False,
    only: Annotated[str | None, typer.Option("--only", metavar="MONITOR", help="This monitor alone, by name.")] = None,
    trace: Annotated[
        bool,
        typer.Option("--trace", help="With --only: print inputs, state and results of each step."),
    ] = False,
    inject: Annotated[
        list[str] | None,
        typer.Option(
            metavar="FAULT",
            help="Put a fault into the frames: 'drop SPEED @10..12', 'offset SPEED.SPEED=40 @10' (from, to [s]);"
            " drop, repeat, freeze, flip, stuck, offset, value, jump. May be repeated.",
        ),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of the faults' randomness.")] = 1,
    html: HtmlOption = None,
    signals: SeriesOption = None,
    plot: SeriesPlot = None,
    signal: SeriesSignals = None,
    junit: JunitOfFaults = None,
    jobs: Annotated[
        int, typer.Option("--jobs", "-j", min=0, help="Several logs in so many processes; 0: a core each.")
    ] = 1,
    json: JsonEvents = False,
    fail_on_dtc: FailOnDtc = False,
) -> None:
    """Run recorded logs through the monitors, each by itself.

    Without --memory no fault memory is touched. Exit code 2 if a log is damaged, cut off, or holds no frame of a
    configured bus; what it holds is replayed and shown first.
    """
    from gateway.cli.replays import replays as work

    raise typer.Exit(
        work(
            logs,
            config,
            jobs=jobs,
            memory=memory,
            maps=maps or (),
            allow_empty=allow_empty,
            allow_cut=allow_cut,
            monitor=only,
            trace=trace,
            injections=inject or (),
            seed=seed,
            html=html,
            series=signals,
            plot=plot,
            chosen=signal or (),
            json=json,
            fail_on_dtc=fail_on_dtc,
            junit=junit,
        )
    )


@app.command()
def decode(
    logs: Annotated[
        list[str], typer.Argument(metavar="LOG...", help="Logs, folders of logs, or patterns: 'logs/**/*.mf4'.")
    ],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder of the tables.")],
    database: Annotated[
        list[Path] | None,
        typer.Option("--database", "-d", help="Database of all frames (.dbc, .kcd, .sym, .arxml); may be repeated."),
    ] = None,
    config: Annotated[
        Path | None,
        typer.Option("--config", "-c", help="Configuration whose buses and databases are taken, instead."),
    ] = None,
    maps: Maps = None,
    device: Annotated[
        str | None, typer.Option("--device", help="Whose the logs are.  [default: folder of the log]")
    ] = None,
    numbers: Annotated[bool, typer.Option("--numbers", help="Numbers instead of the names of values.")] = False,
    json: JsonEvents = False,
) -> None:
    """Decode logs into Parquet: a table a message.

    device/message/YYYY/MM/DD/log.parquet, with t in UTC and a column a signal. Exit code 2 if a log is damaged; what it
    holds is written.
    """
    from gateway.cli.decode import decode as work

    raise typer.Exit(
        work(
            logs,
            out,
            databases=database or (),
            config=config,
            maps=maps or (),
            device=device,
            numbers=numbers,
            json=json,
        )
    )


@app.command("plot")
def plot_command(
    series: Annotated[Path, typer.Argument(help="File of gateway replay --signals: .parquet or .csv.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="Picture: .svg, .png, .pdf.")],
    only: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="This monitor, fault, quantity or signal alone. May be repeated."),
    ] = None,
) -> None:
    """Draw what monitors computed over time.

    Values against their limits, DTCs marked.
    """
    from gateway.cli.watched import plot_file

    raise typer.Exit(plot_file(series, output, only or ()))


@app.command()
def check(
    config: ConfigArgument = None,
    schema: Annotated[bool, typer.Option("--schema", help="Print the JSON Schema of the configuration.")] = False,
    json: Json = False,
) -> None:
    """Check a configuration; say all that is wrong at once."""
    from gateway.cli.check import check as work

    raise typer.Exit(work(config, schema_wanted=schema, json=json))


@app.command("new-monitor")
def new_monitor(
    name: Annotated[str, typer.Argument(help="A name for a module of Python, e.g. coolant.")],
    folder: Annotated[Path | None, typer.Option("--folder", help="Where to write it.  [default: NAME]")] = None,
) -> None:
    """Write a folder with a monitor of your own.

    It runs as it is: monitor, database, configuration, virtual ECU, scenario, test.
    """
    from gateway.cli.new_monitor import new_monitor as work

    raise typer.Exit(work(name, folder))


@app.command()
def warmup(json: Json = False) -> None:
    """Compile all kernels into the cache, for a quick start."""
    from gateway.cli.warmup import warmup as work

    raise typer.Exit(work(json=json))


@app.command()
def doctor(
    config: ConfigArgument = None,
    memory: MemoryOption = None,
    running: Annotated[
        bool, typer.Option("--running", help="Exit with 1 unless a gateway runs, its buses open.")
    ] = False,
    bench: Annotated[bool, typer.Option("--bench", help="Measure how fast it is, in ten seconds.")] = False,
    json: Json = False,
) -> None:
    """Say what this machine offers, and how the gateway on it does."""
    from gateway.cli.doctor import doctor as work

    raise typer.Exit(work(config, memory=memory, running=running, bench=bench, json=json))


@fleet_app.command("run")
def fleet_run(
    logs: Annotated[list[str], typer.Argument(metavar="LOG...", help="Logs, folders of logs, or patterns: 'logs/**'.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder of the verdicts.")],
    config: Annotated[
        Path | None,
        typer.Option("--config", "-c", help="Configuration; default: gateway.toml here, else the shipped."),
    ] = None,
    scheduler: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help="Dask's scheduler, tcp://host:port; default: a cluster of this machine."),
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option(min=0, help="Workers of that cluster; 0: no cluster.  [default: one a core]"),
    ] = None,
    memory: Annotated[
        str,
        typer.Option(help="Fault memory: fresh for each log, or carried along each device's logs, in their order."),
    ] = "fresh",
    maps: Maps = None,
    device: Annotated[
        str | None, typer.Option("--device", help="Whose the logs are.  [default: first folder below the pattern]")
    ] = None,
    retry: Annotated[bool, typer.Option("--retry", help="Once more what failed or killed its worker.")] = False,
    dashboard: Annotated[
        int | None, typer.Option(min=1, max=65535, help="Port of Dask's dashboard on 127.0.0.1.")
    ] = None,
    json: JsonEvents = False,
) -> None:
    """Run many logs through the monitors, each once.

    Tables of logs, DTCs, tests, events and errors as Parquet. Called again it does what is new. Exit code 2 if a log
    could not be judged; others are.
    """
    from gateway.cli.fleet import fleet_run as work

    raise typer.Exit(
        work(
            logs,
            config,
            out,
            scheduler=scheduler,
            workers=workers,
            memory=memory,
            maps=maps or (),
            device=device,
            retry=retry,
            dashboard=dashboard,
            json=json,
        )
    )


@fleet_app.command("diff")
def fleet_diff(
    first: Annotated[Path, typer.Argument(help="Verdicts of one configuration or version.")],
    second: Annotated[Path, typer.Argument(help="Verdicts of another one.")],
    json: Json = False,
) -> None:
    """Say which logs changed their verdict between two runs.

    With the first event that differs. Exit code 1 if a verdict did.
    """
    from gateway.cli.fleet import fleet_diff as work

    raise typer.Exit(work(first, second, json=json))


@faults_app.command("list")
def faults_list(memory: MemoryOption = None, config: ConfigArgument = None, json: Json = False) -> None:
    """List the DTCs of a fault memory."""
    from gateway.cli.faults import list_faults as work

    raise typer.Exit(work(config, memory=memory, json=json))


@faults_app.command("show")
def faults_show(
    dtc: Annotated[str, typer.Argument(help="DTC, e.g. P0336-39.")],
    memory: MemoryOption = None,
    config: ConfigArgument = None,
    json: Json = False,
) -> None:
    """Show one DTC: status bits, freeze frames, evidence."""
    from gateway.cli.faults import show_fault as work

    raise typer.Exit(work(dtc, config, memory=memory, json=json))


@faults_app.command("clear")
def faults_clear(
    dtc: Annotated[str | None, typer.Argument(help="One DTC; default: all.")] = None,
    memory: MemoryOption = None,
    config: ConfigArgument = None,
    json: Json = False,
    force: Annotated[bool, typer.Option("--force", help="Override the rules of access; it is noted.")] = False,
    why: Annotated[str, typer.Option(help="The reason; it is noted.")] = "",
) -> None:
    """Clear the DTCs of a fault memory.

    A running gateway clears by its rules of access, as for a tester; --force overrides them.
    """
    from gateway.cli.faults import clear_faults as work

    raise typer.Exit(work(dtc, config, memory=memory, json=json, force=force, why=why))


@faults_app.command("near-misses")
def faults_near_misses(memory: MemoryOption = None, config: ConfigArgument = None, json: Json = False) -> None:
    """List how often faults came near a failure, and how near."""
    from gateway.cli.faults import near_misses as work

    raise typer.Exit(work(config, memory=memory, json=json))


@faults_app.command("interventions")
def faults_interventions(memory: MemoryOption = None, config: ConfigArgument = None, json: Json = False) -> None:
    """List what testers did, or were refused."""
    from gateway.cli.faults import interventions as work

    raise typer.Exit(work(config, memory=memory, json=json))


@faults_app.command("recordings")
def faults_recordings(
    dtc: Annotated[str, typer.Argument(help="DTC, e.g. P0336-39.")],
    memory: MemoryOption = None,
    config: ConfigArgument = None,
    folder: Annotated[Path, typer.Option("--out", help="Folder for the logs.")] = Path(),
    json: Json = False,
) -> None:
    """Write the frames around a DTC's failures as candump logs."""
    from gateway.cli.faults import recordings as work

    raise typer.Exit(work(dtc, config, memory=memory, folder=folder, json=json))


@faults_app.command("export")
def faults_export(
    config: ConfigArgument = None,
    out: Annotated[Path | None, typer.Option(help="File; default: standard output.")] = None,
) -> None:
    """Write the catalogue as JSON.

    Faults, data identifiers, extended data records; indented, for people and files.
    """
    from gateway.cli.export import export as work

    raise typer.Exit(work(config, out=out))


@convert_app.command("teeth")
def convert_teeth(
    capture: Annotated[Path, typer.Argument(help="Logic-analyser CSV: time [s], level[, ...].")],
    log: Annotated[Path, typer.Argument(help="CAN log to write, e.g. engine.log.")],
    channel: Annotated[str, typer.Option(help="Channel: number from 0, or its name in the header.")] = "0",
    edge: Annotated[str, typer.Option(help="Edge that a tooth makes: rising or falling.")] = ("falling"),
    frame: Annotated[str, typer.Option(help="classic (CTW_PT4) or fd (CTW_FD27).")] = "classic",
    json: Json = False,
) -> None:
    """Turn a crank sensor's capture into frames of dbc/crank.dbc."""
    from gateway.cli.convert import convert_teeth as work

    raise typer.Exit(work(capture, log, channel=channel, edge=edge, frame=frame, json=json))


@convert_app.command("log")
def convert_log(
    source: LogArgument,
    log: Annotated[Path, typer.Argument(help="Log to write: .log, .asc, .blf, .mf4, .trc, .csv, .parquet.")],
    json: Json = False,
) -> None:
    """Turn a CAN log into another format.

    Parquet is what tools of data science read.
    """
    from gateway.cli.convert import convert_log as work

    raise typer.Exit(work(source, log, json=json))


def main() -> None:
    """Run the command line; no traceback reaches a user who did not ask for it."""
    # Nearly all that a start allocates stays; to look through it after each 700 objects takes a fifteenth of a start.
    gc.set_threshold(20_000)
    # Its matrices have some rows: a thread of numpy's BLAS waits for work in a loop, as long as a whole start takes.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    install_hooks()
    try:
        app()
    except BrokenPipeError:
        sys.stderr.close()
        sys.exit(0)
    except Exception as error:
        sys.exit(ended_by(error))
