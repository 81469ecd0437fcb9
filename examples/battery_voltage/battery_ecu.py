"""A battery on the bus, for scenarios: its voltage over time, and a fault that lowers or raises it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import Field

from gateway.bus.frames import Frames, empty, put
from gateway.signals.database import load_database
from gateway_bench.vecu.contract import EcuFault, EcuParams, Run, Truth, VirtualEcu

PERIOD_S = 0.1


class Params(EcuParams):
    """Keys of the table ``[[ecu]]``."""

    name: str = "battery"
    volts: float = Field(12.6, description="terminal voltage [V]")
    noise: float = Field(0.02, ge=0, description="standard deviation [V]")

    @property
    def summary(self) -> str:
        """What it is, for people."""
        return f"battery of {self.volts} V"


class Fault(EcuFault):
    """Keys of the table ``[[fault]]``."""

    kind: Literal["drained", "overcharged"]
    ecu: str = "battery"
    from_s: float = Field(ge=0, description="[s]")
    to_s: float = Field(gt=0, description="[s]")
    volts: float = Field(10.5, description="terminal voltage meanwhile [V]")


def frames(params: Params, faults: Sequence[Fault], run: Run) -> tuple[Frames, list[Truth]]:
    """Return the frames of a run, stamped from time 0, and what was injected."""
    times = np.arange(0.0, run.duration_s, PERIOD_S)
    volts = np.full(len(times), params.volts)
    truth = []
    for fault in faults:
        inside = (times >= fault.from_s) & (times < fault.to_s)
        volts[inside] = fault.volts
        truth.append(Truth(round(fault.from_s * 1e9), fault.kind, int(inside.sum())))
    volts += run.rng.normal(0.0, params.noise, len(times))
    message = load_database([Path(__file__).parent / "battery.dbc"]).message("BATT")
    made = empty(len(times))
    for k, (t, value) in enumerate(zip(times, volts, strict=True)):
        data = message.encode({"Voltage": float(value)})
        put(made, k, round(t * 1e9), message.frame_id, data, bus=run.bus)
    return made, truth


ECU = VirtualEcu(type="battery", api=2, params=Params, fault=Fault, frames=frames)
