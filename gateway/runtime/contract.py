"""The contract of events: each kind that a gateway tells, its fields and their types, as a table and as JSON Schema.

``CONTRACT`` grows by one where a field goes, or its type changes; kinds and fields that come leave it as it is.
Programs that read events take a field, or a kind, that they do not know for one of later.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any, NamedTuple

#: Version of the contract.
CONTRACT = 2

#: Whether a fleet is told: not at all; as one of its events; as a detail, which goes first where there is no room.
HERE, EVENT, DETAIL = "here", "event", "detail"

#: Columns of the tests of ``statistics``, a place in each for a test. ``values`` are block maxima towards the limit in
#: units of 2 to the ``unit``, the first one and then how far each is above the one before; ``weights`` blocks of each.
STATISTICS = ("fault", "sign", "limit", "failed", "unit", "values", "weights")

#: Whole numbers are of 64 bits, others are doubles.
_LARGEST = 2**63 - 1
_NUMBER: dict[str, Any] = {"type": "number", "minimum": -1e308, "maximum": 1e308}
_TYPES: dict[str, dict[str, Any]] = {
    "int": {"type": "integer", "minimum": -_LARGEST, "maximum": _LARGEST},
    "text": {"type": "string"},
    "bool": {"type": "boolean"},
    "number": _NUMBER,
    "number?": _NUMBER | {"type": ["number", "null"]},
    "texts": {"type": "array", "items": {"type": "string"}},
    "numbers": {"type": "array", "items": _NUMBER},
    "values": {"type": "object", "additionalProperties": _NUMBER | {"type": ["number", "null"]}},
    "object": {"type": "object"},
    "objects": {"type": "array", "items": {"type": "object"}},
    "any": {},
}
_CLASSES: dict[str, tuple[type, ...]] = {
    "integer": (int,), "string": (str,), "boolean": (bool,), "number": (int, float), "null": (type(None),),
    "array": (list, tuple), "object": (dict,),
}  # fmt: skip


class Kind(NamedTuple):
    """A kind of event.

    Attributes:
        about: what it tells.
        fields: name -> type, ``name?`` one that may be missing; ``event`` is in all of them.
        fleet: whether a fleet is told.
    """

    about: str
    fields: dict[str, str]
    fleet: str = HERE


def _of(text: str) -> dict[str, str]:
    """Return fields that are written as ``type: name name, type: name``."""
    return {name: kind for part in text.split(", ") for kind, names in [part.split(": ")] for name in names.split()}


_BUS = "text: bus uri state reason, int: t_ns received sent overflow rejected refused driver_errors unsent losses"

#: All kinds, by name.
EVENTS: dict[str, Kind] = {
    "dtc": Kind(
        "the status byte of a DTC changed",
        _of("int: t_ns status fdc occurrence, text: bus fault dtc, values: evidence, bool: stored?"),
        EVENT,
    ),
    "diagnosis": Kind("what explains the faults that are there", _of("int: t_ns, objects: groups"), EVENT),
    "symptoms": Kind(
        "symptoms are held by a proven cause, or released",
        _of("int: t_ns, text: state lead, texts: faults cause"),
        EVENT,
    ),
    "clear": Kind("entries were cleared", _of("int: t_ns, texts: faults"), EVENT),
    "cycle": Kind("an operation cycle began, ended or goes on", _of("int: t_ns number, text: bus cycle state"), EVENT),
    "ecu_dtc": Kind("a DTC of another ECU came, changed or went", _of("int: t_ns status, text: ecu dtc state"), EVENT),
    "security": Kind(
        "a sensor saw what a healthy bus does not do",
        _of("int: t_ns count total, text: sensor kind, object: context"),
        EVENT,
    ),
    "restart": Kind(
        "the last process was not stopped but died",
        _of("int: t_ns count in_a_row cycle, text: reason file, number: wait_s"),
        EVENT,
    ),
    "memory": Kind(
        "something happened to the fault memory's file",
        _of("int: t_ns unsaved recovered? lost?, text: file state reason aside?, texts: faults?"),
        EVENT,
    ),
    "monitor_off": Kind("a monitor is switched off", _of("int: t_ns, text: bus monitor type file reason"), EVENT),
    "other_software": Kind(
        "a message never was as its check says", _of("int: t_ns, text: bus message what, number: now learned"), EVENT
    ),
    "intervention": Kind(
        "a tester did something, or was refused",
        _of("int: t_ns first_ns count address session security nrc, text: protocol bus role action request outcome"),
        DETAIL,
    ),
    "reporter": Kind(
        "a process that reports test results went or came back",
        _of("int: t_ns, text: reporter state reason, texts: faults"),
        DETAIL,
    ),
    "protection": Kind(
        "no frame passes a rule of protection", _of("int: t_ns, text: bus message rule, texts: fits differs"), DETAIL
    ),
    "lossy": Kind(
        "frames of a bus get lost, or no more", _of("int: t_ns, text: bus, bool: lossy, number: share"), DETAIL
    ),
    "activity": Kind("a bus sleeps, wakes, runs or falls asleep", _of("int: t_ns, text: bus activity before"), DETAIL),
    "clock": Kind("the wall clock was set", _of("int: t_ns, number: step_s"), DETAIL),
    "short_frames": Kind(
        "frames are shorter than the database says",
        _of("int: t_ns length database, text: bus message, texts: signals"),
        DETAIL,
    ),
    "source": Kind(
        "a further source address sends a message, or is silent",
        _of("int: t_ns source, text: bus message, number?: silent_ms"),
        DETAIL,
    ),
    "statistics": Kind(
        "how far test results went in a drive, test by test",
        _of("int: t_ns begin_ns part, text: condition, number: block_s seconds, object: tests"),
        DETAIL,
    ),
    "recording": Kind(
        "frames around a failure, a part of a compressed candump log (zlib, then base64)",
        _of("int: t_ns frames dropped part parts, text: fault log"),
        DETAIL,
    ),
    "campaign": Kind(
        "what became of a campaign in a car",
        _of("int: t_ns serial, text: campaign state reason, number?: hours, int: causes? told?"),
        EVENT,
    ),
    "monitor": Kind(
        "a verdict that changed no DTC, or a value that is watched",
        _of("int: t_ns fdc, text: bus fault result, number?: value threshold"),
    ),
    "stored": Kind("changes that were told before are stored now", _of("int: t_ns, texts: faults")),
    "bus": Kind("the state of a bus", _of(_BUS)),
    "config": Kind("another configuration was read, or refused", _of("int: t_ns, text: file state reason")),
    "injected": Kind("a scenario put in a fault", _of("int: t_ns, text: text")),
    "log": Kind(
        "a log was read",
        _of("text: file state, int: frames left_out, object: channels, texts: notes reasons"),
    ),
    "summary": Kind(
        "the end: what was done",
        _of(
            "int: frames decoded events, number: seconds frames_per_s, object: counters buses, any: monitors,"
            " texts: dtcs, objects: causes"
        ),
    ),
}


def reported_to_fleet(event: Mapping[str, Any]) -> str:
    """Return whether a fleet is told of an event: :data:`HERE`, :data:`EVENT` or :data:`DETAIL`."""
    kind = EVENTS.get(event["event"])
    return HERE if kind is None else kind.fleet


def wrong(event: Any) -> str:
    """Return why something is no event of this contract, "" if it is one; fields of later are taken."""
    name = event.get("event") if isinstance(event, dict) else None
    kind = EVENTS.get(name) if isinstance(name, str) else None
    if kind is None:
        return "no event of this contract"
    for field, of in kind.fields.items():
        name = field.rstrip("?")
        if name not in event:
            if name == field:
                return f"{event['event']} without {name}"
        elif not _fits(event[name], _TYPES[of]):
            return f"{event['event']}: {name} is no {of}"
    return ""


def _fits(value: Any, schema: Mapping[str, Any]) -> bool:
    """Return whether a value is of a type of :data:`_TYPES`."""
    kinds = schema.get("type")
    if kinds is None:
        return True
    classes = tuple(each for kind in ([kinds] if isinstance(kinds, str) else kinds) for each in _CLASSES[kind])
    if isinstance(value, bool):
        return bool in classes
    if not isinstance(value, classes) or (isinstance(value, float) and not abs(value) <= 1e308):
        return False
    if isinstance(value, int) and "maximum" in schema and not schema["minimum"] <= value <= schema["maximum"]:
        return False
    inner: Any = value
    if "items" in schema:
        return all(_fits(each, schema["items"]) for each in inner)
    if "additionalProperties" in schema:
        return all(_fits(each, schema["additionalProperties"]) for each in inner.values())
    return True


@cache
def schema() -> dict[str, Any]:
    """Return the JSON Schema (2020-12) of an event."""
    made = {}
    for name, kind in EVENTS.items():
        required = ["event", *(field for field in kind.fields if not field.endswith("?"))]
        fields = {field.rstrip("?"): _TYPES[of] for field, of in kind.fields.items()}
        made[name] = {
            "type": "object",
            "description": kind.about,
            "properties": {"event": {"const": name}, **fields},
            "required": required,
        }
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$id": f"urn:ecu-gateway:events:{CONTRACT}",
        "title": "Events of the gateway",
        "oneOf": [{"$ref": f"#/$defs/{name}"} for name in made],
        "$defs": made,
    }
