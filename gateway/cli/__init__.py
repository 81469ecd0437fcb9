"""The ``gateway`` command: one function per sub-command, no logic.

Each function imports its work only when called (:func:`~gateway.cli.commands.does`), so that ``--help`` answers at
once. Exit codes: 0 fine, 1 faults found (``--fail-on-dtc``, ``--check``), 2 bad usage, configuration or input, 70 an
error of the gateway itself.

Annotations are values here, no texts (gateway/cli/options.py).
"""

import gc
import os
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from gateway.cli.commands import Commands, does, group
from gateway.cli.failure import DEBUG, STOPPED, ended_by, install_hooks, stopped
from gateway.cli.options import (
    LOG_HELP,
    ConfigArgument,
    ConfigOption,
    Every,
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
    Zone,
)
from gateway.common.lazy_modules import postpone
from gateway_fdi.common import log

app = typer.Typer(
    name="gateway",
    cls=Commands,
    rich_markup_mode=None,  # it takes units in brackets, [s], for markup, and swallows them
    help="Diagnostic gateway for ECUs on CAN buses: it finds faults, stores them, and reports their DTCs on the bus.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
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
        from gateway.cli.version import version

        typer.echo(f"gateway {version()}")
        raise typer.Exit


@app.callback()
def _main(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print version and commit, and exit.")
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
@does("gateway.cli.run:run", config="config_path", page="serve")
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
    realtime: Annotated[
        bool, typer.Option(help="Come before all other programs on the processor (root or LimitRTPRIO=1).")
    ] = False,
    json: JsonEvents = False,
    fail_on_dtc: FailOnDtc = False,
) -> None:
    """Monitor live buses until SIGINT or SIGTERM."""


@app.command()
@does("gateway.cli.reporter:report")
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


@app.command()
@does("gateway.cli.bus:bus")
def bus(
    address: Annotated[str, typer.Argument(help="Loopback address and port to listen on.")] = "127.0.0.1:29536",
    duration: Annotated[float | None, typer.Option(min=0, help="Stop after this time [s].")] = None,
    json: JsonEvents = False,
) -> None:
    """Run a CAN bus between processes, without kernel support.

    It speaks the socketcand protocol, on this machine only. Every local user can read and write frames.
    """


@app.command()
@does("gateway.cli.record:record", buses="uris")
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
@does("gateway.cli.replays:replays", only="monitor", inject="injections", signals="series", signal="chosen")
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


@app.command("plot")
@does("gateway.cli.signal_plot:plot_file")
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


@app.command()
@does("gateway.cli.trust:trust")
def trust(
    files: Annotated[
        list[Path] | None, typer.Argument(metavar="FILE...", help="Code: .py, .fmu, what a method has learned.")
    ] = None,
    system: Annotated[
        bool, typer.Option("--system", help="For every user of this machine, in /etc/gateway/trusted.")
    ] = False,
) -> None:
    """Let code beside configurations run, as it is now.

    Configurations, scenarios and models name it. Without a file it lists what may run.

    The modules beside it that it imports are taken, too.
    """


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
    listed: Annotated[bool, typer.Option("--all", help="List each fault and code, however many there are.")] = False,
    json: Json = False,
) -> None:
    """Check a configuration and list all its errors."""
    if why is not None:
        from gateway.cli.dependencies import why as explain

        raise typer.Exit(explain(config, why, json=json))
    from gateway.cli.check import check as work

    raise typer.Exit(work(config, schema_wanted=schema, listed=listed, json=json))


@app.command()
@does("gateway.cli.schema:schema")
def schema(
    kind: Annotated[str, typer.Argument(help="Kind of the file: gateway, scenario, model.")] = "gateway",
    out: Annotated[Path | None, typer.Option("--out", "-o", help="Write the schemas of all kinds here.")] = None,
) -> None:
    """Print the JSON Schema of a kind of file, for editors."""


@app.command("new-monitor")
@does("gateway.cli.new_monitor:new_monitor")
def new_monitor(
    name: Annotated[str, typer.Argument(help="Name of the monitor, also of its Python module, e.g. coolant.")],
    folder: Annotated[Path | None, typer.Option("--folder", help="Folder to write.  [default: NAME]")] = None,
    method: Annotated[
        str | None,
        typer.Option("--from", metavar="METHOD", help="A method of the arena by its name, or FILE.py:CLASS."),
    ] = None,
    plain: Annotated[bool, typer.Option("--plain", help="The monitor is one function of plain Python.")] = False,
) -> None:
    """Write a folder with a new monitor of your own.

    The folder has a monitor, database, configuration, virtual ECU, scenario and test. It runs as it is.
    With --from the monitor is a method of the arena, fitted.
    """


@app.command()
@does("gateway.cli.example:example")
def example(
    name: Annotated[str | None, typer.Argument(help="Name of the example.  [default: list all]")] = None,
    folder: Annotated[Path | None, typer.Option("--folder", help="Folder to write.  [default: NAME]")] = None,
    json: Json = False,
) -> None:
    """Copy an example, to be tried and changed."""


@app.command()
@does("gateway.cli.warmup:warmup")
def warmup(json: Json = False) -> None:
    """Compile all kernels into the cache, for a quick start."""


