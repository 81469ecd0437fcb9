"""Redundant position sensors, first of all of a brake pedal (paper 002): one value out of two or three."""

from gateway_plants.pedal.monitor.monitor import PAIR, TRIPLE

__all__ = ["PAIR", "TRIPLE"]
