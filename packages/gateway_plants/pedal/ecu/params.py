"""Parameters of the pedal ECU and of its sensors' faults."""

from __future__ import annotations

from itertools import pairwise
from typing import Literal, Self

from pydantic import Field, model_validator

from gateway_bench.vecu.contract import EcuParams, TimedFault
from gateway_fdi.common.tomlfile import StrictModel


class SensorParams(StrictModel):
    """One sensor of the pedal's travel, behind an ADC."""

    signal: str = Field(description="signal of the message that carries it")
    at_rest: float = Field(description="reading at 0 % of the travel [V]")
    at_full: float = Field(description="reading at 100 % [V]")
    noise: float = Field(0.002, ge=0, description="standard deviation [V]")
    offset: float = Field(0.0, description="error of its own [V]")
    gain: float = Field(1.0, gt=0, description="error of its slope, a factor")


def _sensors(*rows: tuple[str, float, float]) -> tuple[SensorParams, ...]:
    return tuple(SensorParams(signal=s, at_rest=rest, at_full=full) for s, rest, full in rows)


#: Sensors of the messages in dbc/pedal.dbc.
SENSORS = {
    "PED_Brake": _sensors(("Ch1", 0.5, 4.5), ("Ch2", 4.5, 0.5)),
    "PED_Brake3": _sensors(("Ch1", 0.5, 4.5), ("Ch2", 4.5, 0.5), ("Ch3", 0.5, 4.5)),
    "PED_Accelerator": _sensors(("Ch1", 0.75, 3.85), ("Ch2", 0.375, 1.925)),
}


class PedalParams(EcuParams):
    """Pedal electronics that send their sensors' readings, one sample a message."""

    type: Literal["pedal"] = "pedal"
    name: str = "pedal"
    bus: str | None = Field(None, description="name of its bus; may be left out when there is one")
    message: Literal["PED_Brake", "PED_Brake3", "PED_Accelerator"] = Field(
        "PED_Brake", description="message of dbc/pedal.dbc"
    )
    sensor: tuple[SensorParams, ...] = Field((), description="instead of the usual ones")
    stroke: Literal["driving", "exponential", "ramp", "cosine", "points"] = Field(
        "driving", description="what the foot does; exponential: the paper's emergency stop"
    )
    at_s: tuple[float, ...] = Field((0.5,), description="when each stroke begins [s]")
    points: tuple[tuple[float, float], ...] = Field(
        (), description="points: [time s, travel 0..1], straight lines in between"
    )
    period_ms: float = Field(1.0, gt=0, le=1000, description="between two samples [ms]")
    jitter_us: float = Field(20.0, ge=0, description="of a frame's arrival, standard deviation [us]")
    supply: float = Field(5.0, gt=0, description="of sensors and ADC [V]")
    adc_bits: int = Field(12, ge=0, le=16, description="0: not digitised")

    @property
    def sensors(self) -> tuple[SensorParams, ...]:
        """Its sensors, own or usual."""
        return self.sensor or SENSORS[self.message]

    @property
    def summary(self) -> str:
        """What it is, for people."""
        return f"pedal with {len(self.sensors)} sensors"

    @model_validator(mode="after")
    def _points_rise(self) -> Self:
        if self.stroke == "points" and not self.points:
            raise ValueError('stroke "points" needs points')
        if any(b[0] <= a[0] for a, b in pairwise(self.points)):
            raise ValueError("the times of the points must rise")
        if any(not 0 <= travel <= 1 for _, travel in self.points):
            raise ValueError("a travel lies between 0 and 1")
        known = [sensor.signal for sensor in SENSORS[self.message]]
        for sensor in self.sensor:
            if sensor.signal not in known:
                raise ValueError(f"{self.message} has the signals {', '.join(known)}")
        return self


class SensorFault(TimedFault):
    """A fault of one sensor, or of several."""

    kind: Literal[
        "impulses",
        "stuck",
        "offset",
        "drift",
        "noise",
        "garbage",
        "short_to_ground",
        "short_to_supply",
        "open",
    ]
    ecu: str = Field("pedal", description="name of the ECU")
    channel: tuple[int, ...] = Field((1,), min_length=1, description="channels concerned, from 1")
    size: float = Field(
        0.1,
        description="of the supply: impulses: largest; offset: its size; drift: per second; noise: standard deviation",
    )
    rate: float = Field(0.15, gt=0, le=1, description="impulses: probability of a sample")
    common: bool = Field(False, description="the channels have the same error, not each its own")

    @model_validator(mode="after")
    def _channels_count(self) -> Self:
        if min(self.channel) < 1:
            raise ValueError("channels count from 1")
        return self
