"""Crankshaft trigger wheel: synchronisation diagnosis (paper 000)."""

from gateway_plants.crank.monitor.monitor import MONITOR

__all__ = ["MONITOR"]
