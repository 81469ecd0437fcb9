"""The type of a configured monitor, and its parameters."""

from __future__ import annotations

from typing import Any

from gateway.config.model import MonitorConfig
from gateway.monitors.authors import author_of
from gateway.monitors.conformance import made
from gateway.monitors.contract import Family, Monitor, MonitorParams
from gateway.monitors.registry import MONITORS
from gateway_fdi.common.tomlfile import validate
from gateway_fdi.errors import under


def monitor_of(entry: MonitorConfig, key: str = "") -> tuple[Monitor[Any], MonitorParams]:
    """Return the type and the parameters of a configured monitor.

    Args:
        entry: of the configuration.
        key: its key path there, for errors.

    Raises:
        InputError, InputErrors: no such type; wrong parameters.
    """
    monitor = MONITORS.find(entry.type, key)
    given = dict(entry.model_extra or {})
    if not isinstance(monitor, Family):
        with author_of(monitor, "params"):
            return monitor, validate(given, monitor.params, None, key)
    params: MonitorParams = validate(given, monitor.params, None, key)
    with under(key):
        return made(monitor, params, entry.folder), params
