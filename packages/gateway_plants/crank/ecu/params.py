"""Parameters of the engine ECU and of its sensor's faults."""

from __future__ import annotations

from itertools import pairwise
from typing import Literal

from pydantic import Field, model_validator

from gateway_bench.vecu.contract import EcuFault, EcuParams
from gateway_fdi.common.tomlfile import StrictModel
from gateway_plants.crank.wheel import WheelText


class RippleParams(StrictModel):
    """One order of torsional ripple."""

    order: float = Field(gt=0, description="per revolution of the crank")
    amplitude: float = Field(ge=0, lt=1, description="fraction of the speed")
    phase: float = Field(0.0, description="[rad]")


class CrankParams(EcuParams):
    """An engine ECU that sends the tooth times of its crankshaft sensor."""

    type: Literal["crank"] = "crank"
    name: str = "engine"
    bus: str | None = Field(None, description="name of its bus; may be left out when there is one")
    wheel: WheelText = Field(description='trigger wheel, e.g. "60-2"')
    format: Literal["classic", "fd"] = Field("classic", description="CTW_PT4 or CTW_FD27 frames")
    speed: tuple[tuple[float, float], ...] = Field(
        min_length=1, description="breakpoints [time s, speed rpm], linear in between"
    )
    ripple: tuple[RippleParams, ...] = ()
    jitter: float = Field(0.0, ge=0, le=0.3, description="of an edge, standard deviation [pitch]")
    tooth_error: float = Field(0.0, ge=0, le=0.3, description="standard deviation [pitch]")

    cam: tuple[tuple[float, Literal[0, 1]], ...] = Field(
        (),
        description="edges of a cam sensor: [crank angle 0..720 deg from tooth 0, level after it]",
    )

    @property
    def summary(self) -> str:
        """What it is, for people."""
        return f"{self.wheel} trigger wheel"

    @model_validator(mode="after")
    def _speed_is_a_profile(self) -> CrankParams:
        times = [t for t, _ in self.speed]
        if any(b <= a for a, b in pairwise(times)) or times[0] < 0:
            raise ValueError("the times of the speed's breakpoints must rise from 0")
        if any(rpm < 0 for _, rpm in self.speed):
            raise ValueError("a speed cannot be negative")
        return self


class PulseFault(EcuFault):
    """A fault of the crankshaft sensor."""

    kind: Literal["missed_pulses", "added_pulses"]
    ecu: str = Field("engine", description="name of the ECU")
    at_s: float = Field(ge=0, description="not before this time [s]")
    count: int = Field(1, ge=1, le=20, description="pulses")
    tooth: int | None = Field(None, ge=0, description="first tooth; default: the next one")
