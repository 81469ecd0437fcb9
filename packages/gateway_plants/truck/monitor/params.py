"""Parameters of the hybrid powertrain's monitor."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import Annotated, ClassVar, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from gateway.monitors.accuracy import Accuracy, Share, Sized, SizeText, in_unit
from gateway.monitors.contract import MonitorParams
from gateway_fdi.common.tomlfile import StrictModel

#: Quantities of the CUSUM tests by their place.
QUANTITIES = ("T1", "T2", "T5", "T6")


class Levels(StrictModel):
    """A number for each residual; what is typical of it without a fault."""

    T1: float = Field(1.40, gt=0, description="[V]")
    T2: float = Field(1.94, gt=0, description="[A]")
    T5: float = Field(0.288, gt=0, description="[rad/s]")
    T6: float = Field(2.13, gt=0, description="[A]")


class Thresholds(StrictModel):
    """J of each test quantity, in units of its nu."""

    T1: float = Field(50.0, gt=0)
    T2: float = Field(80.0, gt=0)
    T5: float = Field(50.0, gt=0)
    T6: float = Field(50.0, gt=0)
    T7: float = Field(25.0, gt=0, description="Wald's statistic, which has no nu")


class Drift(StrictModel):
    """Standard deviation of what errors that the observer of T7 estimates take on within a second."""

    machine: float = Field(0.02, gt=0, description="relative, of the machine's torque")
    engine: float = Field(1e-4, gt=0, description="of the engine's")
    mass: float = Field(2.4e-4, gt=0, description="of the truck's mass")
    brake: float = Field(1e-3, gt=0, description="of the brakes' torque")


class Spread(StrictModel):
    """Standard deviation of these errors, before anything is known."""

    machine: float = Field(0.3, gt=0)
    engine: float = Field(0.05, gt=0)
    slope: float = Field(0.03, gt=0, description="of the road, which nobody measures [rad]")
    mass: float = Field(0.12, gt=0)
    brake: float = Field(0.1, gt=0)


class Observer(StrictModel):
    """Parameters of T7."""

    prior: Spread = Spread()
    drift: Drift = Drift()
    slope_way: float = Field(1000.0, gt=0, description="L, in which a road forgets its slope [m]")
    curve_way: float = Field(100.0, gt=0, description="l, in which it forgets its curve [m]")
    speed: float = Field(0.2, gt=0, description="noise of the gearbox's speed [rad/s]")
    start: float = Field(0.03, gt=0, description="error of the wheels' speed at the start [rad/s]")
    torque: float = Field(1e-3, gt=0, description="noise of the acceleration [rad/s2 sqrt(s)]")
    own: float = Field(0.05, gt=0, description="what the model may make of the machine's errors")


class Slow(StrictModel):
    """What warmth and age may change, of one parameter."""

    low: float = Field(gt=-0.9, le=0, description="largest relative error below what is told")
    high: float = Field(ge=0, description="likewise above")
    rate: float = Field(gt=0, description="that it changes by in a second of use [1/s]")


class Table(StrictModel):
    """A function through points, instead of the structural model's."""

    x: tuple[float, ...] = Field(min_length=2, description="rising; of the gears: 1, 2, ..")
    y: tuple[float, ...] = Field(min_length=2, description="as many")

    @model_validator(mode="after")
    def _is_a_function(self) -> Self:
        if len(self.x) != len(self.y):
            raise ValueError(f"{len(self.x)} x for {len(self.y)} y")
        if any(b <= a for a, b in pairwise(self.x)):
            raise ValueError("x must rise")
        return self


class Following(StrictModel):
    """Parameters that are followed within bounds (monitors/truck/following.py has their sources)."""

    resistance: Slow = Field(
        Slow(low=-0.45, high=0.6, rate=2e-3), description="of the winding: copper, -30 to 150 degC around 20 to 60 degC"
    )
    torque_constant: Slow = Field(Slow(low=-0.035, high=0.035, rate=1e-4), description="magnets, some 30 K")
    battery_resistance: Slow = Field(Slow(low=-0.5, high=1.0, rate=5e-4), description="cold, age")
    open_circuit_voltage: Slow = Field(Slow(low=-0.025, high=0.025, rate=5e-5), description="age, error of the curve")
    voltage_noise: float = Field(1.0, gt=0, description="of what e8 leaves, at the machine, beside the speed's [V]")
    power_noise: float = Field(400.0, gt=0, description="of what e11 leaves [W]")
    lag_ms: float = Field(
        30.0,
        ge=0,
        le=400,
        description="by which the electric sensors may be late, or early, behind what is asked for: found from the"
        " voltages; at most 4 periods; 0: they are not [ms]",
    )


#: A sensor's gain: what is followed is followed to first order.
Gain = Annotated[Share, Field(lt=0.2, description='of its reading, as "0.5 %"')]


class Voltmeter(Accuracy):
    """Accuracy of a voltage sensor, of its data sheet: largest errors over warmth and life."""

    gain: Gain = 0.005
    bias: Annotated[SizeText, AfterValidator(in_unit("V"))] = Field(Sized(0.5, "V"), description='as "0.5 V"')


class Ammeter(Accuracy):
    """Likewise of a current sensor."""

    gain: Gain = 0.005
    bias: Annotated[SizeText, AfterValidator(in_unit("A"))] = Field(Sized(1.0, "A"), description='as "1 A"')


class Sensors(StrictModel):
    """Accuracy of the electric sensors: what is within it is followed, and is no fault."""

    U_em: Voltmeter = Field(Voltmeter(), description="voltage of the machine")
    I_em: Ammeter = Field(Ammeter(), description="current of the machine")
    I_b: Ammeter = Field(Ammeter(), description="current of the battery")
    over_s: float = Field(1000.0, gt=0, description="in which an error may come up, of use [s]")


class Params(MonitorParams):
    """Parameters of the hybrid powertrain's monitor."""

    moved: ClassVar[Mapping[str, str]] = dict.fromkeys(
        ("system", "filter_bandwidth", "after_s", "signed_charge", "absolute_charge"),
        "the paper's systems, with T3 and T4, are in the study (gateway evaluate truck); leave the key out",
    )

    period_ms: float = Field(10.0, gt=0, le=100, description="of a set of four frames")
    least_volts: float = Field(20.0, gt=0, description="of the machine, below which T1 shows no inverter fault [V]")
    least_amps: float = Field(20.0, ge=0, description="of the machine, below which no fault shows in T2, T5 and T6 [A]")
    blank_ms: float = Field(200.0, ge=0, le=300, description="T2 before and behind a gear change [ms]")
    nu: Levels = Levels()
    thresholds: Thresholds = Thresholds()
    observer: Observer = Observer()
    follow: Following | Literal[False] = Field(
        Following(), description="warmth and age of machine and battery, within bounds; false: not"
    )
    sensors: Sensors = Sensors()
    settle_s: float = Field(
        0.5,
        ge=0,
        description="use of the machine without a further test on its way, before a fault is named [s]",
    )
    limit: float = Field(5.0, gt=1, description="of a test quantity, in units of J: it comes down again")
    parameters: dict[str, float] = Field(
        default_factory=dict, description="of the truck, instead of the structural model's"
    )

    tables: dict[Literal["f_1", "f_2", "f_3"], Table] = Field(
        default_factory=dict,
        description="of the truck, instead of the structural model's: f_1 open circuit voltage [V] over charge, "
        "f_2 inertia of the gearbox [kg m2] over gear, f_3 its ratio over gear",
    )
    calibrated: str = Field("", description="where nu and thresholds come from")
