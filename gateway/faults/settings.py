"""Settings of a fault: the tables ``[fault."..."]`` of a configuration or a catalogue file."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from gateway.faults.dtc import Dtc
from gateway_fdi.common.tomlfile import StrictModel
from gateway_fdi.errors import InputError


def _dtc_text(text: str) -> str:
    try:
        return str(Dtc.parse(text))
    except InputError as error:
        raise ValueError(error.message) from error


#: A DTC in TOML: checked, and brought into its usual form.
DtcText = Annotated[str, AfterValidator(_dtc_text)]

#: The operation cycle that lasts as long as the gateway runs.
POWER = "power"

#: Severity of a DTC (ISO 14229-1, Annex D.3): upper three bits of its byte.
SEVERITIES = {"none": 0x00, "maintenance": 0x20, "next_halt": 0x40, "immediately": 0x80}
#: Class of a DTC (global technical regulation 5, WWH-OBD): lower five bits of that byte.
CLASSES = {"unclassified": 0x01, "a": 0x02, "b1": 0x04, "b2": 0x08, "c": 0x10}

#: Monitors of which legislation wants to know whether they have run (J1979 PID 01, J1939-73 DM5).
Readiness = Literal[
    "misfire", "fuel_system", "components", "catalyst", "heated_catalyst", "evaporative_system",
    "secondary_air", "air_conditioning", "oxygen_sensor", "oxygen_sensor_heater", "egr",
]  # fmt: skip


class DebounceOverride(StrictModel):
    """How test results qualify a verdict: by their number, or by time (``failed_ms``, ``passed_ms``)."""

    failed_after: int | None = Field(None, ge=1, le=32767, description="counter that qualifies a failure")
    passed_after: int | None = Field(None, ge=1, le=32768, description="counter, below zero, that qualifies a pass")
    failed_step: int | None = Field(None, ge=1, le=32767, description="count of a failed result")
    passed_step: int | None = Field(None, ge=1, le=32767, description="count of a passed result")
    jump_up: bool | None = Field(None, description="a failed result leaves the passed side at once")
    jump_down: bool | None = Field(None, description="a passed result leaves the failed side at once")
    jump_up_to: int | None = Field(None, ge=-32768, le=32767, description="counter from which a jump up counts")
    jump_down_to: int | None = Field(None, ge=-32768, le=32767, description="counter from which a jump down counts")
    failed_ms: float | None = Field(
        None, gt=0, le=3.6e6, allow_inf_nan=False, description="time that qualifies a failure [ms]"
    )
    passed_ms: float | None = Field(
        None, gt=0, le=3.6e6, allow_inf_nan=False, description="time that qualifies a pass [ms]"
    )

    @property
    def asked(self) -> dict[str, Any]:
        """Settings that are set, by name."""
        return self.model_dump(exclude_none=True)

    @model_validator(mode="after")
    def _one_kind(self) -> Self:
        asked = self.asked
        times = {"failed_ms", "passed_ms"} & asked.keys()
        if len(times) == 1:
            raise ValueError("a debounce by time needs both failed_ms and passed_ms")
        if times and len(asked) > 2:
            others = ", ".join(sorted(asked.keys() - times))
            raise ValueError(f"a debounce is by time or by counter; take failed_ms or {others} out")
        return self


class ConditionSettings(StrictModel):
    """A signal in a range."""

    signal: str = Field(description='"Message.Signal" or "bus.Message.Signal"')
    min: float | None = Field(None, allow_inf_nan=False, description="least value, signal's unit")
    max: float | None = Field(None, allow_inf_nan=False, description="greatest value, signal's unit")
    rise: float = Field(
        0.0,
        ge=0,
        allow_inf_nan=False,
        description="and by this above its lowest value since the cycle last began"
        " (operation cycles only), signal's unit",
    )

    @model_validator(mode="after")
    def _a_range(self) -> Self:
        if self.min is None and self.max is None:
            raise ValueError("give min, max, or both")
        if self.min is not None and self.max is not None and self.min > self.max:
            raise ValueError("min is above max")
        return self


class CycleSettings(StrictModel):
    """An operation cycle: begun and ended by signals."""

    begins: ConditionSettings = Field(description="condition that begins it")
    ends: ConditionSettings = Field(description="condition that ends it")
    supplies: bool = Field(
        False,
        description="the gateway's own power goes with it, too (terminal 15): where the machine was started again, a"
        " beginning completes what a power cut left open",
    )


class FaultOverride(StrictModel):
    """Settings of one fault that differ from its monitor's."""

    dtc: DtcText | None = Field(None, description='e.g. "P0336-39"')
    description: str | None = Field(None, description="one line for people")
    remedy: str | None = Field(None, description="what to do about it, for people; default: by its failure type")
    spn: int | None = Field(None, ge=0, le=0x7FFFF, description="J1939 suspect parameter number")
    fmi: int | None = Field(None, ge=0, le=31, description="J1939 failure mode identifier")
    severity: Literal["none", "maintenance", "next_halt", "immediately"] = Field(
        "none", description="when to have it checked (ISO 14229-1, DTC severity)"
    )
    dtc_class: Literal["unclassified", "a", "b1", "b2", "c"] = Field("unclassified", description="class of WWH-OBD")
    functional_unit: int = Field(0, ge=0, le=255, description="DTC functional unit")
    priority: int = Field(100, ge=1, le=255, description="1 most important: a full memory keeps it")
    emission_related: bool | None = Field(
        None, description="shown by OBD; legislation knows it; default: if its DTC is of the powertrain (P)"
    )
    readiness: Readiness = Field("components", description="monitor whose readiness it belongs to (J1979, J1939 DM5)")
    debounce: DebounceOverride = DebounceOverride()
    enable: tuple[ConditionSettings, ...] = Field((), description="its test results count while all of these are met")
    when_disabled: Literal["freeze", "reset"] = Field(
        "freeze", description="fate of its detection counter while they are not"
    )
    caused_by: tuple[str, ...] = Field(
        (), description="faults that may cause it: while one is there, its results do not count"
    )
    cycle: str = Field(POWER, description="operation cycle of its status byte")
    confirm_cycles: int = Field(1, ge=1, le=255, description="operation cycles with a failure that confirm the DTC")
    healing_cycles: int = Field(3, ge=1, le=255, description="passed operation cycles that end the warning indicator")
    aging_cycle: str | None = Field(None, description="cycle that ages it; default: its own")
    aging_cycles: int = Field(40, ge=1, le=255, description="cycles without a failure, after healing, that delete it")
    indicator: bool = Field(False, description="a confirmed DTC asks for the warning indicator")
    lamp: Literal["malfunction", "stop", "warning", "protect"] = Field(
        "malfunction", description="which lamp the indicator is (J1939-73)"
    )
    permanent: bool | None = Field(
        None, description="survives a clear until its test has passed; default: if it is"
        " emission related and asks for the lamp malfunction"
    )  # fmt: skip
    freeze_frame: tuple[str, ...] = Field(
        (),
        description='signals ("Message.Signal", "bus.Message.Signal"), live values ("monitor:value") or names of'
        " identifiers stored at a failure",
    )
    freeze_frames: int = Field(2, ge=1, le=16, description="records kept: the first failure, then the latest ones")
    freeze_frame_at: Literal["failed", "pending", "confirmed"] | int = Field(
        "failed",
        description="event that stores a freeze frame: a status bit, or a fault detection counter 1..126",
    )

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if (self.spn is None) != (self.fmi is None):
            raise ValueError("spn and fmi are given together")
        at = self.freeze_frame_at
        if isinstance(at, int) and not 1 <= at <= 126:
            raise ValueError("freeze_frame_at: a fault detection counter before the verdict, 1..126")
        if any(condition.rise for condition in self.enable):
            raise ValueError("rise is for operation cycles, not for enable conditions")
        return self
