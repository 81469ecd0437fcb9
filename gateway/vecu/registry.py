"""The types of virtual ECU that a scenario can name; one that no scenario names is not imported."""

from __future__ import annotations

from typing import Any

from gateway.plugins import Registry
from gateway.vecu.contract import VirtualEcu, accepted

VIRTUAL_ECUS: Registry[VirtualEcu[Any, Any]] = Registry("gateway.vecu", accepted)
