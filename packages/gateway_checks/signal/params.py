"""Settings of signals, and the settings of a monitor's part for the signals of one message."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from gateway.monitors.contract import MonitorParams
from gateway_fdi.common.tomlfile import StrictModel

#: Signals of one message that one part of the monitor looks at.
MOST_SIGNALS = 11
#: Invalid codes of a signal, and values of an enumeration, at most.
MOST_CODES, MOST_VALUES = 8, 64
#: Multiplexers above one another that select a signal, and ranges of values of each that do, at most.
MOST_LEVELS, MOST_RANGES = 2, 8

Range = Annotated[
    tuple[Annotated[float, Field(allow_inf_nan=False)], Annotated[float, Field(allow_inf_nan=False)]],
    Field(description="[least, greatest]"),
]


class Stuck(StrictModel):
    """When a signal must move."""

    seconds: float | None = Field(None, gt=0, le=86400, description="time without moving that is a fault [s]")
    by: float = Field(0.0, ge=0, description="a change of no more than this is no movement, signal's unit")
    share: float | None = Field(
        None, gt=0, lt=1, description="not time alone: least share of its values in seconds that differ from the last"
    )
    during: str | None = Field(None, description='only while this signal is in within: "Message.Signal"')
    within: Range | None = Field(None, description="of during, its unit")
    inside: Range | None = Field(
        None,
        description="only while the signal itself is between these two, its unit: at the end of its range it may rest",
    )
    moving: str | None = Field(None, description='instead of time alone: while this signal moves, "Message.Signal"')
    moving_by: float | None = Field(None, gt=0, description="change of moving in which this one must move, its unit")

    @model_validator(mode="after")
    def _together(self) -> Self:
        if (self.during is None) != (self.within is None):
            raise ValueError("during and within are given together")
        if (self.moving is None) != (self.moving_by is None):
            raise ValueError("moving and moving_by are given together")
        if (self.seconds is None) == (self.moving is None):
            raise ValueError("give seconds, or moving: another signal that says when this one must")
        if self.during is not None and self.moving is not None:
            raise ValueError("give during, or moving")
        if self.share is not None and self.seconds is None:
            raise ValueError("share goes with seconds")
        if self.inside is not None and not self.inside[0] < self.inside[1]:
            raise ValueError("inside: the least value is below the greatest")
        return self


class Noise(StrictModel):
    """How much a signal may scatter around its course."""

    deviation: float = Field(gt=0, allow_inf_nan=False, description="standard deviation, signal's unit")
    samples: int = Field(20, ge=5, le=10_000, description="that it is the mean of")


class Limits(StrictModel):
    """Limits of one signal; each is a fault of its own."""

    signal: str = Field(description='"Message.Signal"')
    name: str | None = Field(None, pattern=r"^[A-Za-z0-9_-]+$", description="of it in fault ids; default: the signal's")
    code: str | None = Field(
        None,
        pattern=r"^[PCBU][0-3][0-9A-F]{3}$",
        description="base code of its DTCs; default: its own, U1xxx, U2xxx",
    )
    electrical: Range | None = Field(None, description="range that its circuit can give: beyond it, 21 and 22")
    plausible: Range | None = Field(None, description="range of the quantity: beyond it, 84 and 85")
    hysteresis: float = Field(0.0, ge=0, allow_inf_nan=False, description="inside of a limit that ends a fault")
    gradient: float | None = Field(None, gt=0, allow_inf_nan=False, description="greatest change per second: 27")
    least_step_ms: float | None = Field(
        None,
        gt=0,
        le=60_000,
        description="a change is taken over this time at least [ms]; default: the usual time between its values, so"
        " that frames that an adapter has bunched change no faster",
    )
    stuck: Stuck | None = Field(None, description="must move: 2A")
    invalid: Literal["auto"] | tuple[float | str, ...] = Field(
        "auto", description='values or texts of the database that say "no value": 86; auto: by the texts (SNA, invalid)'
    )
    undefined: bool = Field(False, description="values that the database gives no text are a fault: 81")
    all_ones: bool = Field(False, description="all its bits set is a fault: 29")
    noise: Noise | None = Field(None, description="scatter: 2F")
    missing_ms: float | None = Field(
        None, gt=0, le=3.6e6, description="of a multiplexed one: not selected for this time while its message comes: 31"
    )
    failed_ms: float = Field(500.0, gt=0, le=3.6e6, description="time that a limit must be broken [ms]")
    passed_ms: float = Field(1000.0, gt=0, le=3.6e6, description="and kept to heal [ms]")

    @model_validator(mode="after")
    def _ranges(self) -> Self:
        if self.least_step_ms is not None and self.gradient is None:
            raise ValueError("least_step_ms goes with a gradient")
        for name in ("electrical", "plausible"):
            found = getattr(self, name)
            if found is not None and not found[0] < found[1]:
                raise ValueError(f"{name}: the least value is below the greatest")
            if found is not None and 2 * self.hysteresis >= found[1] - found[0]:
                raise ValueError(f"hysteresis: less than half of {name}")
        return self


class Params(MonitorParams):
    """Signals, and the limits of each."""

    signal: tuple[Limits, ...] = Field(min_length=1, max_length=10_000)

    @model_validator(mode="after")
    def _names(self) -> Self:
        names = [limits.name or limits.signal.rpartition(".")[2] for limits in self.signal]
        for k, name in enumerate(names):
            if name in names[:k]:
                raise ValueError(f"two signals are called {name}: give one of them another name")
        return self


class Level(StrictModel):
    """A multiplexer that selects a signal.

    Attributes:
        multiplexer: "Message.Signal".
        ranges: of its value in which it does, least and greatest.
    """

    multiplexer: str
    ranges: tuple[tuple[float, float], ...]


class Watched(StrictModel):
    """One signal as a part of the monitor has it: its limits in numbers.

    Attributes:
        limits: as configured.
        name: in fault ids.
        code: base code of its DTCs.
        unit: in the database.
        codes: its invalid codes, physical values.
        values: of its enumeration, physical values; empty: not asked for.
        ones: its value with all bits set; None: not asked for.
        levels: the multiplexers that select it, the outermost first; empty: it is in every frame.
    """

    limits: Limits
    name: str
    code: str
    unit: str
    codes: tuple[float, ...]
    values: tuple[float, ...]
    ones: float | None
    levels: tuple[Level, ...] = ()


class PartParams(Params):
    """The signals of one message."""

    watched: tuple[Watched, ...] = ()

    def model_post_init(self, _context: Any) -> None:
        """Assert what the records have room for."""
        assert len(self.watched) <= MOST_SIGNALS
