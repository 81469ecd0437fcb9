"""The JSON Schema of the configuration."""

from __future__ import annotations

from typing import Any

from gateway.config.model import Config
from gateway.monitors.registry import MONITORS
from gateway_fdi.errors import InputError


def schema() -> dict[str, Any]:
    """Return the JSON Schema of the configuration, with every monitor's parameters."""
    document = Config.model_json_schema()
    kinds = document["$defs"]["MonitorConfig"]["anyOf"] = []
    for name, monitor in sorted(MONITORS.described().items()):
        if isinstance(monitor, InputError):
            continue
        # Parts of two monitors may have one name.
        params = monitor.params.model_json_schema(ref_template=f"#/$defs/{name}.{{model}}")
        document["$defs"] |= {f"{name}.{part}": found for part, found in params.get("$defs", {}).items()}
        kinds.append(
            {
                "description": params.get("description", ""),
                "properties": {"type": {"const": name}, **params.get("properties", {})},
                "required": ["type", *params.get("required", [])],
            }
        )
    kinds.append(
        {"properties": {"type": {"pattern": ":", "description": "module:NAME of a monitor that is no package"}}}
    )
    return document
