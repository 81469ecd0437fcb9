"""Crankshaft trigger wheel: synchronisation diagnosis (paper 000)."""

from gateway.monitors.crank_sync.monitor import MONITOR

__all__ = ["MONITOR"]
