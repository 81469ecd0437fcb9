"""Parameters of the hybrid truck's ECU, and of its faults."""

from __future__ import annotations

from typing import Literal, Self

from pydantic import Field, model_validator

from gateway_bench.vecu.contract import EcuParams, TimedFault
from gateway_fdi.common.tomlfile import StrictModel
from gateway_plants.truck.ecu.plant import Disturbance

#: Table II of paper 004: field of the plant, size.
_SIZES: dict[str, tuple[str, float]] = {
    "battery_short": ("b_sc", -0.5),
    "inverter_voltage": ("pe", -0.5),
    "machine_efficiency": ("em_eta", -0.5),
    "machine_resistance": ("em_R", -0.5),
    "machine_voltage_sensor": ("em_U_sens", 20.0),
}


class SensorNoise(StrictModel):
    """White noise of the five sensors, standard deviation at 100 Hz."""

    battery_current: float = Field(1.0, ge=0, description="[A]")
    machine_voltage: float = Field(1.0, ge=0, description="[V]")
    machine_current: float = Field(1.5, ge=0, description="[A]")
    engine_speed: float = Field(0.5, ge=0, description="[rad/s]")
    gearbox_speed: float = Field(0.2, ge=0, description="[rad/s]")


class TruckParams(EcuParams):
    """A parallel hybrid truck on a driving cycle."""

    type: Literal["truck"]
    name: str = "truck"
    bus: str | None = Field(None, description="name of its bus; may be left out when there is one")
    cycle: Literal["udds", "ftp75"] = Field("ftp75", description="FTP75 without its soak: 1874 s")
    start_s: float = Field(0.0, ge=0, description="second of the cycle at which it begins")
    charge: float = Field(0.5, ge=0, le=1, description="of the battery at the begin")
    noise: SensorNoise = SensorNoise()
    noise_factor: float = Field(1.0, ge=0, description="of all noise")
    mass: float = Field(1.0, gt=0, description="of the truck, relative to its model's 20 t")
    slope: float = Field(0.0, gt=-0.1, lt=0.1, description="of the road that nobody measures")
    hills: float = Field(0.0, ge=0, lt=0.1, description="amplitude of a slope that comes and goes over 600 m")
    wind: float = Field(0.0, gt=-40, lt=40, description="against it [m/s]")
    engine: float = Field(1.0, gt=0, description="torque of the engine, relative")
    brake: float = Field(1.0, gt=0, description="torque of the brakes, relative")
    drag: float = Field(1.0, gt=0, description="air drag, relative")
    jitter_us: float = Field(20.0, ge=0, description="of a frame's arrival, standard deviation [us]")

    @property
    def disturbance(self) -> Disturbance:
        """How the truck differs from its model."""
        return Disturbance(self.mass, self.slope, self.hills, self.wind, self.engine, self.brake, self.drag)

    @property
    def summary(self) -> str:
        """What it is, for people."""
        return f"hybrid truck on {self.cycle.upper()} from {self.start_s:g} s"


class TruckFault(TimedFault):
    """A fault of the battery, the power electronics, the machine or its voltage sensor, (13)."""

    kind: Literal[
        "battery_short",
        "inverter_voltage",
        "machine_efficiency",
        "machine_resistance",
        "machine_voltage_sensor",
    ]
    ecu: str = Field("truck", description="name of the ECU")
    size: float | None = Field(None, description="relative, of the sensor [V]; default: that of Table II")

    @property
    def field(self) -> str:
        """The plant's name of it."""
        return _SIZES[self.kind][0]

    @property
    def amount(self) -> float:
        """Its size."""
        return _SIZES[self.kind][1] if self.size is None else self.size

    @model_validator(mode="after")
    def _possible(self) -> Self:
        if self.size is not None and self.kind != "machine_voltage_sensor" and self.size <= -1.0:
            raise ValueError("a relative fault is more than -1")
        return self
