"""A DC motor with a load on the bus, for scenarios: integrated finely, not by the monitor's model."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import Field

from gateway.bus.frames import Frames, empty, put
from gateway.signals.database import load_database
from gateway_bench.vecu.contract import EcuFault, EcuParams, Run, Truth, VirtualEcu

PERIOD_S, FINE = 0.01, 50
INERTIA, CONSTANT, FRICTION = 2e-4, 0.05, 1e-4


class Params(EcuParams):
    """Keys of the table ``[[ecu]]``."""

    name: str = "motor"
    asked: float = Field(200.0, description="speed that its controller holds, rising and falling [rad/s]")
    load: float = Field(0.1, description="torque [N m]")
    noise: float = Field(1.0, ge=0, description="of the speed sensor, standard deviation [rad/s]")


class Fault(EcuFault):
    """Keys of the table ``[[fault]]``."""

    kind: Literal["stuck", "jammed"]
    ecu: str = "motor"
    from_s: float = Field(ge=0, description="[s]")
    to_s: float = Field(gt=0, description="[s]")
    load: float = Field(0.5, description="torque of a jam [N m]")


def frames(params: Params, faults: Sequence[Fault], run: Run) -> tuple[Frames, list[Truth]]:
    """Return the frames of a run, stamped from time 0, and what was injected."""
    count = int(run.duration_s / PERIOD_S)
    message = load_database([Path(__file__).parent / "motor.dbc"]).message("MOTOR")
    made = empty(count)
    speed, held, total = 0.0, None, 0.0
    for k in range(count):
        t = k * PERIOD_S
        asked = params.asked * (1.0 + 0.3 * np.sin(0.5 * t))
        total += PERIOD_S * (asked - speed)
        current = float(np.clip(0.05 * (asked - speed) + 0.2 * total, -30.0, 30.0))
        here = [fault for fault in faults if fault.from_s <= t < fault.to_s]
        load = sum(f.load for f in here if f.kind == "jammed") or params.load
        read = speed + run.rng.normal(0.0, params.noise)
        stuck = any(fault.kind == "stuck" for fault in here)
        held = (read if held is None else held) if stuck else None
        data = message.encode({"Speed": held if stuck else read, "Current": current})
        put(made, k, round(t * 1e9), message.frame_id, data, bus=run.bus)
        for _ in range(FINE):
            torque = CONSTANT * current - FRICTION * speed - load * np.sign(speed or 1.0)
            speed += PERIOD_S / FINE * torque / INERTIA
    truth = [Truth(round(f.from_s * 1e9), f.kind, round((f.to_s - f.from_s) / PERIOD_S)) for f in faults]
    return made, truth


ECU = VirtualEcu(type="motor", api=2, params=Params, fault=Fault, frames=frames)
