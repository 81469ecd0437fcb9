"""Puts what was found into a configuration file; all else in it stays as it is."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import tomlkit
from tomlkit.items import AoT, Table

#: Monitor -> table of its parameters -> key -> value.
Found = Mapping[str, Mapping[str, Mapping[str, float | str]]]


def write(path: Path, found: Found, source: str) -> None:
    """Put numbers, and their origin, into the tables of a configuration's monitors.

    Args:
        path: of the configuration.
        found: to put in.
        source: their origin, for ``calibrated``.
    """
    document = tomlkit.parse(path.read_text())
    for entry in document.get("monitor", []):
        tables = found.get(str(entry.get("name")))
        if not tables:
            continue
        for key, values in tables.items():
            table = tomlkit.inline_table()
            for name, value in values.items():
                table[name] = value if isinstance(value, str) else float(f"{value:.4g}")
            entry[key] = table
        entry["calibrated"] = source
    path.write_text(tomlkit.dumps(document))


def put(entry: Any, key: str, value: Any) -> None:
    """Set a key of a table, a new one before the tables in it: after them it would belong to them."""
    if key in entry:
        entry[key] = value
        return
    below = {name: entry.pop(name) for name in list(entry) if isinstance(entry[name], AoT | Table)}
    entry[key] = _item(value)
    for name, tables in below.items():
        entry[name] = tables


def _item(value: Any) -> Any:
    """Return a value as it is written: tables in a line."""
    if isinstance(value, dict):
        table = tomlkit.inline_table()
        table.update(value)
        return table
    if isinstance(value, list) and value and isinstance(value[0], dict):
        array = tomlkit.array()
        array.extend(_item(each) for each in value)
        return array.multiline(True)
    return value


def rounded(value: Any, digits: int = 6) -> Any:
    """Return a value with this number of digits a number."""
    if isinstance(value, dict):
        return {key: rounded(v, digits) for key, v in value.items()}
    if isinstance(value, list):
        return [rounded(v, digits) for v in value]
    return float(f"{value:.{digits}g}") if isinstance(value, float) else value