@app.command()
@does("gateway.cli.doctor:doctor")
def doctor(
    config: ConfigArgument = None,
    memory: MemoryOption = None,
    running: Annotated[
        bool, typer.Option("--running", help="Exit with code 1 unless a gateway runs and its buses are open.")
    ] = False,
    bench: Annotated[bool, typer.Option("--bench", help="Measure the speed of the gateway, for ten seconds.")] = False,
    zone: Zone = None,
    json: Json = False,
) -> None:
    """Show what this machine offers and how its gateway is doing.

    Of a log (gateway doctor drive.blf): its formats, channels, times, kinds of frames, and what was passed over.
    """


@faults_app.command("summary")
@does("gateway.cli.faults:summarize")
def faults_summary(
    memory: MemoryOption = None, config: ConfigArgument = None, every: Every = False, json: Json = False
) -> None:
    """Show the verdict, the causes with their symptoms by ECU, and what was not judged."""


@faults_app.command("list")
@does("gateway.cli.faults:list_faults")
def faults_list(
    memory: MemoryOption = None,
    config: ConfigArgument = None,
    json: Json = False,
    ecu: Annotated[str | None, typer.Option(help="DTCs of another ECU, by its name; all: of all.")] = None,
    every: Every = False,
) -> None:
    """List the DTCs of a fault memory."""


@faults_app.command("show")
@does("gateway.cli.faults:show_fault")
def faults_show(
    dtc: Annotated[str, typer.Argument(help="DTC, e.g. P0336-39.")],
    memory: MemoryOption = None,
    config: ConfigArgument = None,
    every: Every = False,
    json: Json = False,
) -> None:
    """Show one DTC: status bits, freeze frames, evidence."""


@faults_app.command("clear")
@does("gateway.cli.faults:clear_faults")
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


@faults_app.command("verify")
@does("gateway.cli.faults:verify")
def faults_verify(memory: MemoryOption = None, config: ConfigArgument = None, json: Json = False) -> None:
    """Say whether a fault memory is whole.

    Each entry, intervention, clear and number is checked against the chain of what was written. Exit code 1 if one is
    not what was written; the first one is named.
    """


@faults_app.command("near-misses")
@does("gateway.cli.faults:near_misses")
def faults_near_misses(
    memory: MemoryOption = None, config: ConfigArgument = None, every: Every = False, json: Json = False
) -> None:
    """List how often faults came close to failing, and how close."""


@faults_app.command("interventions")
@does("gateway.cli.faults:interventions")
def faults_interventions(memory: MemoryOption = None, config: ConfigArgument = None, json: Json = False) -> None:
    """List changes that testers made, or were refused."""


@faults_app.command("recordings")
@does("gateway.cli.faults:recordings")
def faults_recordings(
    dtc: Annotated[str, typer.Argument(help="DTC, e.g. P0336-39.")],
    memory: MemoryOption = None,
    config: ConfigArgument = None,
    folder: Annotated[Path, typer.Option("--out", help="Folder for the logs.")] = Path(),
    json: Json = False,
) -> None:
    """Write the frames around the failures of a DTC as logs."""


@faults_app.command("export")
@does("gateway.cli.export:export", config="config_path")
def faults_export(
    config: ConfigArgument = None,
    out: Annotated[Path | None, typer.Option(help="File to write; default: standard output.")] = None,
    pdx: Annotated[Path | None, typer.Option(help="Write what UDS testers can ask as PDX (ODX) instead.")] = None,
) -> None:
    """Write the catalogue of faults as JSON, or as PDX.

    JSON has faults, data identifiers and extended data records; PDX has all services of the UDS server, for testers.
    """


@convert_app.command("log")
@does("gateway.cli.convert:convert_log")
def convert_log(
    source: LogArgument,
    log: Annotated[Path, typer.Argument(help="Log to write: .log, .asc, .blf, .mf4, .trc, .csv, .parquet.")],
    zone: Zone = None,
    json: Json = False,
) -> None:
    """Convert a CAN log into another format.

    Data-science tools read Parquet. Exit code 2: a place is damaged, or the format cannot hold all; the rest is there.
    """


def main() -> None:
    """Run the command line; no traceback reaches a user who did not ask for it."""
    # Nearly all that a start allocates stays; to look through it after each 700 objects takes a fifteenth of a start.
    gc.set_threshold(20_000)
    # Its matrices have some rows: a thread of numpy's BLAS waits for work in a loop, as long as a whole start takes.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    postpone()  # before anything imports cantools or can-isotp
    install_hooks()
    try:
        app()
    except BrokenPipeError:
        sys.stderr.close()
        sys.exit(0)
    except SystemExit as ended:
        sys.exit(_code_of(ended))
    except Exception as error:
        sys.exit(ended_by(error))


def _code_of(ended: SystemExit) -> Any:
    """Return the exit code of a command that has ended: 0, if a pipe's reader had enough."""
    try:
        sys.stdout.flush()
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # Python writes the rest at its end
        return 0
    if type(sys.stdout).__name__ == "PacifyFlushWrapper":  # typer's copy of click puts it there, and says 1
        return 0
    return stopped() if ended.code == STOPPED else ended.code
