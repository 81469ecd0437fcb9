"""Hybrid powertrain: tests T1 to T4 of paper 004 with integral and with mixed causality.

`generated` are their residual generators, written by the structural analysis of ``models/hybrid_truck.toml``; `gate` says
when they are valid, `excitation` when a fault can show in them, `cusum` makes test quantities of residuals, `isolation`
candidates of the tests that have fired, `monitor` puts them together.
"""

from gateway.monitors.hybrid_powertrain.monitor import MONITOR

__all__ = ["MONITOR"]
