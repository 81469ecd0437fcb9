"""What people and programs see: log lines on stderr, events on stdout as text or JSON Lines."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gateway.common.jsonlines import line
from gateway.common.resources import shipped
from gateway.errors import InputError
from gateway.faults.status import Status

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

#: Columns of a table that does not go to a terminal.
WIDTH = 180


def say(text: str) -> None:
    """Tell a person something that is not data."""
    print(text, file=sys.stderr, flush=True)


def wide_console() -> Console:
    """Return a console for wide tables, which stay wide in a file or a pipe."""
    from rich.console import Console  # noqa: PLC0415 - slow to load

    from gateway.cli.folding import FoldingConsole  # noqa: PLC0415

    if Console().is_terminal:
        return FoldingConsole()
    return FoldingConsole(width=WIDTH)


def table_of(*headers: str) -> Table:
    """Return a table without lines, for as many columns as a screen has."""
    from rich.table import Table  # noqa: PLC0415 - slow to load

    return Table(*headers, box=None, pad_edge=False)


def print_json(value: Any, *, indent: int | None = None) -> None:
    """Print one JSON document, on one line: what ``--json`` prints is JSON Lines everywhere."""
    print(line(value, indent=indent), flush=True)


def status_text(status: int) -> str:
    """Return the names of the set bits of a status byte."""
    return " ".join(bit.name or "" for bit in Status(status)) or "-"


class EventPrinter:
    """Prints events of the JSON contract as they come.

    Args:
        as_json: JSON Lines instead of text.
        start_ns: time stamp that people see as zero.
        log: name of the log that they are of, for each line of JSON; None: there is one log, which needs no name.
    """

    def __init__(self, *, as_json: bool, start_ns: int = 0, log: str | None = None) -> None:
        self._json = as_json
        self._more = {} if log is None else {"log": log}
        self.start_ns = start_ns
        self.failures = 0
        from rich.console import Console  # noqa: PLC0415 - slow to load

        self._console = Console(highlight=False, soft_wrap=True)

    def __call__(self, event: dict[str, Any]) -> None:
        """Print one event."""
        if event["event"] == "dtc" and event["status"] & Status.TEST_FAILED:
            self.failures += 1
        if self._json:
            print_json({**event, **self._more})
        elif event["event"] == "dtc":
            self._dtc(event)
        elif event["event"] == "step":
            from gateway.cli.trace import text_of  # noqa: PLC0415 - few want it

            print("\n".join(text_of(event, self.start_ns)))
        elif event["event"] == "bus":
            self._bus(event)
        elif event["event"] == "clock":
            self._clock(event)
        elif event["event"] == "memory":
            self._memory(event)
        elif event["event"] == "clear":
            gone = ", ".join(event["faults"]) or "no entry was there"
            self._console.print(f"{self._time(event)}  cleared: {gone}", markup=False)
        elif event["event"] == "monitor_off":
            told = f"{event['monitor']} (type {event['type']}, {event['file']})"
            self._console.print(f"{self._time(event)}  [bold red]monitor switched off[/]", end=" ")
            self._console.print(f"{told}: {event['reason']}", markup=False)
        elif event["event"] == "intervention":
            how = "" if event["outcome"] == "done" else f", refused 0x{event['nrc']:02X}"
            by = f"{event['protocol']} {event['address']:X}"
            self._console.print(f"{self._time(event)}  tester: {event['action']} by {by}{how}", markup=False)
        elif event["event"] == "config":
            self._console.print(f"configuration {event['state']} {event['reason']}".rstrip())
        elif event["event"] == "log":
            for note in event["notes"]:
                self._console.print(f"log: {note}", markup=False)
        elif event["event"] == "summary":
            self._summary(event)

    def _time(self, event: dict[str, Any]) -> str:
        return f"{(event['t_ns'] - self.start_ns) / 1e9:10.4f} s"

    def _dtc(self, event: dict[str, Any]) -> None:
        failed = bool(event["status"] & Status.TEST_FAILED)
        colour, word = ("bold red", "SET") if failed else ("green", "healed")
        self._console.print(
            f"{self._time(event)}  [{colour}]DTC {event['dtc']} {word}[/]  {event['fault']}"
            f"  status 0x{event['status']:02X}  fdc {event['fdc']:+d}"
            f"  occurrence {event['occurrence']}{'' if event['stored'] else '  NOT STORED'}"
        )
        if failed:
            shown = "  ".join(f"{k} {'-' if v is None else format(v, '.6g')}" for k, v in event["evidence"].items())
            self._console.print(f"{'':14}evidence: {shown}", style="dim", markup=False)

    def _clock(self, event: dict[str, Any]) -> None:
        self.start_ns += round(event["step_s"] * 1e9)  # the seconds that people see go on evenly
        self._console.print(f"{self._time(event)}  [bold red]clock set[/] by {event['step_s']:+.6f} s")

    def _memory(self, event: dict[str, Any]) -> None:
        colour = "green" if event["state"] == "written" else "bold red"
        text = f"{self._time(event)}  fault memory [{colour}]{event['state']}[/]  "
        aside = f"; put aside: {event['aside']}" if event.get("aside") else ""
        from rich.markup import escape  # noqa: PLC0415 - slow to load

        self._console.print(text + escape(f"{event['file']} {event['reason']}{aside}".rstrip()))

    def _bus(self, event: dict[str, Any]) -> None:
        if event["state"] in ("open", "lost"):
            from rich.markup import escape  # noqa: PLC0415 - slow to load

            colour = "green" if event["state"] == "open" else "bold red"
            text = f"{self._time(event)}  bus {event['bus']} [{colour}]{event['state']}[/]  "
            self._console.print(text + escape(event["reason"] or event["uri"]))
        elif event["overflow"]:
            self._console.print(f"{event['bus']}: {event['overflow']} frames lost before they were read")

    def _summary(self, event: dict[str, Any]) -> None:
        print_ = self._console.print
        print_(
            f"{event['frames']} frames, {event['decoded']} decoded, {event['events']} events"
            f" in {event['seconds']:.3f} s ({event['frames_per_s']:,.0f} frames/s)"
        )
        for name, values in event["monitors"].items():
            shown = "  ".join(f"{k} {v:.6g}" for k, v in values.items())
            print_(f"{name}: {shown}")
        odd = {k: v for k, v in event["counters"].items() if v and k not in {"frames", "decoded"}}
        if odd:
            print_("counters: " + "  ".join(f"{k} {v}" for k, v in odd.items()))
        for name, counts in event["buses"].items():
            if counts:
                print_(f"bus {name}: " + "  ".join(f"{k} {n}" for k, n in counts.items()))
        print_("DTCs: " + (", ".join(event["dtcs"]) or "none"))


def say_unless_stored(stored: bool, memory: Path | None) -> int:
    """Say at the end that the fault memory could not be written; returns the exit code for it."""
    if stored:
        return 0
    say(
        f"error: {memory}: the fault memory could not be written; what it had not stored is lost."
        " Free the disk, or name another one with --memory"
    )
    return 2


def find_config(path: Path | None) -> Path:
    """Return the configuration to use: the given one, gateway.toml here, or the shipped."""
    if path is not None:
        return path
    here = Path("gateway.toml")
    return here if here.exists() else shipped("gateway.toml")


def find_shipped(name: Path, folder: str, kind: str) -> Path:
    """Return a TOML file: a path, or the name of a shipped one.

    Raises:
        InputError: neither; names the shipped ones.
    """
    if name.exists() or name.suffix == ".toml":
        return name
    try:
        return shipped(f"{folder}/{name}.toml")
    except InputError as error:
        known = ", ".join(sorted(_names(shipped(folder).glob("*.toml"))))
        raise InputError(f"no such {kind}; shipped: {known}", value=str(name)) from error


def find_scenario(name: Path) -> Path:
    """Return a scenario's file (see :func:`find_shipped`)."""
    return find_shipped(name, "scenarios", "scenario")


def _names(paths: Iterable[Path]) -> list[str]:
    return [path.stem for path in paths]
