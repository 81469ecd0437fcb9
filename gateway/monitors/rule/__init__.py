"""Relations between signals, written as text."""

from gateway.monitors.rule.monitor import MONITOR

__all__ = ["MONITOR"]
