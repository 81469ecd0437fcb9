"""Thresholds from healthy logs.

`logs` replays them, `stopping` finds thresholds of stopping rules for a mean time between false alarms, `cusum` nu and
J of CUSUM tests, `file` puts them into a configuration.
"""
