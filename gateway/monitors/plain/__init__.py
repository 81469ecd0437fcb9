"""Monitors of plain Python: ``from gateway.monitors.plain import Result, monitor``."""

from gateway.monitors.plain.monitor import Result, monitor

__all__ = ["Result", "monitor"]
