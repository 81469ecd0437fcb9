"""Thresholds from healthy logs.

`logs` replays them, `stopping` finds thresholds of stopping rules for a mean time between false alarms, `cusum` nu and
J of CUSUM tests, `plants` refines models, `sensors` measures redundant sensors, `file` puts it into a configuration.
"""
