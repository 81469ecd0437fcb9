"""Hybrid powertrain: tests T1 to T4 of paper 004 with integral and with mixed causality, and T5 to T7 beyond it.

`generated` are their residual generators, written by the structural analysis of ``models/hybrid_truck.toml``; `gate` says
when the model holds, `excitation` when a fault can show, `blanking` holds back what is near a gear change, `dynamic` is what
T3 and T4 have in common, `observer` estimates what a road, a load and an engine make wrong (T7), `isolation` makes candidates
of the tests that have fired, `monitor` puts them together.
"""

from gateway.monitors.hybrid_powertrain.monitor import MONITOR

__all__ = ["MONITOR"]
