"""Parameters of redundant position sensors: their channels, what is usual, and presets for pedals."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, Self

from pydantic import Field, field_validator, model_validator

from gateway.monitors.contract import MonitorParams
from gateway.monitors.sampling import Sampling
from gateway_fdi.common.tomlfile import StrictModel
from gateway_plants.pedal.voting import supply
from gateway_plants.pedal.voting.identification.lag import COARSE_MS
from gateway_plants.pedal.voting.tracking.shape import LOST

#: Change of slope that is usual, standard deviation: travels per sample at 1 ms; it grows with the period^1.5.
BEND = 1.6e-4
#: Periods for which channels in other messages are waited for.
WAITS = 3
#: Voters by their number in the constants.
VOTERS = ("tracking", "average", "median")
#: Voters that were here before version 0.2.
STUDIED = ("predictive", "kalman", "kalman_repaired")


class Channel(StrictModel):
    """One sensor; all but the signal in the unit of the signal."""

    signal: str = Field(
        pattern=r"^([^.]+\.)?[^.]+\.[^.]+$",
        description='"Message.Signal", or "bus.Message.Signal" of another bus',
    )
    at_rest: float = Field(description="reading at 0 % of the travel")
    at_full: float = Field(description="reading at 100 %; below at_rest where the slope falls")
    low: float = Field(description="readings below: short to ground, or open")
    high: float = Field(description="readings above: short to the supply, or open")
    noise: float = Field(0.0, ge=0, description="standard deviation of a reading, from data sheet")
    resolution: float = Field(0.0, ge=0, description="least difference of two readings")
    counter: str = Field(
        "", description='frame counter in the same message, by its name; "": none, and time stamps number the samples'
    )

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.at_rest == self.at_full:
            raise ValueError("at_rest and at_full are equal: the sensor has no slope")
        if not self.low < min(self.at_rest, self.at_full):
            raise ValueError("low must lie below at_rest and at_full")
        if not self.high > max(self.at_rest, self.at_full):
            raise ValueError("high must lie above at_rest and at_full")
        return self

    @property
    def percent(self) -> float:
        """Per cent of the travel for one unit of the signal; negative where the slope falls."""
        return 100.0 / (self.at_full - self.at_rest)

    @property
    def message(self) -> str:
        """The message of the signal, with its bus if the signal names one."""
        return self.signal.rpartition(".")[0]


@dataclass(frozen=True)
class Preset:
    """What a pedal of a kind has.

    Attributes:
        channels: its sensors.
        message: that carries the voted value.
        bases: SAE J2012 base codes of channels 1 to 3, then that of all channels together.
    """

    channels: tuple[Channel, ...]
    message: str
    bases: tuple[str, str, str, str]


def _volts(signal: str, rest: float, full: float, low: float, high: float) -> Channel:
    """Return a channel with 2 mV of noise behind an ADC of 12 bits over 5 V."""
    return Channel(
        signal=signal,
        at_rest=rest,
        at_full=full,
        low=low,
        high=high,
        noise=0.002,
        resolution=5 / 4096,
        counter="FrameCnt",
    )


#: Brake: rising and falling slope; P057A is the standard's brake pedal position sensor, the further channels have
#: none there and get the manufacturer's P15xx. Accelerator: the second slope is half the first; P2120, P2125,
#: P2130 are the standard's sensors D, E, F and P2138 their correlation.
PRESETS = {
    "brake": Preset(
        (
            _volts("PED_Brake.Ch1", 0.5, 4.5, 0.25, 4.75),
            _volts("PED_Brake.Ch2", 4.5, 0.5, 0.25, 4.75),
        ),
        "GW_BrakePedal",
        ("P057A", "P157A", "P157B", "P157C"),
    ),
    "brake_3": Preset(
        (
            _volts("PED_Brake3.Ch1", 0.5, 4.5, 0.25, 4.75),
            _volts("PED_Brake3.Ch2", 4.5, 0.5, 0.25, 4.75),
            _volts("PED_Brake3.Ch3", 0.5, 4.5, 0.25, 4.75),
        ),
        "GW_BrakePedal",
        ("P057A", "P157A", "P157B", "P157C"),
    ),
    "accelerator": Preset(
        (
            _volts("PED_Accelerator.Ch1", 0.75, 3.85, 0.35, 4.65),
            _volts("PED_Accelerator.Ch2", 0.375, 1.925, 0.17, 2.35),
        ),
        "GW_AcceleratorPedal",
        ("P2120", "P2125", "P2130", "P2138"),
    ),
}


def _own(place: int, given: Any, preset: Preset) -> Any:
    """Return a channel's table with what it leaves out taken from the preset's channel at its place.

    One with a signal of its own is a sensor of its own: it has to say all.
    """
    if not isinstance(given, dict) or place >= len(preset.channels):
        return given
    usual = preset.channels[place].model_dump()
    if given.get("signal", usual["signal"]) != usual["signal"]:
        return given
    return usual | given


class Params(MonitorParams):
    """Parameters of a redundant pair or triple."""

    preset: Literal["brake", "brake_3", "accelerator"] = Field(
        "brake", description="channels, DTCs and message of a kind of pedal"
    )
    channel: tuple[Channel, ...] = Field(
        (), description="your own channels instead of the preset's, or what differs from these, in their order"
    )
    noise_mV: float | None = Field(  # noqa: N815 - unit
        None, ge=0, le=1000, description="noise of all channels of the preset [mV]"
    )
    resolution_mV: float | None = Field(  # noqa: N815
        None, ge=0, le=1000, description="resolution of all channels of the preset [mV]"
    )
    voter: Literal["tracking", "average", "median"] = Field(
        "tracking", description="what the value is; faults are always found by tracking"
    )
    period_ms: float = Field(1.0, gt=0, le=1000, description="between two samples [ms]")
    fastest: float = Field(20.0, gt=0, description="largest true speed [travels/s]")
    tolerance: float = Field(
        2.0,
        gt=0,
        le=50,
        description="slow mismatch of the channels that is usual [% of the travel]",
    )
    gain_error: float = Field(1.0, ge=0, le=50, description="difference of the channels' slopes that is usual [%]")
    overtravel: float = Field(5.0, ge=0, le=100, description="beyond 0 % and 100 % that is in range [% of the travel]")

    lag_ms: float = Field(
        10.0,
        ge=0,
        le=12.0,
        description="by which one channel may lag behind another, through a filter; how much it is, is learned [ms]",
    )
    ratiometric: bool = Field(
        True,
        description="readings are in proportion to one supply: it is told from a channel's fault where slopes differ",
    )

    calibrated: str = Field("", description="where noise, lag and mismatch come from; by gateway calibrate")

    @field_validator("voter", mode="before")
    @classmethod
    def _moved(cls, voter: Any) -> Any:
        if voter in STUDIED:
            raise ValueError("it latches, and is in the studies now: gateway evaluate pedal compares it with tracking")
        return voter

    @model_validator(mode="before")
    @classmethod
    def _as_the_preset(cls, data: Any) -> Any:
        """Complete channels that say only what differs from the preset's."""
        given = data.get("channel") if isinstance(data, dict) else None
        name = data.get("preset", cls.model_fields["preset"].default) if isinstance(data, dict) else None
        if not isinstance(given, list | tuple) or name not in PRESETS:
            return data
        return data | {"channel": [_own(k, one, PRESETS[name]) for k, one in enumerate(given)]}

    @model_validator(mode="after")
    def _volts(self) -> Self:
        presets = {channel.signal for channel in PRESETS[self.preset].channels}
        own = [channel.signal for channel in self.channel if channel.signal not in presets]
        for key in ("noise_mV", "resolution_mV"):
            if own and getattr(self, key) is not None:
                raise ValueError(f"{key} is of the preset's channels; those of {own[0]} stand in its own table")
        return self

    @property
    def messages(self) -> tuple[str, ...]:
        """The messages of the channels, each once."""
        return tuple(dict.fromkeys(channel.message for channel in self.channels))

    @property
    def sampling(self) -> Sampling:
        """How frames become samples."""
        counters = dict.fromkeys(f"{each.message}.{each.counter}" for each in self.channels if each.counter)
        by: Literal["counter", "set", "clock"] = "counter" if counters else "clock"
        if len(self.messages) > 1:
            by = "set"
        window_ms, oldest_ms = WAITS * self.period_ms, LOST * self.period_ms
        return Sampling(by, self.period_ms, window_ms, oldest_ms, tuple(counters), spare=True)

    @property
    def finds_lag(self) -> bool:
        """Whether a lag between channels is looked for."""
        return self.lag_ms > 0.0 and self.period_ms <= COARSE_MS

    @property
    def tells_supply(self) -> bool:
        """Whether the channels tell their supply from the travel."""
        rest = [channel.at_rest for channel in self.channels]
        return self.ratiometric and supply.tells(rest, [c.at_full - c.at_rest for c in self.channels])

    @property
    def channels(self) -> tuple[Channel, ...]:
        """The channels, own or preset."""
        chosen = self.channel or PRESETS[self.preset].channels
        given = {"noise": self.noise_mV, "resolution": self.resolution_mV}
        update = {key: 1e-3 * value for key, value in given.items() if value is not None}
        return tuple(channel.model_copy(update=update) for channel in chosen) if update else chosen


class PairParams(Params):
    """Parameters of a redundant pair."""

    @model_validator(mode="after")
    def _two(self) -> Self:
        if len(self.channels) != 2:
            raise ValueError(f"a redundant_pair has 2 channels, here are {len(self.channels)}")
        return self


class TripleParams(Params):
    """Parameters of a redundant triple."""

    preset: Literal["brake", "brake_3", "accelerator"] = Field(
        "brake_3", description="channels, DTCs and message of a kind of pedal"
    )

    @model_validator(mode="after")
    def _three(self) -> Self:
        if len(self.channels) != 3:
            raise ValueError(f"a redundant_triple has 3 channels, here are {len(self.channels)}")
        return self
