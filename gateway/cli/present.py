"""Output for people and programs: texts on stderr, tables and JSON on stdout, names of shipped files."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gateway.common.jsonlines import line
from gateway.faults.status import Status
from gateway_fdi.common.resources import all_shipped, beside_or_shipped, shipped
from gateway_fdi.errors import InputError

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from gateway.config.model import Config

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
    """Print one JSON document, on one line: ``--json`` prints JSON Lines everywhere."""
    print(line(value, indent=indent), flush=True)


def status_text(status: int) -> str:
    """Return the names of the set bits of a status byte."""
    return " ".join(bit.name or "" for bit in Status(status)) or "-"


def say_unless_stored(stored: bool, memory: Path | None) -> int:
    """Say at the end that the fault memory could not be written; returns the exit code for it."""
    if stored:
        return 0
    say(
        f"error: {memory}: the fault memory could not be written; changes that it had not stored are lost."
        " Free the disk, or name another one with --memory"
    )
    return 2


def find_config(path: Path | None) -> Path:
    """Return the configuration to use: the given one, gateway.toml here, or the shipped, and tell of that."""
    if path is not None:
        return beside_or_shipped(Path(), path)
    here = Path("gateway.toml")
    if here.exists():
        return here
    say("no gateway.toml in this folder: the shipped bench of a crankshaft is used; another one: -c FILE")
    return shipped("gateway.toml")


def find_shipped(name: Path, folder: str, kind: str) -> Path:
    """Return a TOML file: a path, or the name of a shipped one.

    Raises:
        InputError: neither; names the shipped ones.
    """
    if name.is_file() or name.suffix == ".toml":
        return beside_or_shipped(Path(), name)
    try:
        return shipped(f"{folder}/{name}.toml")
    except InputError as error:
        known = ", ".join(_names(all_shipped(folder, ".toml")))
        raise InputError(f"no such {kind}; shipped: {known}", value=str(name)) from error


def find_scenario(name: Path) -> Path:
    """Return a scenario's file (see :func:`find_shipped`)."""
    return find_shipped(name, "scenarios", "scenario")


def _names(paths: Iterable[Path]) -> list[str]:
    return [path.stem for path in paths]


def socket_of(config: Config, memory: Path | None = None, given: Path | None = None) -> Path:
    """Return the status socket of a configuration: the given one, its own, or one beside its fault memory."""
    if given is not None:
        return given
    if config.status is not None:
        return config.status.socket
    file = memory or config.memory.path
    return file.with_name(file.name + ".status")
