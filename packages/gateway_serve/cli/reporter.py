"""``gateway report``: one test result of a script, told to a running gateway."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from gateway.cli.present import find_config, print_json, say
from gateway.report import UNANSWERED, UNDELIVERED, Answer, Reporter
from gateway.report import header as header_path
from gateway.report.words import RESULTS
from gateway_fdi.errors import InputError, nearest

#: How long the gateway may take [s]: its disk may be slow, or a new configuration come.
PATIENCE_S = 5.0
#: Refusals that end when something in the vehicle or the gateway changes; all others are mistakes.
NOT_NOW = {"rate", "monitoring_off", "not_enabled"}


def report(
    fault: str | None,
    result: str | None,
    data: Sequence[str],
    *,
    socket: Path | None,
    config: Path | None,
    header: bool = False,
    json: bool,
) -> int:
    """Report one test result; returns the exit code: 0 taken, 1 refused at present, 2 refused for a mistake.

    Args:
        fault: its id.
        result: word of the protocol.
        data: texts ``name=number``.
        socket: of the gateway; None: as configured.
        config: configuration that has it; None: gateway.toml here.
        header: print the path of the header for C instead.
        json: print the answer as JSON.

    Raises:
        InputError: a result that there is none, a number that is none, no gateway, a mistake that it has found.
    """
    if header:
        print(header_path())
        return 0
    if fault is None or result is None:
        raise InputError("gateway report FAULT RESULT, e.g. gateway report battery.hot failed")
    if result not in RESULTS:
        raise InputError(f"a result is one of {', '.join(RESULTS)}{nearest(result, RESULTS)}", value=result)
    numbers = dict(_number(text) for text in data)
    place = socket or configured(config)
    with Reporter(place, patience_s=PATIENCE_S) as reporter:
        answer = reporter.report(fault, result, **numbers)
    code = 0 if answer else 1 if answer.refused in NOT_NOW else 2
    if json:
        print_json({"fault": fault, "result": result, **answer._asdict()})
    elif code == 1:
        say(f"{fault}: refused ({answer.refused}): {answer.why}")
    elif code:
        raise _mistake(fault, place, answer)
    return code


def configured(config: Path | None) -> Path:
    """Return the report socket of a configuration.

    Raises:
        InputError: it has none.
    """
    from gateway.config.load import load_config  # noqa: PLC0415 - slow to load, and --socket has no need of it

    path = find_config(config)
    table = load_config(path).report
    if table is None:
        raise InputError("it has no table [report]; name the socket by --socket", file=path)
    return Path(table.socket)


def _mistake(fault: str, place: Path, answer: Answer) -> InputError:
    if answer.refused in (UNDELIVERED, UNANSWERED):
        return InputError(f"{answer.refused}: {answer.why}", key="--socket", value=str(place))
    return InputError(f"refused ({answer.refused}): {answer.why}", value=fault)


def _number(text: str) -> tuple[str, float]:
    name, _, number = text.partition("=")
    try:
        return name, float(number)
    except ValueError as error:
        raise InputError("NAME=NUMBER", key="--data", value=text) from error
