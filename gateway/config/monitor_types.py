"""The type of a configured monitor, and its parameters."""

from __future__ import annotations

from typing import Any

from gateway.common.tomlfile import validate
from gateway.config.model import MonitorConfig
from gateway.errors import InputError, nearest
from gateway.monitors.contract import Monitor, MonitorParams
from gateway.monitors.registry import MONITORS


def monitor_of(entry: MonitorConfig, key: str = "") -> tuple[Monitor[Any], MonitorParams]:
    """Return the type and the parameters of a configured monitor.

    Args:
        entry: of the configuration.
        key: its key path there, for errors.

    Raises:
        InputError, InputErrors: no such type; wrong parameters.
    """
    try:
        monitor = MONITORS.get(entry.type)
        if monitor is None:
            known = sorted(MONITORS)
            text = f"the types are {', '.join(known)}{nearest(entry.type, known)}"
            raise InputError(text, value=entry.type)
    except InputError as error:
        raise InputError(
            error.message, file=error.file, key=f"{key}.type" if key else "type", value=entry.type
        ) from error
    return monitor, validate(dict(entry.model_extra or {}), monitor.params, None, key)
