"""Signed residuals of monitors, by the components that they depend on."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from gateway.engine.depends.monitors import inputs_of, part_of
from gateway.engine.depends.parts import Network
from gateway.engine.instances import MonitorInstance
from gateway.monitors.conformance import checked_faults
from gateway.monitors.contract import Gain, LastResult, Reading, Residuals
from gateway.signals.tables import SignalRef
from gateway_fdi.diagnosis.state import Sized
from gateway_fdi.errors import InputError, nearest


@dataclass(frozen=True)
class Read:
    """Reads a fault's residual, and names components as the whole gateway does.

    Attributes:
        monitor: place of its monitor in the engine.
    """

    monitor: int
    read: Callable[[LastResult], Reading | None]
    m: MonitorInstance
    inputs: Mapping[str, SignalRef]
    network: Network

    def __call__(self, result: LastResult) -> Sized | None:
        """Return what a result says of sizes; None: nothing."""
        reading = self.read(result)
        if reading is None or not (math.isfinite(reading.residual) and reading.noise > 0.0):
            return None
        gains = {self._name(one): one.gain for one in reading.gains if math.isfinite(one.gain) and one.gain != 0.0}
        return Sized(reading.residual, reading.noise, gains, reading.gain_error, reading.beyond)

    def _name(self, one: Gain) -> str:
        return part_of(self.m, one.part, one.kind, self.inputs, self.network).name


def residuals(monitors: Sequence[MonitorInstance], network: Network) -> dict[str, Read]:
    """Return what reads the residuals of faults, by their ids.

    Raises:
        InputError: a monitor's author gives one of a fault that it does not have.
    """
    found: dict[str, Read] = {}
    for k, m in enumerate(monitors):
        capability = m.monitor.capability(Residuals)
        if capability is None:
            continue
        faults = [fault.name for fault in checked_faults(m.monitor, m.params)]
        inputs = inputs_of(m, network)
        for name, read in capability.of(m.params).items():
            if name not in faults:
                key = f'monitor type "{m.monitor.type}".Residuals.of'
                text = f"the monitor has no such fault{nearest(str(name), faults)}"
                raise InputError(text, file=m.monitor.file, key=key, value=name)
            found[f"{m.name}.{name}"] = Read(k, read, m, inputs, network)
    return found
