"""The ``gateway`` command: one function per sub-command, no logic.

Each function imports its work only when called, so that ``--help`` answers at once. Exit codes:
0 fine, 1 faults found (``--fail-on-dtc``, ``--check``), 2 bad usage, configuration or input, 70 an error of the
gateway itself.

Annotations are values here, no texts (gateway/cli/options.py).
"""

import gc
import os
import sys
from pathlib import Path
from typing import Annotated

import typer

from gateway import __version__
from gateway.cli.commands import Commands, group
from gateway.cli.failure import DEBUG, ended_by, install_hooks
from gateway.cli.options import (
    LOG_HELP,
    ConfigArgument,
    FailOnDtc,
    HtmlOption,
    Json,
    JsonEvents,
    JunitOfFaults,
    LogArgument,
    Maps,
    MemoryOption,
    PortOption,
    StatusOption,
)
from gateway_fdi.common import log

app = typer.Typer(
    name="gateway",
    cls=Commands,
    rich_markup_mode=None,  # it takes units in brackets, [s], for markup, and swallows them
    help="Diagnostic gateway for ECUs on CAN buses: it finds faults, stores them, and reports their DTCs on the bus.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    add_completion=False,
)
faults_app = typer.Typer(help="Read and clear a fault memory.", no_args_is_help=True, rich_markup_mode=None)
fleet_app = group("fleet", "Run the logs of many cars through the monitors.")
convert_app = group("convert", "Convert recordings into CAN logs.")
#: Old name of a study -> its name since version 0.2.
_STUDIES = {"voters": "pedal", "hybrid": "truck", "pi-bank": "linear"}
evaluate_app = group("evaluate", "Measure how good the methods are: tables and figures.", _STUDIES)
app.add_typer(faults_app, name="faults")
app.add_typer(convert_app, name="convert")
app.add_typer(fleet_app, name="fleet")
app.add_typer(evaluate_app, name="evaluate")


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"gateway {__version__}")
        raise typer.Exit


@app.callback()
def _main(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and exit.")
    ] = False,
    debug: Annotated[
        bool,
        typer.Option("--debug", help="Show tracebacks of errors (as GATEWAY_DEBUG=1 does)."),
    ] = False,
) -> None:
    from gateway.cli.progress import tell_of_kernels

    if debug:
        os.environ[DEBUG] = "1"  # also for processes that it starts
    log.to_stderr()
    tell_of_kernels()


@app.command()
def run(
    config: ConfigArgument = None,
    bus: Annotated[
        str | None, typer.Option(help="URI of the bus instead of the configured one; for one bus only.")
    ] = None,
    memory: MemoryOption = None,
    record: Annotated[Path | None, typer.Option(help="Also write every frame to this log, e.g. drive.log.")] = None,
    duration: Annotated[float | None, typer.Option(min=0, help="Stop after this time [s].")] = None,
    status: StatusOption = None,
    page: Annotated[bool, typer.Option("--serve", help="Also serve the web page, in its own process.")] = False,
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
    host: Annotated[
        str, typer.Option(help="Address to listen on; other addresses than loopback need both tokens and TLS.")
    ] = "127.0.0.1",
    port: PortOption = 8808,
    name: Annotated[list[str] | None, typer.Option(help="One more host name of this server; may be repeated.")] = None,
    read_token_file: Annotated[
        Path | None,
        typer.Option(
            "--read-token-file", help="File with the token for reading; default on loopback: no token is needed."
        ),
    ] = None,
    control_token_file: Annotated[
        Path | None,
        typer.Option(
            "--control-token-file",
            help="File with the control token; default on loopback: a new token, printed at start.",
        ),
    ] = None,
    cert: Annotated[Path | None, typer.Option("--cert", help="TLS certificate (PEM file).")] = None,
    key: Annotated[Path | None, typer.Option("--key", help="Private key of the TLS certificate (PEM file).")] = None,
    open_page: Annotated[bool, typer.Option("--open", help="Open the page in a browser.")] = False,
    parent: Annotated[int | None, typer.Option("--parent", hidden=True)] = None,
) -> None:
    """Serve the web page of a running gateway.

    The page shows residuals against their thresholds, DTCs with their evidence, buses and messages. Metrics for
    Prometheus are at /metrics. The gateway may be stopped and started again while the page is served.
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
    once: Annotated[
        bool, typer.Option("--once", help="Print the state once and exit; this is the default in a pipe.")
    ] = False,
    json: Json = False,
) -> None:
    """Show the state of a running gateway in the terminal.

    The view has the DTCs, the tests closest to their limits, and the buses.
    """
    from gateway.cli.watch import watch as work

    raise typer.Exit(work(config, status=status, once=once, json=json))


@app.command()
def mqtt(
    broker: Annotated[str, typer.Argument(help="Broker, as HOST or HOST:PORT.")],
    config: Annotated[
        Path | None,
        typer.Option(
            "--config", "-c", help="Configuration file; default: gateway.toml in this folder, or else the shipped one."
        ),
    ] = None,
    status: StatusOption = None,
    base: Annotated[str, typer.Option("--topic", help="First part of all topics.  [default: gateway/NAME]")] = "",
    signals: Annotated[
        list[str] | None, typer.Option("--signal", help="Also publish this signal, as Message.Signal; may be repeated.")
    ] = None,
    rate: Annotated[
        float, typer.Option(min=0.01, max=20, help="Highest rate at which each signal is published [Hz].")
    ] = 1.0,
    user: Annotated[str, typer.Option(help="User name for the broker.")] = "",
    password_file: Annotated[
        Path | None, typer.Option("--password-file", help="File with the password for the broker.")
    ] = None,
    tls: Annotated[bool, typer.Option("--tls", help="Connect with TLS.")] = False,
    ca: Annotated[
        Path | None, typer.Option("--ca", help="With --tls: file with the certificates to trust (PEM).")
    ] = None,
) -> None:
    """Publish DTCs and signals of a running gateway by MQTT.

    DTCs and the state (online or offline) are retained messages; chosen signals are sent at a limited rate.
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
def report(
    fault: Annotated[str | None, typer.Argument(help="Id of the fault, e.g. battery.hot.")] = None,
    result: Annotated[
        str | None,
        typer.Argument(help="passed or failed; prepassed or prefailed, which are debounced; not_tested."),
    ] = None,
    data: Annotated[
        list[str] | None, typer.Option("--data", metavar="NAME=NUMBER", help="A number of it; may be repeated.")
    ] = None,
    socket: Annotated[
        Path | None, typer.Option("--socket", help="Report socket of the gateway; default: as configured in [report].")
    ] = None,
    config: Annotated[
        Path | None, typer.Option("-c", "--config", help="Configuration file; default: gateway.toml in this folder.")
    ] = None,
    header: Annotated[bool, typer.Option("--header", help="Print the path of the header for C, and exit.")] = False,
    json: Json = False,
) -> None:
    """Report a test result of your own to a running gateway.

    Exit code 1: it is refused at present, and may be taken later.
    """
    from gateway.cli.reporter import print_header
    from gateway.cli.reporter import report as work

    if header:
        raise typer.Exit(print_header())
    raise typer.Exit(work(fault, result, data or (), socket=socket, config=config, json=json))


