"""Replay: logs through the monitors, faults put into them, and what the monitors compute over time."""
