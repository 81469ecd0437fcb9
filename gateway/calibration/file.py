"""Puts what was found into a configuration file; all else in it stays as it is."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import tomlkit

#: Monitor -> table of its parameters -> key -> value.
Found = Mapping[str, Mapping[str, Mapping[str, float]]]


def write(path: Path, found: Found, source: str) -> None:
    """Put numbers into the tables of a configuration's monitors.

    Args:
        path: of the configuration.
        found: to put in.
        source: what they come from, for ``calibrated``.
    """
    document = tomlkit.parse(path.read_text())
    for entry in document.get("monitor", []):
        tables = found.get(str(entry.get("name")))
        if not tables:
            continue
        for key, values in tables.items():
            table = tomlkit.inline_table()
            for name, value in values.items():
                table[name] = float(f"{value:.4g}")
            entry[key] = table
        entry["calibrated"] = source
    path.write_text(tomlkit.dumps(document))
