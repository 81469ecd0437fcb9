"""Relations between signals, written as text."""

from gateway_checks.rule.monitor import MONITOR

__all__ = ["MONITOR"]
