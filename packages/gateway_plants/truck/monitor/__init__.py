"""Hybrid powertrain: tests T1 and T2 of paper 004, and T5 to T7 beyond it; the paper's T3 and T4 are in the study.

`monitor` takes the frames of `messages` set by set, with the constants and the state of `records`. `generated` are the
residual generators, written by the structural analysis of ``models/truck.toml``. `alignment` brings a set's signals to
one time, `following` finds what warmth, age and the sensors make of the parameters. `static` steps T1, T2, T5 and T6;
`blanking` holds back what is near a gear change. `motion` steps T7 while `gate` says that the model holds; `observer`
is what T7 estimates. `isolation` makes candidates of the tests that have fired, `decision` reports and sends them.
"""

from gateway_plants.truck.monitor.monitor import MONITOR

__all__ = ["MONITOR"]
