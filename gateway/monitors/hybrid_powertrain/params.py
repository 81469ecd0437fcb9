"""Parameters of the hybrid powertrain's monitor."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from gateway.monitors.shape import MonitorParams
from gateway.tomlfile import StrictModel

#: Test quantities by their place: name, residual, condition of excitation ("" for static tests).
QUANTITIES = (
    ("T1", "T1", ""),
    ("T2", "T2", ""),
    ("T3_fixed", "T3_ICDS", "fixed"),
    ("T3_signed", "T3_ICDS", "signed"),
    ("T3_absolute", "T3_ICDS", "absolute"),
    ("T4_fixed", "T4_ICDS", "fixed"),
    ("T4_signed", "T4_ICDS", "signed"),
    ("T4_absolute", "T4_ICDS", "absolute"),
    ("T3_mixed", "T3_MCDS", "fixed"),
    ("T4_mixed", "T4_MCDS", "fixed"),
)


class Levels(StrictModel):
    """A number for each residual; what is typical of it without a fault."""

    T1: float = Field(1.40, gt=0, description="[V]")
    T2: float = Field(1.92, gt=0, description="[A]")
    T3_ICDS: float = Field(0.284, gt=0, description="[rad/s]")
    T4_ICDS: float = Field(0.284, gt=0, description="[rad/s]")
    T3_MCDS: float = Field(0.048, gt=0, description="[rad/s2], of the wheels")
    T4_MCDS: float = Field(0.048, gt=0, description="[rad/s2], of the wheels")


class Thresholds(StrictModel):
    """J of each test quantity, in units of its nu."""

    T1: float = Field(50.0, gt=0)
    T2: float = Field(85.0, gt=0)
    T3_fixed: float = Field(50.0, gt=0)
    T3_signed: float = Field(50.0, gt=0)
    T3_absolute: float = Field(50.0, gt=0)
    T4_fixed: float = Field(50.0, gt=0)
    T4_signed: float = Field(50.0, gt=0)
    T4_absolute: float = Field(50.0, gt=0)
    T3_mixed: float = Field(50.0, gt=0)
    T4_mixed: float = Field(50.0, gt=0)


class Params(MonitorParams):
    """Parameters of the hybrid powertrain's monitor."""

    system: Literal["ICDS", "MCDS"] = Field(
        "ICDS", description="T3 and T4 that decide: with integral or with mixed causality"
    )
    period_ms: float = Field(10.0, gt=0, le=100, description="of a set of four frames")
    filter_bandwidth: float = Field(0.5, gt=0, description="alpha of (20), of MCDS [rad/s]")
    after_s: float = Field(10.0, gt=0, description="t_d of (39) [s]")
    signed_charge: float = Field(4000.0, gt=0, description="J_1 of (41) [As]")
    absolute_charge: float = Field(1000.0, gt=0, description="J_2 of (45) [As]")
    least_volts: float = Field(
        20.0, gt=0, description="of the machine, below which T4 divides by too little [V]"
    )
    blank_ms: float = Field(
        200.0, ge=0, le=300, description="T2 before and behind a gear change [ms]"
    )
    nu: Levels = Levels()
    thresholds: Thresholds = Thresholds()
    limit: float = Field(
        5.0, gt=1, description="of a test quantity, in units of J: it comes down again"
    )
    parameters: dict[str, float] = Field(
        default_factory=dict, description="of the truck, instead of the structural model's"
    )
    calibrated: str = Field("", description="where nu and thresholds come from")
