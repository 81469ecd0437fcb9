"""An injected fault in words, for people: its subject, its kind, how much, until when."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Any

from gateway_bench.vecu.contract import Truth
from gateway_bench.vecu.scenario import Scenario

#: Kind of a fault, or the end of its name after "_" -> what happens.
WORDS = {
    "missed_pulses": "sensor misses pulses",
    "added_pulses": "sensor gives pulses that no tooth made",
    "impulses": "single readings are wrong",
    "stuck": "stands still",
    "freeze": "stands still",
    "frozen": "stands still",
    "offset": "is off by a constant",
    "drift": "moves away from the truth",
    "gain": "is multiplied by a factor",
    "scale": "is multiplied by a factor",
    "noise": "is noisy",
    "intermittent": "jumps to and fro",
    "garbage": "readings are random",
    "value": "is set to a value",
    "ramp": "grows to a value",
    "short_to_ground": "short circuit to ground",
    "short_to_supply": "short circuit to the supply",
    "open": "broken wire",
    "out_of_range": "is outside of its range",
    "sna": "says that it has no value",
    "counter": "alive counter is wrong",
    "checksum": "checksum is wrong",
    "lost": "frames are lost",
    "late": "frames come late",
    "late_voltage": "voltage frames come late",
    "doubled": "frames come twice",
    "duplicated": "frames come twice",
    "short": "frames are too short",
    "corrupted": "frames have wrong bits",
    "silent": "no frames come",
    "babbling": "ECU sends without a pause",
    "bus_off": "controller is off the bus",
    "slow": "answers come late",
    "pending": "says that it needs longer, and gives no answer",
    "sequence": "frames of answers are numbered wrong",
    "reset": "ECU resets in the middle of answers",
    "mute": "ECU gives no answer",
    "echo": "answers are those of other requests",
    "refuse": "ECU refuses requests",
    "reading": "answers have another value",
    "battery_short": "battery cells are in short circuit",
    "inverter_voltage": "voltage of the inverter is wrong",
    "machine_efficiency": "efficiency of the electric machine is wrong",
    "machine_resistance": "resistance of the electric machine is wrong",
    "machine_voltage_sensor": "voltage sensor of the electric machine is wrong",
}

#: A unit at the end of a description: "torque of a jam [N m]".
_UNIT = re.compile(r"\[([^][ ']+(?: [^][ ']+)?)\]$")

#: Fields of a fault that say what it is a fault of.
_SUBJECTS = ("signal", "message", "input", "name", "place", "channel", "request")


def injected(fact: Truth, scenario: Scenario) -> str:
    """Return what was injected, e.g. ``"channel 1: short circuit to ground, until 4.5 s"``."""
    fault = fault_of(fact, scenario)
    kind = fact.kind if fault is None else str(fault.kind)
    of_kind, what = _parted(kind)
    known = {} if fault is None else {key: value for key, value in fault if value is not None and value != "*"}
    subject = _subject(known, of_kind)
    details = [] if fault is None else [_detail(fault, key) for key in _details(fault)]
    if fact.tooth >= 0:
        details += [f"{fact.count} at tooth {fact.tooth}"]
    if known.get("when"):
        details += [f"while {known['when']}"]
    if "to_s" in known:
        details += [f"until {known['to_s']:g} s"]
    return ", ".join([f"{subject}: {what}" if subject else what, *details])


def fault_of(fact: Truth, scenario: Scenario) -> Any:
    """Return the scenario's fault that was injected: the latest of its kind that had begun; None: it has none."""
    every: Iterable[Any] = (*scenario.fault, *scenario.wire)
    same = [fault for fault in every if fact.kind in (fault.kind, getattr(fault, "name", None))]
    begun = [fault for fault in same if _begins_ns(fault) <= fact.t_ns]
    return max(begun, key=_begins_ns, default=None)


def _begins_ns(fault: Any) -> int:
    begins = getattr(fault, "from_s", None)
    return round(1e9 * (getattr(fault, "at_s", None) or 0.0 if begins is None else begins))


def _details(fault: Any) -> list[str]:
    """Return the fields that say how much, as far as the scenario gives them."""
    told = {"kind", "ecu", "bus", "from_s", "to_s", "at_s", "when", "count", "tooth", *_SUBJECTS}
    given = [key for key in type(fault).model_fields if key in fault.model_fields_set - told]
    return [key for key in given if isinstance(getattr(fault, key), int | float) and getattr(fault, key) is not True]


def _detail(fault: Any, key: str) -> str:
    """Return a field with its value, and its unit where its description ends with one in brackets."""
    found = _UNIT.search(type(fault).model_fields[key].description or "")
    name, unit = (key, "") if found is None else (key.removesuffix(f"_{found[1]}"), f" {found[1]}")
    return f"{name.replace('_', ' ')} {getattr(fault, key):g}{unit}"


def _parted(kind: str) -> tuple[str, str]:
    """Return the subject in a kind's name, "" for none, and its fault: ``wheel_angle_offset``."""
    if kind in WORDS:
        return "", WORDS[kind]
    for end in sorted(WORDS, key=len, reverse=True):
        if kind.endswith(f"_{end}"):
            return kind.removesuffix(f"_{end}").replace("_", " "), WORDS[end]
    return "", kind.replace("_", " ")


def _subject(known: dict[str, Any], of_kind: str) -> str:
    """Return what a fault is of, by its kind's name and its fields; "": not said."""
    key = next((key for key in _SUBJECTS if key in known), None)
    if key is None:
        return of_kind
    if key == "place":
        return f"{of_kind or key} {known[key]}"
    if key == "channel":
        return f"channel{'s' if len(known[key]) > 1 else ''} {', '.join(map(str, known[key]))}"
    return f"{of_kind} {known[key]}".strip()
