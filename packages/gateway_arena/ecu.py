"""Virtual ECU of the turbo engine: :mod:`gateway_arena.plants.turbo` on a random drive, sent ten times a second."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from pydantic import Field, field_validator

from gateway.bus.frames import Frames
from gateway.signals.frame_encoding import frames_of, merged
from gateway_arena.plants.turbo import FAULTS, KNOWNS, PERIOD_S, drive_of, driven, in_si
from gateway_bench.vecu.contract import EcuFault, EcuParams, Run, Truth, VirtualEcu, injected
from gateway_bench.vecu.databases import message_of
from gateway_fdi.errors import named

#: Messages of dbc/turbo.dbc, which carry the known variables by their names.
MESSAGES = ("Commands", "Temperatures", "Pressures", "Torque")


class TurboParams(EcuParams):
    """The engine."""

    type: Literal["turbo"] = "turbo"
    name: str = "turbo"
    off: float = Field(0.0, ge=0, le=0.2, description="share by which its parameters differ from the model's")


class TurboFault(EcuFault):
    """A fault of the engine."""

    kind: Literal["value"] = "value"
    ecu: str = Field("turbo", description="name of the ECU")
    name: str = Field(description=f"one of {', '.join(FAULTS)}")
    from_s: float = Field(ge=0, description="[s]")
    to_s: float | None = Field(None, gt=0, description="[s]; default: the end")
    size: float = Field(1.0, gt=0, le=3, description="in the sizes of the arena")

    @field_validator("name")
    @classmethod
    def _known(cls, name: str) -> str:
        if name not in FAULTS:
            raise ValueError(named("the faults are", name, FAULTS))
        return name


def _frames(params: TurboParams, faults: Sequence[TurboFault], run: Run) -> tuple[Frames, list[Truth]]:
    times = np.arange(int(run.duration_s / PERIOD_S)) * PERIOD_S
    sizes = np.zeros((len(times), len(FAULTS)))
    for fault in faults:
        there = (times >= fault.from_s) & (times < (np.inf if fault.to_s is None else fault.to_s))
        sizes[there, [*FAULTS].index(fault.name)] = fault.size * in_si(fault.name)
    values = dict(zip(KNOWNS, driven(run.rng, drive_of(run.rng, len(times)), sizes, params.off).T, strict=True))
    messages = [message_of("dbc/turbo.dbc", name) for name in MESSAGES]
    made = [
        frames_of(m, {s.name: values[s.name] for s in m.signals}, times * 1e9 + 1e5 * k, bus=run.bus)
        for k, m in enumerate(messages)
    ]
    return merged(*made), injected(((f.name, f.from_s, f.to_s) for f in faults), run.duration_s, PERIOD_S)


ECU = VirtualEcu(type="turbo", api=2, params=TurboParams, fault=TurboFault, frames=_frames)
