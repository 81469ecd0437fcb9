"""Commands on files and fault memories: one function each, whose work is imported only when it is called."""

from pathlib import Path
from typing import Annotated

import typer

from gateway.cli.commands import does
from gateway.cli.options import (
    ConfigArgument,
    Every,
    Json,
    JsonEvents,
    LogArgument,
    MemoryOption,
    Zone,
)

faults_app = typer.Typer(help="Read and clear a fault memory.", no_args_is_help=True, rich_markup_mode=None)


@does("gateway_commands.record:record", buses="uris")
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
        from gateway_commands.dependencies import why as explain

        raise typer.Exit(explain(config, why, json=json))
    from gateway_commands.check import check as work

    raise typer.Exit(work(config, schema_wanted=schema, listed=listed, json=json))


@does("gateway_commands.schema:schema")
def schema(
    kind: Annotated[str, typer.Argument(help="Kind of the file: gateway, scenario, model.")] = "gateway",
    out: Annotated[Path | None, typer.Option("--out", "-o", help="Write the schemas of all kinds here.")] = None,
) -> None:
    """Print the JSON Schema of a kind of file, for editors."""


@does("gateway_commands.new_monitor:new_monitor")
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


@does("gateway_commands.example:example")
def example(
    name: Annotated[str | None, typer.Argument(help="Name of the example.  [default: list all]")] = None,
    folder: Annotated[Path | None, typer.Option("--folder", help="Folder to write.  [default: NAME]")] = None,
    json: Json = False,
) -> None:
    """Copy an example, to be tried and changed."""


@does("gateway_commands.warmup:warmup")
def warmup(json: Json = False) -> None:
    """Compile all kernels into the cache, for a quick start."""


@does("gateway_commands.doctor:doctor")
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
@does("gateway_commands.faults:summarize")
def faults_summary(
    memory: MemoryOption = None, config: ConfigArgument = None, every: Every = False, json: Json = False
) -> None:
    """Show the verdict, the causes with their symptoms by ECU, and what was not judged."""


@faults_app.command("list")
@does("gateway_commands.faults:list_faults")
def faults_list(
    memory: MemoryOption = None,
    config: ConfigArgument = None,
    json: Json = False,
    ecu: Annotated[str | None, typer.Option(help="DTCs of another ECU, by its name; all: of all.")] = None,
    every: Every = False,
) -> None:
    """List the DTCs of a fault memory."""


@faults_app.command("show")
@does("gateway_commands.faults:show_fault")
def faults_show(
    dtc: Annotated[str, typer.Argument(help="DTC, e.g. P0336-39.")],
    memory: MemoryOption = None,
    config: ConfigArgument = None,
    every: Every = False,
    json: Json = False,
) -> None:
    """Show one DTC: status bits, freeze frames, evidence."""


@faults_app.command("clear")
@does("gateway_commands.faults:clear_faults")
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
@does("gateway_commands.faults:verify")
def faults_verify(memory: MemoryOption = None, config: ConfigArgument = None, json: Json = False) -> None:
    """Say whether a fault memory is whole.

    Each entry, intervention, clear and number is checked against the chain of what was written. Exit code 1 if one is
    not what was written; the first one is named.
    """


@faults_app.command("near-misses")
@does("gateway_commands.faults:near_misses")
def faults_near_misses(
    memory: MemoryOption = None, config: ConfigArgument = None, every: Every = False, json: Json = False
) -> None:
    """List how often faults came close to failing, and how close."""


@faults_app.command("interventions")
@does("gateway_commands.faults:interventions")
def faults_interventions(memory: MemoryOption = None, config: ConfigArgument = None, json: Json = False) -> None:
    """List changes that testers made, or were refused."""


@faults_app.command("recordings")
@does("gateway_commands.faults:recordings")
def faults_recordings(
    dtc: Annotated[str, typer.Argument(help="DTC, e.g. P0336-39.")],
    memory: MemoryOption = None,
    config: ConfigArgument = None,
    folder: Annotated[Path, typer.Option("--out", help="Folder for the logs.")] = Path(),
    json: Json = False,
) -> None:
    """Write the frames around the failures of a DTC as logs."""


@faults_app.command("export")
@does("gateway_commands.export:export", config="config_path")
def faults_export(
    config: ConfigArgument = None,
    out: Annotated[Path | None, typer.Option(help="File to write; default: standard output.")] = None,
    pdx: Annotated[Path | None, typer.Option(help="Write what UDS testers can ask as PDX (ODX) instead.")] = None,
) -> None:
    """Write the catalogue of faults as JSON, or as PDX.

    JSON has faults, data identifiers and extended data records; PDX has all services of the UDS server, for testers.
    """


@does("gateway_commands.convert:convert_log")
def convert_log(
    source: LogArgument,
    log: Annotated[Path, typer.Argument(help="Log to write: .log, .asc, .blf, .mf4, .trc, .csv, .parquet.")],
    zone: Zone = None,
    json: Json = False,
) -> None:
    """Convert a CAN log into another format.

    Data-science tools read Parquet. Exit code 2: a place is damaged, or the format cannot hold all; the rest is there.
    """
