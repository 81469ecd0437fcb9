"""Keys of ``type = "method"``."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from gateway.monitors.contract import MonitorParams
from gateway.monitors.sampling import Sampling
from gateway_arena.contract import SETTLE

Code = Annotated[str, Field(pattern=r"^[PCBU][0-3][0-9A-F]{3}$")]

#: Room for inputs, and for faults that have a name.
MOST_INPUTS, MOST_FAULTS = 52, 64


class Params(MonitorParams):
    """Keys of the table ``[[monitor]]``."""

    method: str = Field(description='a method of the arena by its name (pca, svm, forest), or "FILE.py:CLASS"')
    inputs: tuple[str, ...] = Field(
        min_length=1, max_length=MOST_INPUTS, description='"Message.Signal" of each value of a sample, in their order'
    )
    fitted: str = Field(description="file that gateway fit writes, beside the configuration")
    faults: tuple[str, ...] = Field(
        (), max_length=MOST_FAULTS, description="faults that the method can name, beside the one that has no name"
    )
    period_ms: float = Field(gt=0, le=3.6e6, description="between two samples [ms]")
    max_age_ms: float | None = Field(
        None, gt=0, le=3.6e6, description="oldest value that a sample takes [ms]; default: 3 periods"
    )
    missing: int = Field(
        5, ge=0, le=10_000, description="samples in a row that may be missing; after more the method begins again"
    )
    settle: int = Field(SETTLE, ge=0, le=10**6, description="samples after a beginning that are not judged")
    threshold: float | None = Field(
        None, allow_inf_nan=False, description="score above which it alarms; default: of the fitted file"
    )
    codes: dict[str, Code] = Field(
        default_factory=dict, description="fault, or abnormal -> base code of its DTC; default: its own, U1xxx, U2xxx"
    )

    @property
    def sampling(self) -> Sampling:
        """How frames become samples."""
        age_ms = 3.0 * self.period_ms if self.max_age_ms is None else self.max_age_ms
        away_ms = (self.missing + 1.5) * self.period_ms + age_ms
        return Sampling("clock", self.period_ms, away_ms, 2.0 * away_ms, between="held", age_ms=age_ms)


class PartParams(Params):
    """The same, with the codes that are given out.

    Attributes:
        given: fault -> base code of its DTC.
    """

    given: dict[str, str] = Field(default_factory=dict)
