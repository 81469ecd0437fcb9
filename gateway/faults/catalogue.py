"""The catalogue of faults: the code and name of each one outside, and how it is treated."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, field, fields
from typing import Any

from gateway.faults.dtc import NO_DTC, Dtc, is_group
from gateway.faults.remedy import remedy_of
from gateway.faults.settings import CLASSES, POWER, SEVERITIES, FaultOverride
from gateway.faults.status import Rules
from gateway.monitors.contract import Debounce, Fault
from gateway_fdi.errors import InputError, InputErrors


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
        freeze_frames: records kept.
        freeze_frame_at: "failed", "pending", "confirmed", or a fault detection counter.
        spn: J1939 suspect parameter number, None: not shown there.
        fmi: J1939 failure mode identifier.
        severity: byte of ISO 14229-1, Annex D.3: severity and class.
        functional_unit: byte of ISO 14229-1.
        priority: 1 is the most important.
        emission_related: whether OBD shows it.
        readiness: monitor whose readiness it belongs to.
        lamp: which lamp its indicator is.
        permanent: whether it survives a clear until its test has passed.
        cycle: name of its operation cycle.
        healing_cycles: passed cycles that end the warning indicator.
        aging_cycle: name of the cycle that ages it.
        aging_cycles: how many of them delete it.
        caused_by: ids of the faults that may cause it.
        remedy: what to do about it, for people.
        tested: name and unit of what its test results compare with a threshold, for people; "": not said.
    """

    id: str
    dtc: Dtc
    description: str
    evidence: tuple[str, ...] = ()
    debounce: Debounce = field(default_factory=Debounce)
    confirm_cycles: int = 1
    indicator: bool = False
    freeze_frame: tuple[str, ...] = ()
    freeze_frames: int = 2
    freeze_frame_at: str | int = "failed"
    spn: int | None = None
    fmi: int | None = None
    severity: int = CLASSES["unclassified"]
    functional_unit: int = 0
    priority: int = 100
    emission_related: bool = True
    readiness: str = "components"
    lamp: str = "malfunction"
    permanent: bool = False
    cycle: str = POWER
    healing_cycles: int = 3
    aging_cycle: str = POWER
    aging_cycles: int = 40
    caused_by: tuple[str, ...] = ()
    remedy: str = ""
    tested: str = ""

    @property
    def rules(self) -> Rules:
        """Rules of its status byte."""
        return Rules(self.confirm_cycles, self.healing_cycles, self.aging_cycles, self.indicator)


#: The lamp of OBD; the others are none that legislation knows.
MIL = "malfunction"

#: Settings that a definition has as they are.
_TAKEN = {field.name for field in fields(FaultDefinition)} & FaultOverride.model_fields.keys() - {
    "dtc", "description", "remedy", "debounce", "severity", "permanent", "aging_cycle", "emission_related",
}  # fmt: skip


def _taken(settings: FaultOverride) -> dict[str, Any]:
    return {name: getattr(settings, name) for name in _TAKEN}


_NOTHING_SET = FaultOverride()
_NOTHING_TAKEN = _taken(_NOTHING_SET)


def define(
    fault_id: str,
    fault: Fault,
    override: FaultOverride | None = None,
    *,
    caused_by: tuple[str, ...] | None = None,
) -> FaultDefinition:
    """Return a fault's definition: its monitor's, with what the configuration sets.

    Args:
        fault_id: ``<monitor>.<fault>``.
        fault: as its monitor describes it.
        override: as the configuration sets it.
        caused_by: instead of what it sets.
    """
    settings = override or _NOTHING_SET
    dtc = Dtc.parse(settings.dtc or fault.dtc)
    taken = dict(_NOTHING_TAKEN) if override is None else _taken(settings)
    if caused_by is not None:
        taken["caused_by"] = caused_by
    related = dtc.is_powertrain if settings.emission_related is None else settings.emission_related
    mil = settings.indicator and settings.lamp == MIL
    return FaultDefinition(
        id=fault_id,
        dtc=dtc,
        description=settings.description or fault.description,
        remedy=settings.remedy or fault.remedy or remedy_of(dtc.value),
        evidence=fault.evidence,
        tested=fault.tested,
        debounce=fault.debounce if override is None else fault.debounce.changed(settings.debounce.asked),
        severity=SEVERITIES[settings.severity] | CLASSES[settings.dtc_class],
        emission_related=related,
        permanent=mil and related if settings.permanent is None else settings.permanent,
        aging_cycle=settings.aging_cycle or settings.cycle,
        **taken,
    )


class Catalogue:
    """The faults of a gateway, in the engine's order.

    Raises:
        InputErrors: two faults with one id, one DTC or one SPN and FMI, a code that stands for a group.
    """

    def __init__(self, definitions: Iterable[FaultDefinition]) -> None:
        self._all = tuple(definitions)
        self._by_id = {definition.id: definition for definition in self._all}
        names = Counter(definition.id for definition in self._all)
        wrong = [
            InputError("two faults have this id", key="fault", value=name)
            for name, count in names.items()
            for _ in range(count - 1)
        ]
        by_dtc: dict[Dtc, FaultDefinition] = {}
        by_spn: dict[tuple[int, int | None], FaultDefinition] = {}
        for definition in self._all:
            if definition.dtc.value == NO_DTC or is_group(definition.dtc.value):
                wrong.append(
                    InputError(
                        "this code stands for no DTC or for a group of them; take another",
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
            if definition.spn is not None:
                other = by_spn.setdefault((definition.spn, definition.fmi), definition)
                if other is not definition:
                    wrong.append(
                        InputError(
                            f"{other.id} has this SPN and FMI; give one of them another",
                            key=f'fault."{definition.id}".spn',
                            value=definition.spn,
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

    def get(self, fault: str) -> FaultDefinition | None:
        """Return the definition of a fault by its id, None if it is not in the catalogue."""
        return self._by_id.get(fault)


def as_dict(definition: FaultDefinition) -> dict[str, Any]:
    """Return a definition for JSON."""
    shown = asdict(definition)
    shown["dtc"] = str(definition.dtc)
    shown["debounce"] = {name: value for name, value in shown["debounce"].items() if value is not None}
    return shown
