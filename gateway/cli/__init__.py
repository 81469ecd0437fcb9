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
from gateway.cli.options import ConfigArgument, FailOnDtc, JsonEvents, MemoryOption, PortOption, StatusOption
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
fleet_app = group("fleet", "Run the logs of many cars through the monitors.")
convert_app = group("convert", "Convert recordings into CAN logs.")
#: Old name of a study -> its name since version 0.2.
_STUDIES = {"voters": "pedal", "hybrid": "truck", "pi-bank": "linear"}
evaluate_app = group("evaluate", "Measure how good the methods are: tables and figures.", _STUDIES)
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
    from gateway.cli.progress import report_compiling

    if debug:
        os.environ[DEBUG] = "1"  # also for processes that it starts
    log.to_stderr()
    report_compiling()


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
