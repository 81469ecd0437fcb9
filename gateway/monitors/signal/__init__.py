"""Plausibility of any signal, by configuration: ranges, gradient, stuck, invalid codes, scatter."""

from gateway.monitors.signal.monitor import MONITOR

__all__ = ["MONITOR"]
