"""A test drive as a TOML file: virtual ECUs, faults with their times, the DTCs expected."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Literal

from pydantic import (
    Field,
    model_validator,
)

from gateway.faults.catalogue import DtcText
from gateway.fdi.wheel import WheelText
from gateway.tomlfile import StrictModel, load


class RippleParams(StrictModel):
    """One order of torsional ripple."""

    order: float = Field(gt=0, description="per revolution of the crank")
    amplitude: float = Field(ge=0, lt=1, description="fraction of the speed")
    phase: float = Field(0.0, description="[rad]")


class EngineParams(StrictModel):
    """An engine ECU that sends the tooth times of its crankshaft sensor."""

    type: Literal["engine"] = "engine"
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

    @model_validator(mode="after")
    def _speed_is_a_profile(self) -> EngineParams:
        times = [t for t, _ in self.speed]
        if any(b <= a for a, b in pairwise(times)) or times[0] < 0:
            raise ValueError("the times of the speed's breakpoints must rise from 0")
        if any(rpm < 0 for _, rpm in self.speed):
            raise ValueError("a speed cannot be negative")
        return self


class PulseFault(StrictModel):
    """A fault of the crankshaft sensor."""

    kind: Literal["missed_pulses", "added_pulses"]
    ecu: str = Field("engine", description="name of the ECU")
    at_s: float = Field(ge=0, description="not before this time [s]")
    count: int = Field(1, ge=1, le=20, description="pulses")
    tooth: int | None = Field(None, ge=0, description="first tooth; default: the next one")


class WireFault(StrictModel):
    """A fault between an ECU and the gateway."""

    kind: Literal["lost", "corrupted", "late", "duplicated", "short", "silent"]
    message: str = Field("*", description="identifier in hex (0x700), or * for all")
    from_s: float = Field(0.0, ge=0, description="[s]")
    to_s: float | None = Field(None, description="[s]; default: the end")
    probability: float = Field(1.0, gt=0, le=1, description="that a frame is concerned")
    delay_ms: float = Field(30.0, gt=0, description="of a late frame [ms]")

    @property
    def can_id(self) -> int | None:
        """The identifier concerned, None for all."""
        return None if self.message == "*" else int(self.message, 16)

    @model_validator(mode="after")
    def _message_is_an_identifier(self) -> WireFault:
        try:
            _ = self.can_id
        except ValueError:
            raise ValueError('message is an identifier in hex ("0x700") or "*"') from None
        if self.to_s is not None and self.to_s <= self.from_s:
            raise ValueError("to_s must lie after from_s")
        return self


class Expectation(StrictModel):
    """A DTC that the drive must cause, or must not."""

    dtc: DtcText
    after_s: float = Field(0.0, ge=0, description="not set before [s]")
    by_s: float | None = Field(None, gt=0, description="set not later than [s]; default: the end")
    healed_by_s: float | None = Field(None, gt=0, description="testFailed gone again by [s]")
    absent: bool = Field(False, description="must never be set")


class Scenario(StrictModel):
    """A test drive."""

    name: str
    description: str = ""
    duration_s: float = Field(gt=0, le=86400, description="[s]")
    seed: int = Field(1, ge=0)
    config: Path = Field(Path("../gateway.toml"), description="relative to the scenario")
    ecu: tuple[EngineParams, ...] = Field(min_length=1)
    fault: tuple[PulseFault, ...] = ()
    wire: tuple[WireFault, ...] = ()
    expect: tuple[Expectation, ...] = ()
    unexpected: Literal["fail", "allow"] = Field("fail", description="DTCs that no line expects")

    @model_validator(mode="after")
    def _names_fit(self) -> Scenario:
        names = [ecu.name for ecu in self.ecu]
        if len(set(names)) != len(names):
            raise ValueError(f"two ECUs share a name: {', '.join(names)}")
        for fault in self.fault:
            if fault.ecu not in names:
                raise ValueError(f"no ECU {fault.ecu!r}; there are {', '.join(names)}")
        return self


def load_scenario(path: Path) -> Scenario:
    """Read a scenario; its configuration's path becomes relative to the scenario's folder.

    Raises:
        InputError, InputErrors: the file cannot be read, or a key is wrong.
    """
    scenario = load(path, Scenario)
    return scenario.model_copy(update={"config": path.parent / scenario.config})
