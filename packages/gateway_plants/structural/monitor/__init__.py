"""A structural model as a monitor: its residual generators run, and tell its faults apart.

`params` are a user's keys. `choice` finds the tests and has their code written, which makes a `plan`; `kept` finds it
again. `source` makes a module of it, whose kernel calls `steps`; `faults` is what it reports, `summary` what
``gateway check`` tells of it. `monitor` puts it together: each model has a monitor, with a kernel of its own.
"""

from gateway_plants.structural.monitor.monitor import FAMILY

__all__ = ["FAMILY"]
