"""Plausibility of any signal, by configuration: ranges, gradient, stuck, invalid codes, scatter."""

from gateway_checks.signal.monitor import MONITOR

__all__ = ["MONITOR"]
