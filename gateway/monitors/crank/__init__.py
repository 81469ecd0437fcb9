"""Crankshaft trigger wheel: synchronisation diagnosis (paper 000)."""

from gateway.monitors.crank.monitor import MONITOR

__all__ = ["MONITOR"]
