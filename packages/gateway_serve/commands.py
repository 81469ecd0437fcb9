"""Commands beside a running gateway: one function each, whose work is imported only when it is called.

Annotations are values here, no texts (gateway/cli/options.py).
"""

from pathlib import Path
from typing import Annotated

import typer

from gateway.cli.commands import does
from gateway.cli.options import ConfigArgument, ConfigOption, Json, PortOption, StatusOption


@does("gateway_serve.cli.serve:serve", config="config_path", name="names", cert="certificate")
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
            help="File with the control token; default on loopback: a new one, printed on a terminal, else in a file.",
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


@does("gateway_serve.cli.watch:watch", config="config_path")
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


@does("gateway_serve.cli.request:request", config="config_path")
def request(
    requests: Annotated[
        list[str],
        typer.Argument(metavar="UDS...", help="Hex digits, e.g. 22F190, or names: VIN, coolant; one session has all."),
    ],
    config: ConfigOption = None,
    status: StatusOption = None,
    ecu: Annotated[str, typer.Option(help="Name of an [[ecu]]; self: the gateway.")] = "self",
    json: Json = False,
) -> None:
    """Ask a running gateway by UDS, or an ECU that it reaches.

    The rules are those for testers on a bus; each intervention is noted. The exit code is 1 if an answer is negative.
    """


@does("gateway_serve.cli.mqtt:mqtt", config="config_path")
def mqtt(
    broker: Annotated[str, typer.Argument(help="Broker, as HOST or HOST:PORT.")],
    config: ConfigOption = None,
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


@does("gateway_serve.cli.reporter:report")
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