@app.command()
def bus(
    address: Annotated[str, typer.Argument(help="Loopback address and port to listen on.")] = "127.0.0.1:29536",
    duration: Annotated[float | None, typer.Option(min=0, help="Stop after this time [s].")] = None,
    json: JsonEvents = False,
) -> None:
    """Run a CAN bus between processes, without kernel support.

    It speaks the socketcand protocol, on this machine only. Every local user can read and write frames.
    """
    from gateway.cli.bus import bus as work

    raise typer.Exit(work(address, duration=duration, json=json))


@app.command()
def record(
    buses: Annotated[list[str], typer.Argument(help="URIs, e.g. socketcan:can0 socketcan:can1.")],
    out: Annotated[
        Path | None, typer.Option(help="Log to write: .log, .blf, .asc, .mf4, .trc, .csv, .parquet.")
    ] = None,
    ring: Annotated[
        Path | None, typer.Option(help="Folder for a ring of segments: the newest segment replaces the oldest.")
    ] = None,
    keep_mb: Annotated[float, typer.Option(help="With --ring: size of all segments together [MB].")] = 256.0,
    segment_mb: Annotated[float, typer.Option(help="With --ring: size of one segment [MB].")] = 16.0,
    form: Annotated[str, typer.Option("--format", help="With --ring: format of the segments, log or blf.")] = "log",
    duration: Annotated[float | None, typer.Option(min=0, help="Stop after this time [s].")] = None,
    json: JsonEvents = False,
) -> None:
    """Record buses without monitoring them.

    If a bus goes away, the recording waits until it comes back.
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


@app.command()
def replay(
    logs: Annotated[list[Path], typer.Argument(metavar="LOG...", help=LOG_HELP)],
    config: Annotated[
        Path | None,
        typer.Option(
            "--config", "-c", help="Configuration file; default: gateway.toml in this folder, or else the shipped one."
        ),
    ] = None,
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
    json: JsonEvents = False,
    fail_on_dtc: FailOnDtc = False,
) -> None:
    """Run recorded logs through the monitors, one by one.

    Without --memory, no fault memory is read or written. Exit code 2: a log is damaged, cut off, or has no frame of a
    configured bus; its frames are replayed all the same.
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
        list[str], typer.Argument(metavar="LOG...", help="Logs, folders of logs, or patterns, e.g. 'logs/**/*.mf4'.")
    ],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the tables.")],
    database: Annotated[
        list[Path] | None,
        typer.Option(
            "--database", "-d", help="Database for the frames of all buses (.dbc, .kcd, .sym, .arxml); may be repeated."
        ),
    ] = None,
    config: Annotated[
        Path | None,
        typer.Option("--config", "-c", help="Take buses and databases from this configuration, instead of --database."),
    ] = None,
    maps: Maps = None,
    device: Annotated[
        str | None, typer.Option("--device", help="Name of the device (car) of the logs.  [default: folder of the log]")
    ] = None,
    numbers: Annotated[bool, typer.Option("--numbers", help="Write numbers instead of the names of values.")] = False,
    json: JsonEvents = False,
) -> None:
    """Decode logs into Parquet tables, one table per message.

    The files are device/message/YYYY/MM/DD/log.parquet, with the time t in UTC and one column per signal. Exit code 2:
    a log is damaged; its whole frames are decoded all the same.
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
    from gateway.cli.watched import plot_file

    raise typer.Exit(plot_file(series, output, only or ()))


@app.command()
def check(
    config: ConfigArgument = None,
    schema: Annotated[
        bool, typer.Option("--schema", help="Print the JSON Schema of the configuration and exit.")
    ] = False,
    why: Annotated[
        str | None,
        typer.Option(metavar="FAULT", help="Print what a failure of this fault's test blames, and its pass clears."),
    ] = None,
    json: Json = False,
) -> None:
    """Check a configuration and list all its errors."""
    if why is not None:
        from gateway.cli.why import why as explain

        raise typer.Exit(explain(config, why, json=json))
    from gateway.cli.check import check as work

    raise typer.Exit(work(config, schema_wanted=schema, json=json))


@app.command("new-monitor")
def new_monitor(
    name: Annotated[str, typer.Argument(help="Name of the monitor, also of its Python module, e.g. coolant.")],
    folder: Annotated[Path | None, typer.Option("--folder", help="Folder to write.  [default: NAME]")] = None,
) -> None:
    """Write a folder with a new monitor of your own.

    The folder has a monitor, database, configuration, virtual ECU, scenario and test. It runs as it is.
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
        bool, typer.Option("--running", help="Exit with code 1 unless a gateway runs and its buses are open.")
    ] = False,
    bench: Annotated[bool, typer.Option("--bench", help="Measure the speed of the gateway, for ten seconds.")] = False,
    json: Json = False,
) -> None:
    """Show what this machine offers and how its gateway is doing."""
    from gateway.cli.doctor import doctor as work

    raise typer.Exit(work(config, memory=memory, running=running, bench=bench, json=json))


