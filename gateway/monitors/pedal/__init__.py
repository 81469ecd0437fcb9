"""Redundant position sensors, first of all of a brake pedal (paper 002): one value out of two or three."""

from gateway.monitors.pedal.monitor import PAIR, TRIPLE

__all__ = ["PAIR", "TRIPLE"]
