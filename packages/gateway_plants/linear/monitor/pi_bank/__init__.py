"""Faults of the actuators and sensors of any linear plant, isolated by a bank of PI observers (paper 003)."""

from gateway_plants.linear.monitor.pi_bank.monitor import MONITOR

__all__ = ["MONITOR"]
