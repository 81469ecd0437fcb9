"""Faults: entries of the fault memory with status, environment data, evidence and cause; clearing.

``code`` is the DTC. Two entries of one DTC, which an earlier configuration can have left, are told apart by the
fault's id behind it: ``P0336-39~crank.missing_tooth``; clearing one clears both, as by UDS.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime, timedelta
from typing import Any, Literal

from pydantic import Field, create_model

from gateway.faults.dtc import Dtc
from gateway.faults.records import COUNTERS, TOLD
from gateway_fdi.errors import GatewayError, InputError
from gateway_serve.memory import BITS
from gateway_serve.sovd.components import OWN, Component, known
from gateway_serve.sovd.errors import SovdError
from gateway_serve.sovd.model import Described, Describing, Model
from gateway_serve.sovd.table import Call, Endpoint

#: The one memory that there is, and its severities (1: the worst) by their names here.
SCOPE = "primary"
SEVERITY = {"immediately": 1, "next_halt": 2, "maintenance": 3}
#: Keys of an entry that are extended data, and those that only we know.
_EXTENDED = (*(name for name in TOLD if name in COUNTERS), "permanent")
_OURS = ("evidence", "inputs", "cause", "hold", "words", "remedy", "stored")
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_Bit = Literal["0", "1"]
_Word = Literal["active", "passive", "cleared"]
_YesNo = Literal["true", "false"]

_STATUS: dict[str, Any] = {
    "mask": (str, ...),
    "aggregatedStatus": (_Word, ...),
    **dict.fromkeys(BITS, (_Bit, ...)),
}
FaultStatus = create_model(
    "FaultStatus",
    __base__=Model,
    __doc__="The status byte: as a whole, in one word, and its bits by the names of ISO 14229-1.",
    **_STATUS,
)
_FILTER: dict[str, Any] = {
    "aggregatedStatus": (_Word | None, None),
    **dict.fromkeys(BITS, (Literal["0", "1", "true", "false"] | None, None)),
}
StatusFilter = create_model(
    "StatusFilter", __base__=Model, __doc__="Bits that a fault is to have, one of them at least.", **_FILTER
)


class Fault(Model):
    """A fault."""

    code: str
    scope: str
    display_code: str
    fault_name: str
    severity: int | None = Field(None, ge=1, le=4)
    status: FaultStatus
    symptom: str | None = None


class FaultList(Described):
    """Faults, in the order in which all lists have them."""

    items: list[Fault]


class FaultFilter(Describing):
    """Which faults are listed."""

    status: StatusFilter | None = None
    severity: Literal["1", "2", "3", "4"] | None = None
    scope: str | None = None


class Parts(Describing):
    """Which parts of a fault are told."""

    snapshots: _YesNo = Field("true", alias="include-snapshot-data")
    extended: _YesNo = Field("true", alias="include-extended-data")


class Snapshot(Model):
    """A freeze frame: signals, or of another ECU the bytes of its answer."""

    record: int | None = None
    timestamp: datetime | None = None
    t_ns: int | None = None
    data: dict[str, Any]


class Environment(Model):
    """Facts of the time when it failed."""

    extended_data_records: dict[str, Any] | None = None
    snapshots: list[Snapshot] | None = None


class FaultDetail(Described):
    """A fault, and what is known of it.

    Attributes:
        item: the fault.
        environment_data: freeze frames and extended data.
        x_gateway: evidence, cause, both in words, and the remedy.
    """

    item: Fault
    environment_data: Environment
    errors: tuple[dict[str, Any], ...] = ()
    x_gateway: dict[str, Any] | None = Field(None, alias="x-gateway")


def instant(t_ns: int | None) -> datetime | None:
    """Return a time of the wall clock [ns] as people write it, to the microsecond; None: there is none."""
    try:
        return None if t_ns is None else _EPOCH + timedelta(microseconds=t_ns // 1000)
    except OverflowError:
        return None


def _status(byte: int) -> Model:
    word = "active" if byte & 1 else "passive" if byte & 0x0C else "cleared"
    bits = {name: str(byte >> k & 1) for k, name in enumerate(BITS)}
    return FaultStatus.model_validate({"mask": f"0x{byte:02X}", "aggregatedStatus": word, **bits})


class Found:
    """An entry of the fault memory, or a DTC of another ECU, as a fault.

    Args:
        entry: as the memory's file has it.
        code: unique.
    """

    def __init__(self, entry: Mapping[str, Any], code: str) -> None:
        self.entry, self.code = entry, code
        fault = entry.get("fault")
        byte = entry["status"] & 0xFF
        self.shown = Fault(
            code=code,
            scope=SCOPE,
            display_code=entry["dtc"],
            fault_name=entry.get("description") or fault or entry["dtc"],
            severity=SEVERITY.get(entry.get("severity") or ""),
            status=_status(byte),
            symptom=fault,
        )

    def detail(self, query: Parts) -> FaultDetail:
        """Return what is known of it."""
        entry = self.entry
        own = "fault" in entry
        names = (*_EXTENDED, "first_ns", "last_ns") if own else ("came", "first_ns", "last_ns", "went_ns")
        extended = {name: entry[name] for name in names}
        extended |= {name.replace("_ns", "_time"): instant(entry[name]) for name in names if name.endswith("_ns")}
        snapshots = (
            [
                Snapshot(record=one["record"], timestamp=instant(one["t_ns"]), t_ns=one["t_ns"], data=one["signals"])
                for one in entry["freeze_frames"]
            ]
            if own
            else [Snapshot(data={"request": kind, "raw": raw}) for kind, raw in entry["snapshots"].items()]
        )
        ours = {name: entry[name] for name in _OURS if name in entry}
        return FaultDetail(
            item=self.shown,
            environment_data=Environment(
                extended_data_records=extended if query.extended == "true" else None,
                snapshots=snapshots if query.snapshots == "true" else None,
            ),
            **{"x-gateway": ours or None},
        )


async def of(call: Call) -> dict[str, Found]:
    """Return the faults of the entity of a request by their codes.

    Raises:
        SovdError: there is no such entity, or its faults cannot be read.
    """
    state = call.state
    told = {fault["id"]: fault for fault in state.hub.hello["faults"]}
    memory = await state.hub.read_memory()
    if memory["error"]:
        why = memory["error"] if state.hub.connected else f"the gateway does not run: {state.hub.reason}"
        raise SovdError(503, why)
    ordered = {fault: k for k, fault in enumerate(f for case in memory["cases"] for f in case["faults"])}
    entries: Sequence[Mapping[str, Any]] = sorted(memory["entries"], key=lambda each: ordered[each["fault"]])

    def where(key: str, name: str) -> Sequence[Mapping[str, Any]]:
        return [each for each in entries if told.get(each["fault"], {}).get(key) == name]

    if "area_id" in call.path:
        entries = where("bus", known(state.buses(), call.path["area_id"], "area"))
    elif "app_id" in call.path:
        entries = where("monitor", known(state.monitors(), call.path["app_id"], "app"))
    else:
        one = state.component(call.path)
        if one.id != OWN:
            theirs = [each for each in memory["ecu_dtcs"] if each["ecu"] == one.name and each["there"]]
            entries = [*(where("ecu", one.name) if one.sends else ()), *theirs]
    times = Counter(each["dtc"] for each in entries)
    codes = [each["dtc"] + (f"~{each.get('fault', 'ecu')}" if times[each["dtc"]] > 1 else "") for each in entries]
    return {code: Found(each, code) for code, each in zip(codes, entries, strict=True)}


def _wanted(found: Found, query: FaultFilter) -> bool:
    shown = found.shown
    if query.scope not in (None, shown.scope):
        return False
    if query.severity is not None and query.severity != str(shown.severity):
        return False
    if query.status is None:
        return True
    has = shown.status.model_dump()
    asked = query.status.model_dump(exclude_none=True)
    same = {"true": "1", "false": "0"}
    return not asked or any(has[name] == same.get(value, value) for name, value in asked.items())


async def _list(call: Call) -> FaultList:
    found = await of(call)
    return FaultList(items=[each.shown for each in found.values() if _wanted(each, call.query)])


async def _show(call: Call) -> FaultDetail:
    found: Found = known(await of(call), call.path["fault_code"], "fault")
    return found.detail(call.query)


async def _clear(call: Call) -> None:
    one = call.state.component(call.path)
    await _do_clear(call, one, None if one.ecu else [each.entry["dtc"] for each in (await of(call)).values()])


async def _clear_one(call: Call) -> None:
    one = call.state.component(call.path)
    found: Found = known(await of(call), call.path["fault_code"], "fault")
    await _do_clear(call, one, [found.entry["dtc"]], of_ecu="fault" not in found.entry)


async def _do_clear(call: Call, one: Component, dtcs: Sequence[str] | None, *, of_ecu: bool = False) -> None:
    """Clear DTCs, or all: of the ECU itself where it is asked, else those that the gateway has of it.

    A fault that the gateway found is in the gateway's memory, and needs the gateway's lock.
    """
    target = one if one.ecu and (dtcs is None or of_ecu) else call.state.components()[OWN]
    try:
        groups = [b"\xff\xff\xff"] if dtcs is None else [bytes(Dtc.parse(each)) for each in dict.fromkeys(dtcs)]
    except (InputError, GatewayError) as error:  # of OBD: it has no failure type
        raise SovdError(409, f"this DTC cannot be cleared alone: {error}") from error
    call.state.locks.own(call.who, target)
    for group in groups:
        await call.state.locks.intervene(call.who, target, b"\x14" + group)
    call.state.hub.ask_memory()


def _reading(path: str, what: str) -> tuple[Endpoint, Endpoint]:
    return (
        Endpoint("GET", path, f"Faults of {what}", _list, FaultList, query=FaultFilter),
        Endpoint("GET", path + "/{fault_code}", f"A fault of {what}", _show, FaultDetail, query=Parts),
    )


_FAULTS = "/components/{component_id}/faults"
ENDPOINTS = (
    *_reading(_FAULTS, "a component"),
    *_reading("/areas/{area_id}/faults", "a bus"),
    *_reading("/apps/{app_id}/faults", "a monitor"),
    Endpoint("DELETE", _FAULTS, "Clear all faults", _clear, None, 204),
    Endpoint("DELETE", _FAULTS + "/{fault_code}", "Clear a fault", _clear_one, None, 204),
)
