"""What a user says of a monitor made from a structural model."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from gateway.monitors.accuracy import LateAccuracy, Share
from gateway.monitors.contract import MonitorParams
from gateway.monitors.sampling import KEPT, Sampling
from gateway_fdi import cusum

#: A number above 0.
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
#: Base code of a DTC.
Code = Annotated[str, Field(pattern=r"^[PCBU][0-3][0-9A-F]{3}$")]

#: Oldest value that a sample takes by the clock, if nothing is said: so many of its message's cycles; that [ms], or as
#: many periods.
CYCLES, OLDEST_MS, OLDEST_PERIODS = 2.5, 250.0, 3.0
#: Periods that can be interpolated over, at most.
MOST_BETWEEN = KEPT - 1
#: Periods behind which a counter has gone round.
ANEW = 64


class Params(MonitorParams):
    """Parameters of a monitor made from a structural model."""

    model: Path = Field(description="the model; relative to this configuration, or of those that come with the gateway")
    tests: Literal["auto", "pairs"] | tuple[str, ...] = Field(
        "auto",
        description="auto: the fewest that detect and tell apart as much as all; pairs: likewise of two faults at once,"
        " twice as many or so; or names of the model's residuals, or"
        ' "SET:EQUATION" as gateway structure lists them',
    )
    causality: Literal["integral", "mixed"] = Field(
        "integral", description="what auto prefers where it has a choice: to integrate, or to differentiate"
    )
    unseen: tuple[str, ...] = Field((), description="faults of the model that no test needs to see")
    period_ms: float = Field(10.0, gt=0, le=3.6e6, description="between two samples [ms]")
    sample: Literal["clock", "set", "counter"] = Field(
        "clock",
        description="clock: each period, of the values that there are; set: when each message has come once more;"
        " counter: of frames whose counters agree",
    )
    counters: tuple[str, ...] = Field(
        (),
        description='frame counters of the messages, "Message.Signal": they tell which samples are lost, late or'
        " overtaken (sample = set or counter)",
    )
    between: Literal["held", "interpolated"] = Field(
        "held",
        description="what a value is between two frames: held: the last one, with its age; interpolated: on the line"
        " from the last to the next, so that a sample waits for the slowest signal (sample = clock)",
    )
    max_age_ms: float | None = Field(
        None,
        gt=0,
        le=3.6e6,
        description="oldest value that a sample takes, or longest time that is interpolated over [ms]; default: 2.5 of"
        " its message's cycles, at least three periods, and at most 250 ms or that; of a set half a period, of one by"
        " counter any",
    )
    missing: int = Field(
        5,
        ge=0,
        le=10_000,
        description="samples in a row that may be missing; behind more all begins anew, without what stays away",
    )
    active: str | None = Field(
        None, min_length=1, description='the tests run while this holds, e.g. "omega > 50"; names of the model'
    )
    settle_s: float = Field(1.0, ge=0, le=3600, description="after each begin no test counts for so long [s]")
    confirm_s: float = Field(1.0, ge=0, le=3600, description="the same tests must have fired for so long [s]")
    filter_bandwidth: float = Field(
        0.5, gt=0, allow_inf_nan=False, description="of tests whose checked equation has a derivative [rad/s]"
    )
    derivative_bandwidth: float = Field(
        10.0, gt=0, allow_inf_nan=False, description="of low-passes whose slope stands for a derivative [rad/s]"
    )
    noise: dict[str, Positive] = Field(
        default_factory=dict,
        description="standard deviation of the noise of known variables, in their units; the bandwidths of a test that"
        " differentiates one of them are fitted to it, if they are not given",
    )
    parameters: dict[str, Finite] = Field(default_factory=dict, description="values instead of the model's")
    start: dict[str, Finite] = Field(default_factory=dict, description="start values of states")
    uncertain: dict[str, Share] = Field(
        default_factory=dict,
        description='by how much parameters may be off, as { R = "20 %" }: they are followed, and tests wait as long as'
        " they are not known",
    )
    sensors: dict[str, LateAccuracy] = Field(
        default_factory=dict,
        description='by how much sensors may be off, as { i = { gain = "0.5 %", bias = "0.1 A" } }; followed likewise',
    )
    drift_s: float = Field(
        1800.0, gt=0, le=1e9, description="what is uncertain changes by its whole bound within so long at least [s]"
    )
    decision: Literal["cusum", "jump"] = Field(
        "cusum",
        description="cusum: a sum of what is beyond nu; jump: likelihood ratio that the residual's mean has jumped at"
        " one of the last 32 samples, for faults that begin at once. Calibrate again behind a change",
    )
    sizes: bool = Field(True, description="estimate the size of a fault where its equation can be solved for it")
    nu: dict[str, Positive] = Field(
        default_factory=dict,
        description="of each test, what its residual is without a fault; gateway calibrate finds it",
    )
    thresholds: dict[str, Positive] = Field(
        default_factory=dict,
        description="J of each test: of cusum in units of its nu, of jump twice a logarithm of the likelihood ratio",
    )
    digests: dict[str, str] = Field(
        default_factory=dict,
        description="of each test, what nu and its threshold were found for; gateway calibrate writes it. A model or a"
        " choice of tests that has changed since is refused",
    )
    limit: float = Field(cusum.MOST, gt=1, description="of a test quantity, in units of J: it comes down again")
    codes: dict[str, Code] = Field(
        default_factory=dict, description="fault, or group -> base code of its DTC; default: its own, U1xxx, U2xxx"
    )
    calibrated: str = Field("", description="where nu and thresholds come from")

    @property
    def period_ns(self) -> int:
        """Time between two samples [ns]."""
        return round(self.period_ms * 1e6)

    @property
    def oldest_ns(self) -> int:
        """Greatest age of a value that a sample takes [ns]."""
        default = 0.5 * self.period_ms if self.sample == "set" else max(OLDEST_MS, OLDEST_PERIODS * self.period_ms)
        if self.between == "interpolated":
            default = min(default, self.most_between_ms)
        return round((default if self.max_age_ms is None else self.max_age_ms) * 1e6)

    @property
    def sampling(self) -> Sampling:
        """How frames become samples."""
        away_ms, age_ms = (self.missing + 1.5) * self.period_ms, self.oldest_ns * 1e-6
        anew_ms = max(ANEW * self.period_ms, away_ms)
        if self.sample == "clock":
            cycles = CYCLES if self.max_age_ms is None else math.inf
            return Sampling(
                "clock", self.period_ms, away_ms + age_ms, anew_ms, between=self.between, age_ms=age_ms, cycles=cycles
            )
        if self.sample == "counter":
            return Sampling("counter", self.period_ms, away_ms, anew_ms, self.counters)
        return Sampling("set", self.period_ms, away_ms, anew_ms, self.counters, age_ms=age_ms)

    @property
    def most_between_ms(self) -> float:
        """Longest time that can be interpolated over [ms]."""
        return MOST_BETWEEN * self.period_ms


class PartParams(Params):
    """The same, with what the configuration around it says.

    Attributes:
        connected: known variables of the model that have a signal.
        given: base code of each DTC.
    """

    connected: tuple[str, ...] = ()
    given: dict[str, str] = Field(default_factory=dict)
