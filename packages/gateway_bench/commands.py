"""Commands of the bench: one function each, whose work is imported only when it is called."""

from pathlib import Path
from typing import Annotated

import typer

from gateway.cli.commands import does
from gateway.cli.options import HtmlOption, JsonEvents, PortOption, ScenarioArgument, Seed


@does("gateway_bench.cli.simulate:demo", scenario="scenario_name", page="serve")
def demo(
    scenario: ScenarioArgument = Path("crank_missed_tooth"),
    speed: Annotated[
        float, typer.Option(min=0, help="Speed as a multiple of real time; 0: as fast as possible.")
    ] = 2.0,
    seed: Seed = None,
    page: Annotated[bool, typer.Option("--serve", help="Also show the demo on a web page, until Ctrl-C.")] = False,
    port: PortOption = 8808,
    open_page: Annotated[
        bool, typer.Option("--open/--no-open", help="With --serve: open the page in a browser.")
    ] = True,
    json: JsonEvents = False,
) -> None:
    """Show how a fault is found, from virtual ECU to DTC.

    Virtual ECUs and a gateway run in this process; no bus and no configuration is needed.
    """


@does("gateway_bench.cli.simulate:simulate", scenario="scenario_name")
def simulate(
    scenario: ScenarioArgument,
    bus: Annotated[
        str | None,
        typer.Option(
            help="URI of the bus to drive; default: as in the scenario's configuration; "
            '"inside": run a gateway in this process, as fast as possible.'
        ),
    ] = None,
    check: Annotated[bool, typer.Option("--check", help="Exit with code 1 unless the expected DTCs come.")] = False,
    wait: Annotated[float, typer.Option(min=0, help="With --check: how long to wait for a gateway [s].")] = 60.0,
    record: Annotated[Path | None, typer.Option(help="Also write the frames of the ECUs to this log.")] = None,
    seed: Seed = None,
    html: HtmlOption = None,
    junit: Annotated[
        Path | None,
        typer.Option(help="Write a JUnit file with one test case per expectation; implies --check."),
    ] = None,
    control: Annotated[Path | None, typer.Option(help="Listen on this socket for commands of gateway control.")] = None,
    priority: Annotated[
        int | None,
        typer.Option(min=1, max=99, help="Real-time priority (SCHED_RR), for even cycles on a busy machine."),
    ] = None,
    json: JsonEvents = False,
) -> None:
    """Drive a bus with virtual ECUs and faults, in real time."""


def control(
    socket: Annotated[Path, typer.Argument(help="Socket of a running gateway simulate --control.")],
    words: Annotated[
        list[str] | None,
        typer.Argument(
            help="set A.x=5, release A.x, inject kind=lost message=A, or heal; default: list the set signals."
        ),
    ] = None,
) -> None:
    """Set signals and inject faults in a running simulation."""
    from gateway.cli.present import print_json
    from gateway_bench.cli.control import ask, request_of

    print_json(ask(socket, request_of(words or ())))


@does("gateway_bench.cli.bus:bus")
def bus(
    address: Annotated[str, typer.Argument(help="Loopback address and port to listen on.")] = "127.0.0.1:29536",
    duration: Annotated[float | None, typer.Option(min=0, help="Stop after this time [s].")] = None,
    json: JsonEvents = False,
) -> None:
    """Run a CAN bus between processes, without kernel support.

    It speaks the socketcand protocol, on this machine only. Every local user can read and write frames.
    """
