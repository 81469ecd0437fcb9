"""Parameters of the steering ECU."""

from __future__ import annotations

from itertools import pairwise
from typing import Literal, Self

from pydantic import Field, model_validator

from gateway_bench.vecu.contract import EcuParams
from gateway_fdi.filters.motor import Motor
from gateway_plants.steering.ecu.column import Column
from gateway_plants.steering.ecu.plant import Plant


class SteeringParams(EcuParams):
    """An active front steering with its ECU, the steering wheel's sensor and the car's speed."""

    type: Literal["steering"]
    name: str = "steering"
    bus: str | None = Field(None, description="name of its bus; may be left out when there is one")
    course: Literal["driving", "sweep"] = Field(
        "driving", description="driving: turns and rests, variable ratio; sweep: the study's 24 s"
    )
    speed: tuple[tuple[float, float], ...] = Field(
        ((0.0, 30.0), (10.0, 80.0)), min_length=1, description="points: [time s, speed km/h]"
    )
    ratio: tuple[tuple[float, float], ...] = Field(
        ((0.0, 10.0), (60.0, 14.0), (120.0, 18.0)),
        min_length=1,
        description="points: [speed km/h, steering wheel over road wheel]",
    )
    gear: float = Field(14.0, gt=0, description="pinion over road wheel, straight ahead")
    cubic: float = Field(0.2, ge=0, description="pinion = gear x (1 + cubic x^2) [1/rad^2]")
    period_ms: Literal[1, 2, 5] = Field(1, description="of the motor's frames [ms]")
    jitter_us: float = Field(20.0, ge=0, description="of a frame's arrival, standard dev. [us]")
    resistance: float = Field(1.0, gt=0, description="factor of the motor's at 20 degC")
    flux: float = Field(1.0, gt=0, description="factor of the motor's")
    inertia: float = Field(1.0, gt=0, description="factor of the motor's")
    celsius: float = Field(20.0, ge=-40, le=160, description="of the winding [degC]")
    dead_volts: float = Field(0.02, ge=0, description="lost to dead time in a phase [V]")
    late_voltage: tuple[float, float] | None = Field(
        None, description="[from s, to s]: voltage frames come one period late"
    )

    @property
    def summary(self) -> str:
        """What it is, for people."""
        return f"active front steering, {self.period_ms} ms"

    @property
    def plant(self) -> Plant:
        """Motor and drive; the controller believes in the nominal motor."""
        m = Motor()
        warm = 1.0 + 0.0039 * (self.celsius - 20.0)
        real = Motor(
            resistance=m.resistance * self.resistance * warm,
            flux=m.flux * self.flux,
            inertia=m.inertia * self.inertia,
        )
        return Plant(motor=real, dead=self.dead_volts)

    @property
    def column(self) -> Column:
        """Gear and sensors around the motor."""
        return Column()

    @model_validator(mode="after")
    def _points_rise(self) -> Self:
        for name, points in (("speed", self.speed), ("ratio", self.ratio)):
            if any(b[0] <= a[0] for a, b in pairwise(points)):
                raise ValueError(f"the first numbers of the points of {name} must rise")
        return self
