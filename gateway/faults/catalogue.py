"""The catalogue of faults: what each one is called outside, and how it is treated."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Annotated

from pydantic import AfterValidator, Field

from gateway.errors import InputError, InputErrors
from gateway.faults.dtc import ALL_DTCS, NO_DTC, Dtc
from gateway.monitors.shape import Debounce, Fault
from gateway.tomlfile import StrictModel


def _dtc_text(text: str) -> str:
    try:
        return str(Dtc.parse(text))
    except InputError as error:
        raise ValueError(error.message) from error


#: A DTC in TOML: checked, and brought into its usual form.
DtcText = Annotated[str, AfterValidator(_dtc_text)]


class DebounceOverride(StrictModel):
    """Counter debounce: how many results in a row qualify a verdict."""

    failed_after: int | None = Field(None, ge=1, le=32767, description="failed results")
    passed_after: int | None = Field(None, ge=1, le=32767, description="passed results")
    jump_up: bool | None = Field(None, description="a failed result leaves the passed side at once")
    jump_down: bool | None = Field(
        None, description="a passed result leaves the failed side at once"
    )


class FaultOverride(StrictModel):
    """Settings of one fault that differ from its monitor's."""

    dtc: DtcText | None = Field(None, description='e.g. "P0336-29"')
    debounce: DebounceOverride = DebounceOverride()
    confirm_cycles: int = Field(
        1, ge=1, le=255, description="operation cycles with a failure that confirm the DTC"
    )
    indicator: bool = Field(False, description="a confirmed DTC asks for the warning indicator")
    freeze_frame: tuple[str, ...] = Field(
        (), description='signals stored at a failure: "Message.Signal" or "bus.Message.Signal"'
    )


@dataclass(frozen=True)
class FaultDefinition:
    """One fault as the memory knows it.

    Attributes:
        id: ``<monitor>.<fault>``.
        dtc: its code.
        description: one line for people.
        evidence: names of the evidence values of its test results.
        debounce: how its test results are counted.
        confirm_cycles: operation cycles with a failure that confirm it.
        indicator: whether it asks for the warning indicator.
        freeze_frame: names of the signals stored at a failure.
    """

    id: str
    dtc: Dtc
    description: str
    evidence: tuple[str, ...] = ()
    debounce: Debounce = field(default_factory=Debounce)
    confirm_cycles: int = 1
    indicator: bool = False
    freeze_frame: tuple[str, ...] = ()


def debounce_of(fault: Fault, override: FaultOverride | None) -> Debounce:
    """Return a fault's debounce: its monitor's, with what the configuration sets."""
    if override is None:
        return fault.debounce
    base = fault.debounce
    asked = override.debounce.model_dump(exclude_none=True)
    return Debounce(
        **{
            "failed_after": base.failed_after,
            "passed_after": base.passed_after,
            "jump_up": base.jump_up,
            "jump_down": base.jump_down,
            **asked,
        }
    )


def define(fault_id: str, fault: Fault, override: FaultOverride | None = None) -> FaultDefinition:
    """Return a fault's definition: its monitor's, with what the configuration sets."""
    settings = override or FaultOverride()
    return FaultDefinition(
        fault_id,
        Dtc.parse(settings.dtc or fault.dtc),
        fault.description,
        fault.evidence,
        debounce_of(fault, override),
        settings.confirm_cycles,
        settings.indicator,
        settings.freeze_frame,
    )


class Catalogue:
    """The faults of a gateway, in the engine's order.

    Raises:
        InputErrors: two faults with one id or one DTC, or a code that stands for none or all DTCs.
    """

    def __init__(self, definitions: Iterable[FaultDefinition]) -> None:
        self._all = tuple(definitions)
        by_dtc: dict[Dtc, FaultDefinition] = {}
        ids: set[str] = set()
        wrong = []
        for definition in self._all:
            if definition.id in ids:
                wrong.append(
                    InputError("two faults have this id", key="fault", value=definition.id)
                )
            ids.add(definition.id)
            if definition.dtc.value in (NO_DTC, ALL_DTCS):
                wrong.append(
                    InputError(
                        "this code stands for no DTC or for all of them; take another",
                        key=f'fault."{definition.id}".dtc',
                        value=str(definition.dtc),
                    )
                )
            other = by_dtc.setdefault(definition.dtc, definition)
            if other is not definition:
                wrong.append(
                    InputError(
                        f"{other.id} has this DTC; give one of them another",
                        key=f'fault."{definition.id}".dtc',
                        value=str(definition.dtc),
                    )
                )
        if wrong:
            raise InputErrors(wrong)

    def __iter__(self) -> Iterator[FaultDefinition]:
        return iter(self._all)

    def __len__(self) -> int:
        return len(self._all)

    def __getitem__(self, index: int) -> FaultDefinition:
        return self._all[index]
