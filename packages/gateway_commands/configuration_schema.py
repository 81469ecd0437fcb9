"""The JSON Schema of the configuration."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from gateway.config.model import Config
from gateway.monitors.registry import MONITORS
from gateway.servers.types import SERVERS
from gateway_fdi.errors import InputError


def schema() -> dict[str, Any]:
    """Return the JSON Schema of the configuration, with every monitor's parameters."""
    document = Config.model_json_schema()
    _add(document, "MonitorConfig", MONITORS.described(), "module:NAME of a monitor that is no package")
    _add(document, "ServerConfig", SERVERS.described(), "module:NAME of a server that is no package")
    return document


def _add(document: dict[str, Any], table: str, types: Mapping[str, Any], other: str) -> None:
    """Add the parameters of each type to the schema of a table."""
    kinds = document["$defs"][table]["anyOf"] = []
    for name, found in sorted(types.items()):
        if isinstance(found, InputError):
            continue
        # Parts of two types may have one name.
        params = found.params.model_json_schema(ref_template=f"#/$defs/{name}.{{model}}")
        document["$defs"] |= {f"{name}.{part}": each for part, each in params.get("$defs", {}).items()}
        kinds.append(
            {
                "description": params.get("description", ""),
                "properties": {"type": {"const": name}, **params.get("properties", {})},
                "required": ["type", *params.get("required", [])],
            }
        )
    kinds.append({"properties": {"type": {"pattern": ":", "description": other}}})