@faults_app.command("list")
def faults_list(
    memory: MemoryOption = None,
    config: ConfigArgument = None,
    json: Json = False,
    ecu: Annotated[str | None, typer.Option(help="DTCs of another ECU, by its name; all: of all.")] = None,
) -> None:
    """List the DTCs of a fault memory."""
    from gateway.cli.faults import list_ecu_dtcs, list_faults

    raise typer.Exit(
        list_faults(config, memory=memory, json=json)
        if ecu is None
        else list_ecu_dtcs(ecu, config, memory=memory, json=json)
    )


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
    dtc: Annotated[str | None, typer.Argument(help="DTC to clear; default: all DTCs.")] = None,
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


@faults_app.command("verify")
def faults_verify(memory: MemoryOption = None, config: ConfigArgument = None, json: Json = False) -> None:
    """Say whether a fault memory is whole.

    Each entry, intervention, clear and number is checked against the chain of what was written. Exit code 1 if one is
    not what was written; the first one is named.
    """
    from gateway.cli.faults import verify as work

    raise typer.Exit(work(config, memory=memory, json=json))


@faults_app.command("near-misses")
def faults_near_misses(memory: MemoryOption = None, config: ConfigArgument = None, json: Json = False) -> None:
    """List how often faults came close to failing, and how close."""
    from gateway.cli.faults import near_misses as work

    raise typer.Exit(work(config, memory=memory, json=json))


@faults_app.command("interventions")
def faults_interventions(memory: MemoryOption = None, config: ConfigArgument = None, json: Json = False) -> None:
    """List changes that testers made, or were refused."""
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
    """Write the frames around the failures of a DTC as logs."""
    from gateway.cli.faults import recordings as work

    raise typer.Exit(work(dtc, config, memory=memory, folder=folder, json=json))


@faults_app.command("export")
def faults_export(
    config: ConfigArgument = None,
    out: Annotated[Path | None, typer.Option(help="File to write; default: standard output.")] = None,
) -> None:
    """Write the catalogue of faults as JSON.

    It has faults, data identifiers and extended data records, as indented JSON.
    """
    from gateway.cli.export import export as work

    raise typer.Exit(work(config, out=out))


@convert_app.command("log")
def convert_log(
    source: LogArgument,
    log: Annotated[Path, typer.Argument(help="Log to write: .log, .asc, .blf, .mf4, .trc, .csv, .parquet.")],
    json: Json = False,
) -> None:
    """Convert a CAN log into another format.

    Data-science tools read Parquet.
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
