"""A test drive as a TOML file: virtual ECUs, faults with their times, the DTCs expected."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Literal, TypeVar, get_args

from pydantic import Field, SerializeAsAny, model_validator

from gateway.common.trust import beside
from gateway.faults.settings import DtcText
from gateway_bench.vecu.contract import EcuFault, EcuParams, VirtualEcu
from gateway_bench.vecu.message_faults import KINDS, MessageFault
from gateway_bench.vecu.registry import RENAMED, VIRTUAL_ECUS
from gateway_fdi.common.log import get_logger
from gateway_fdi.common.resources import beside_or_shipped
from gateway_fdi.common.tomlfile import StrictModel, load, validate
from gateway_fdi.errors import InputError, InputErrors, nearest, under

T = TypeVar("T")

_log = get_logger(__name__)

#: Type of an ECU that names none.
_DEFAULT = "crank"
#: Name of the ECU that a fault of any ECU is of, where it names none and there are several.
_REST = "restbus"


def _of_type(type_: str, key: str) -> VirtualEcu[Any, Any]:
    """Return a type of virtual ECU.

    Raises:
        InputError: there is none.
    """
    with under(f"{key}.type", type_):
        found = VIRTUAL_ECUS.get(type_)
        if found is None:
            known = list(VIRTUAL_ECUS)
            raise InputError(f"there are {', '.join(known)}{nearest(type_, known)}", value=type_)
    return found


def _ecu(entry: Any, key: str) -> EcuParams:
    """Return an ECU of a scenario.

    Raises:
        InputError, InputErrors: no such type; wrong parameters.
    """
    if isinstance(entry, EcuParams):
        return entry
    type_ = str(entry.get("type", _DEFAULT))
    if type_ in RENAMED:
        _log.warning("renamed", key=f"{key}.type", value=type_, now=RENAMED[type_])
        type_ = RENAMED[type_]
    found: EcuParams = validate({**entry, "type": type_}, _of_type(type_, key).params, None, key)
    return found


def _kinds(ecu: EcuParams) -> list[str]:
    """Return the kinds of fault that an ECU can have."""
    model = _of_type(ecu.type, "ecu").fault
    if model is None:
        return []
    return [str(kind) for kind in get_args(model.model_fields["kind"].annotation)]


def _fault(entry: Any, ecus: Sequence[EcuParams], key: str) -> EcuFault:
    """Return a fault of a scenario.

    Raises:
        InputError, InputErrors: no such ECU, no such kind; wrong parameters.
    """
    if isinstance(entry, EcuFault):
        return entry
    kind, name = entry.get("kind"), entry.get("ecu")
    having = [ecu for ecu in ecus if kind in _kinds(ecu)]
    named = [ecu for ecu in ecus if ecu.name == name]
    ecu = (named or having or list(ecus))[0]
    model, kinds = _of_type(ecu.type, key).fault, _kinds(ecu)
    if kind in KINDS and kind not in kinds:  # one that every ECU can have
        names = [each.name for each in ecus]
        if name is None and len(ecus) > 1 and _REST not in names:
            raise InputError(f"of which ECU? There are {', '.join(names)}", key=f"{key}.ecu")
        whose = _REST if name is None and _REST in names else ecu.name
        return validate({"ecu": whose, **entry}, MessageFault, None, key)
    if model is None or kind not in kinds:
        known = list(dict.fromkeys([*kinds, *KINDS]))
        text = f"there are {', '.join(known)}{nearest(str(kind), known)}"
        text += f"; ECU {ecu.name!r} is of type {ecu.type}: it has no {kind}"
        raise InputError(text, key=f"{key}.kind", value=kind)
    only = {"ecu": ecu.name} if len(ecus) == 1 else {}
    found: EcuFault = validate({**only, **entry}, model, None, key)
    return found


class WireFault(StrictModel):
    """A fault between an ECU and the gateway."""

    kind: Literal["lost", "corrupted", "late", "duplicated", "short", "silent", "bus_off"]
    bus: str | None = Field(None, description="name of the bus; bus_off: whose controller is off; default: any")
    message: str = Field(
        "*",
        description="name of a message of the configuration, identifier in hex (0x700), or * for all",
    )
    from_s: float = Field(0.0, ge=0, description="[s]")
    to_s: float | None = Field(None, description="[s]; default: the end")
    probability: float = Field(1.0, gt=0, le=1, description="that a frame is concerned")
    delay_ms: float = Field(30.0, gt=0, description="of a late frame [ms]")

    @model_validator(mode="after")
    def _times(self) -> WireFault:
        if self.to_s is not None and self.to_s <= self.from_s:
            raise ValueError("to_s must lie after from_s")
        return self


class Expectation(StrictModel):
    """A DTC that the drive must cause, or must not."""

    dtc: DtcText
    after_s: float = Field(0.0, ge=0, description="not set before [s]")
    by_s: float | None = Field(None, gt=0, description="set not later than [s]; default: the end")
    healed_by_s: float | None = Field(None, gt=0, description="testFailed gone again by [s]")
    absent: bool = Field(False, description="must never be set")


class Scenario(StrictModel):
    """A test drive."""

    name: str
    description: str = ""
    duration_s: float = Field(gt=0, le=86400, description="[s]")
    seed: int = Field(1, ge=0)
    config: Path = Field(Path("../gateway.toml"), description="relative to the scenario")
    ecu: tuple[SerializeAsAny[EcuParams], ...] = Field(min_length=1)
    fault: tuple[SerializeAsAny[EcuFault], ...] = ()
    wire: tuple[WireFault, ...] = ()
    expect: tuple[Expectation, ...] = ()
    requirement: tuple[str, ...] = Field((), description="ids of requirements that it tests, for reports")
    unexpected: Literal["fail", "allow"] = Field("fail", description="DTCs that no line expects")

    @model_validator(mode="before")
    @classmethod
    def _types(cls, data: Any) -> Any:
        """Read ECUs and faults by the models of their types."""
        if not isinstance(data, dict):
            return data
        tables = {key: data.get(key, ()) for key in ("ecu", "fault")}
        for entries in tables.values():
            if not isinstance(entries, list | tuple) or not all(
                isinstance(entry, dict | EcuParams | EcuFault) for entry in entries
            ):
                return data  # said below
        wrong: list[InputError] = []
        ecus = _all(tables["ecu"], "ecu", _ecu, wrong)
        if wrong:
            raise InputErrors(wrong)
        faults = _all(tables["fault"], "fault", lambda entry, key: _fault(entry, ecus, key), wrong)
        if wrong:
            raise InputErrors(wrong)
        return {**data, "ecu": tuple(ecus), "fault": tuple(faults)}

    @model_validator(mode="after")
    def _names_fit(self) -> Scenario:
        names = [ecu.name for ecu in self.ecu]
        if len(set(names)) != len(names):
            raise ValueError(f"two ECUs share a name: {', '.join(names)}")
        for fault in self.fault:
            if fault.ecu not in names:
                raise ValueError(f"no ECU {fault.ecu!r}; there are {', '.join(names)}")
            ecu = self.ecu[names.index(fault.ecu)]
            found = _of_type(ecu.type, "ecu")
            if isinstance(fault, MessageFault):
                continue
            if found.fault is None or not isinstance(fault, found.fault):
                raise ValueError(f"ECU {ecu.name!r} is of type {ecu.type}: it has no {fault.kind}")
            found.fits(ecu, fault)
        return self


def _all(entries: Sequence[Any], name: str, read: Callable[[Any, str], T], wrong: list[InputError]) -> list[T]:
    """Read all entries of a table; errors are collected."""
    found = []
    for k, entry in enumerate(entries):
        try:
            found.append(read(entry, f"{name}[{k}]"))
        except InputErrors as errors:
            wrong += errors.errors
        except InputError as error:
            wrong.append(error)
    return found


def located(scenario: Scenario, folder: Path) -> Scenario:
    """Return a scenario whose paths, relative to a folder, are made whole.

    Raises:
        InputError: a file that an ECU names is not there.
    """
    ecus = tuple(_of_type(ecu.type, f"ecu[{k}]").locate(ecu, folder, f"ecu[{k}]") for k, ecu in enumerate(scenario.ecu))
    return scenario.model_copy(update={"config": beside_or_shipped(folder, scenario.config), "ecu": ecus})


def load_scenario(path: Path) -> Scenario:
    """Read a scenario; paths in it become relative to its folder.

    Raises:
        InputError, InputErrors: the file cannot be read, or a key is wrong.
    """
    beside(path.parent)
    try:
        return located(load(path, Scenario), path.parent)
    except InputErrors as errors:
        raise InputErrors([error.within(path) for error in errors.errors]) from errors
    except InputError as error:
        raise error.within(path) from error
