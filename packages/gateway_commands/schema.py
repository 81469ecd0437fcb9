"""``gateway schema``: the JSON Schemas of the files that people write, for their editors (docs/editors.md)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from gateway.cli.present import print_json, say
from gateway.common.calls import CALLS
from gateway.common.jsonlines import line
from gateway_commands.configuration_schema import schema as configuration
from gateway_fdi.errors import InputError, nearest
from gateway_fdi.structure.file import ModelFile


def schemas() -> dict[str, dict[str, Any]]:
    """Return the schemas of this installation with its plug-ins, by the kind of file."""
    found = {"gateway": configuration(), "model": ModelFile.model_json_schema()}
    if "scenario_schema" in CALLS:
        found["scenario"] = CALLS["scenario_schema"]()
    return {kind: {"$schema": "https://json-schema.org/draft/2020-12/schema", **one} for kind, one in found.items()}


def schema(kind: str, out: Path | None) -> int:
    """Print the schema of a kind of file, or write all; returns the exit code.

    Raises:
        InputError: there is no such kind.
    """
    found = schemas()
    if kind not in found:
        raise InputError(f"there are {', '.join(found)}{nearest(kind, found)}", key="KIND", value=kind)
    if out is None:
        print_json(found[kind], indent=2)
        return 0
    files = [out / f"{name}.schema.json" for name in found]
    for file, one in zip(files, found.values(), strict=True):
        file.write_text(f"{line(one)}\n", encoding="utf-8")
    say(f"{', '.join(map(str, files))}: files that begin with '#:schema gateway.schema.json' are checked as you type")
    return 0
