"""The JSON Schema of the configuration."""

from __future__ import annotations

from typing import Any

from gateway.config.model import Config
from gateway.monitors.registry import MONITORS
from gateway_fdi.errors import InputError


def schema() -> dict[str, Any]:
    """Return the JSON Schema of the configuration, with every monitor's parameters."""
    document = Config.model_json_schema()
    document["$defs"]["MonitorConfig"]["anyOf"] = [
        {
            "properties": {
                "type": {"const": name},
                **monitor.params.model_json_schema().get("properties", {}),
            }
        }
        for name, monitor in sorted(MONITORS.described().items())
        if not isinstance(monitor, InputError)
    ]
    return document
