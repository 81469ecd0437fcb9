"""Parameters of the steering monitor: motor, gear, thresholds of its symptoms."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import ClassVar, Self

from pydantic import Field, model_validator

from gateway.monitors.contract import MonitorParams
from gateway_fdi.common.tomlfile import StrictModel
from gateway_fdi.filters.motor import Motor


class MotorParams(StrictModel):
    """The motor; the defaults are assumed, nobody has published an active front steering's."""

    pole_pairs: int = Field(4, ge=1, le=64, description="z_p")
    flux: float = Field(7.5e-3, ge=1e-5, le=10.0, description="of the magnets, psi [Wb]")
    resistance: float = Field(0.06, ge=1e-5, le=1e3, description="of a phase at 20 degC [Ohm]")
    inductance: float = Field(1e-4, ge=1e-7, le=1.0, description="of a phase, along d and q [H]")
    inductance_d: float | None = Field(None, ge=1e-7, le=1.0, description="along d, where it is another [H]")
    inductance_q: float | None = Field(None, ge=1e-7, le=1.0, description="along q, where it is another [H]")
    inertia: float = Field(1.2e-4, ge=1e-7, le=10.0, description="rotor with what it drives [kg m^2]")
    friction: float = Field(5e-4, ge=0, le=10.0, description="viscous [N m s/rad]")

    @property
    def motor(self) -> Motor:
        """The motor as the filters take it."""
        return Motor(
            self.pole_pairs,
            self.flux,
            self.resistance,
            self.inductance if self.inductance_d is None else self.inductance_d,
            self.inductance if self.inductance_q is None else self.inductance_q,
            self.inertia,
            self.friction,
        )


class Thresholds(StrictModel):
    """Levels from which on symptoms alarm; ``gateway calibrate`` finds them from healthy logs."""

    jump: float | None = Field(
        None,
        gt=0,
        description="increment residual [rad]; default 0.03 at 1 ms, more with longer periods",
    )
    restless: float | None = Field(None, gt=0, description="its square, moving average [rad^2]; default 2e-4 at 1 ms")
    angle: float = Field(0.075, gt=0, description="sensor against EMF, leaky average [rad]")
    parity: float = Field(0.06, gt=0, description="CUSUM of (1) [deg at the pinion]")
    balance: float = Field(1.8, gt=0, description="voltages, in units of what parameters explain")
    surprise: float = Field(45.0, gt=0, description="normalised innovation squared, moving average")
    rate: float = Field(0.35, gt=0, description="steering wheel against its own rate [deg]")

    def at(self, period_ms: float) -> tuple[float, ...]:
        """Return all levels in their order, for a period of the motor's frames [ms].

        The filter's speed is worse with longer periods, and its error acts for longer: measured, the increment
        residual grows with about the power 0.6.
        """
        longer = period_ms**0.6
        jump = 0.03 * longer if self.jump is None else self.jump
        restless = 2e-4 * longer**2 if self.restless is None else self.restless
        return (jump, restless, self.angle, self.parity, self.balance, self.surprise, self.rate)


class Ratio(StrictModel):
    """The overall ratio that the steering controller makes, (2) to (4)."""

    speed: tuple[float, ...] = Field((0.0, 60.0, 120.0), min_length=2, description="[km/h]")
    ratio: tuple[float, ...] = Field(
        (12.0, 15.0, 18.0), min_length=2, description="i_V at these speeds, wheel over road wheel"
    )
    gear: float = Field(14.0, gt=0, description="F_SG: pinion over road wheel, straight ahead")
    cubic: float = Field(
        0.0,
        ge=0,
        description="F_SG: pinion = gear x road wheel (1 + cubic x road wheel^2) [1/rad^2]",
    )
    tolerance: float = Field(1.0, gt=0, description="of the road wheel angle [deg]")

    @model_validator(mode="after")
    def _fit(self) -> Self:
        if len(self.speed) != len(self.ratio):
            raise ValueError(f"{len(self.speed)} speeds, but {len(self.ratio)} ratios")
        if any(b <= a for a, b in pairwise(self.speed)):
            raise ValueError("the speeds must rise")
        if min(self.ratio) <= 0:
            raise ValueError("ratios are positive")
        if len(self.speed) > 8:
            raise ValueError("at most 8 speeds")
        return self


class Params(MonitorParams):
    """Parameters of the steering monitor."""

    moved: ClassVar[Mapping[str, str]] = {
        "compare": "the paper's estimators are in the study (gateway evaluate steering); leave the key out"
    }

    motor: MotorParams = MotorParams()
    period_ms: float = Field(
        1.0,
        ge=0.05,
        le=5.0,
        description="of the motor's frames; from 5 ms on the electrical time constant is missed: degraded [ms]",
    )
    motor_ratio: float = Field(20.0, gt=0, le=1e4, description="i_M, motor over pinion")
    wheel_ratio: float = Field(1.0, gt=0, le=1e4, description="i_D, steering wheel over pinion")
    wheel_delay_ms: float = Field(
        5.0, ge=0, le=30, description="age of the steering wheel's angle when its frame comes [ms]"
    )
    wheel_delay_error_ms: float = Field(
        15.0,
        ge=0,
        le=30,
        description="by which that age may be another one: it is learned when the wheel first turns [ms]",
    )
    angle_resolution: float = Field(
        0.0,
        ge=0,
        le=5.0,
        description="least step of the motor's angle sensor, mechanical; 0: it is learned, as a coarser one is [deg]",
    )
    angle_period_ms: float | None = Field(
        None,
        gt=0,
        le=50,
        description="of the frames with motor and pinion; default 2, or period_ms if longer",
    )
    wheel_period_ms: float = Field(10.0, gt=0, le=50, description="of the steering wheel's frames")
    blind: float = Field(
        0.07,
        gt=0,
        description="misfit of the angles explained by sensor steps and lash: CUSUM's drift [deg at the pinion]",
    )
    compliance: float = Field(
        0.0,
        ge=0,
        le=5.0,
        description="by which column and gear twist at the largest load: the three angles may differ by it "
        "[deg at the pinion]",
    )
    wheel_jitter_ms: float = Field(
        0.3,
        ge=0,
        le=10,
        description="by which several of its frames in a row may be late on the bus [ms]",
    )
    resistance_error: float = Field(0.35, ge=0, le=1, description="of the resistance, share")
    flux_error: float = Field(0.06, ge=0, le=1, description="of the flux, share")
    dead_volts: float = Field(0.06, ge=0, description="lost to dead time in a phase [V]")
    temperature: bool = Field(True, description="resistance follows the winding's temperature")
    slow: float = Field(15.0, ge=0, description="below this speed the angle is anchored at the sensor [rad/s]")
    ratio: Ratio | None = Field(None, description="check the road wheel angle's ratio; default: not")
    thresholds: Thresholds = Thresholds()
    calibrated: str = Field("", description="what the thresholds come from; by gateway calibrate")

    @property
    def angle_period(self) -> float:
        """Period of the frames with motor and pinion [ms]."""
        return max(2.0, self.period_ms) if self.angle_period_ms is None else self.angle_period_ms

    def frames(self, ms: float) -> int:
        """Return how many of the motor's frames a time takes [ms], one at least."""
        return max(round(ms / self.period_ms), 1)
