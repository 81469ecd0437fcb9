"""The types of monitor that a configuration can name; one that no configuration names is not imported."""

from __future__ import annotations

from typing import Any

from gateway.common.plugins import Registry
from gateway.monitors.conformance import accepted
from gateway.monitors.contract import Family, Monitor

MONITORS: Registry[Monitor[Any] | Family[Any]] = Registry("gateway.monitors", accepted)
