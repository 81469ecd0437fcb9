"""Keys of ``type = "filter"``."""

from __future__ import annotations

from typing import Annotated, Literal, NoReturn

from pydantic import Field

from gateway.monitors.contract import MonitorParams, Signal
from gateway.monitors.plain.signature import signal
from gateway.monitors.sampling import Sampling
from gateway_fdi.errors import InputError
from gateway_plants.filter.kernel import MOST, WINDOW

Code = Annotated[str, Field(pattern=r"^[PCBU][0-3][0-9A-F]{3}$")]
Test = Literal["nis", "bias", "fading"]


class Params(MonitorParams):
    """Keys of the table ``[[monitor]]``."""

    filter: str = Field(description='"module:make", a function that returns a filter of filterpy')
    z: tuple[str, ...] = Field(
        min_length=1, max_length=MOST, description='measurements, in the order of z: "Message.Signal [unit]"'
    )
    u: tuple[str, ...] = Field((), max_length=MOST, description="inputs, in the order of u, likewise")
    period_ms: float = Field(gt=0, le=3.6e6, description="between two samples [ms]")
    continuous: bool = Field(False, description="F, B and Q are of dx/dt: van Loan makes those of a period of them")
    max_age_ms: float | None = Field(
        None, gt=0, le=3.6e6, description="oldest value of several messages [ms]; default: 1.5 periods"
    )
    missing: int = Field(
        50, ge=0, le=10_000, description="samples in a row that may be missing; after more the filter begins again"
    )
    settle: int = Field(50, ge=0, le=10**6, description="samples after a beginning that are not judged")
    false_per_hour: float = Field(
        0.01, gt=0, le=3600, description="false alarms of all tests together, each has the same share [1/h]"
    )
    tests: tuple[Test, ...] = Field(
        ("nis", "bias", "fading"), min_length=1, description="of innovations; an IMMEstimator is tested by its modes"
    )
    window: int = Field(16, ge=1, le=WINDOW, description="samples whose NIS are summed up and judged at a time")
    forget: float = Field(0.95, gt=0, le=0.98, description="share that the fading memory of NIS keeps a sample")
    shift: float = Field(1.0, gt=0, le=10, description="bias that is looked for, in standard deviations")
    modes: tuple[str, ...] = Field(
        (), max_length=MOST, description="names of an IMMEstimator's filters, in order; the first one is no fault"
    )
    mode_limit: float = Field(0.95, gt=0, lt=1, description="probability above which a mode is a fault")
    codes: dict[str, Code] = Field(
        default_factory=dict, description="fault -> base code of its DTC; default: its own, U1xxx, U2xxx"
    )

    @property
    def measured(self) -> list[Signal]:
        """Signals of z."""
        return [_read("z", k, text, triggers=True) for k, text in enumerate(self.z)]

    @property
    def given_in(self) -> list[Signal]:
        """Signals of u."""
        return [_read("u", k, text, triggers=False) for k, text in enumerate(self.u)]

    @property
    def one_message(self) -> bool:
        """Whether one message carries all measurements: each of its frames is a sample."""
        return len({one.name.partition(".")[0] for one in self.measured}) == 1

    @property
    def sampling(self) -> Sampling:
        """How frames become samples."""
        age_ms = 1.5 * self.period_ms if self.max_age_ms is None else self.max_age_ms
        away_ms = (self.missing + 1.5) * self.period_ms + age_ms
        if self.one_message:
            return Sampling("clock", self.period_ms, away_ms, 2.0 * away_ms)
        return Sampling("clock", self.period_ms, away_ms, 2.0 * away_ms, between="held", age_ms=age_ms)


class PartParams(Params):
    """The same, with the codes that are given out.

    Attributes:
        given: fault -> base code of its DTC.
    """

    given: dict[str, str] = Field(default_factory=dict)


def _read(key: str, place: int, text: str, *, triggers: bool) -> Signal:
    def refuse(why: str) -> NoReturn:
        raise InputError(why, key=f"{key}[{place}]")

    found = signal(text, refuse)
    return Signal(found.name, unit=found.unit, triggers=triggers, optional=True, may_be_nan=True)
