"""Limits that a healthy log broke are widened, or taken out; each says so."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from gateway_fleet.learn.document import BusAsked, monitor_name
from gateway_fleet.learn.lines import CHECK, RULE, SIGNAL, Learned, Line, inline, short, shown
from gateway_fleet.learn.proof import Alarm

#: Kind of a message's fault -> key that is taken out, or said to be off.
_OUT = {"counter": "counter", "timeout": "timeout_ms", "early": "most", "second_sender": "most"}
#: Factor by which a limit is widened.
WIDER = 2.0


def owner(learned: Learned, fault: str, buses: Sequence[BusAsked]) -> tuple[Line, str] | None:
    """Return the line that a fault comes from, and the fault's kind; None: it is none of a line's."""
    for line in learned.lines.values():
        if line.table == CHECK:
            prefix = f"{line.bus}.{line.name}."
        elif line.table == SIGNAL:
            name = line.keys.get("name", line.name.rpartition(".")[2])
            prefix = f"{monitor_name(line.bus, SIGNAL, buses)}.{name}."
        else:
            if line.table == RULE and fault == f"{monitor_name(line.bus, RULE, buses)}.{line.name}":
                return line, "rule"
            continue
        if fault.startswith(prefix) and "." not in fault[len(prefix) :]:
            return line, fault[len(prefix) :]
    return None


def widened(line: Line, kind: str, alarm: Alarm, again: bool) -> tuple[Line | None, str]:
    """Return a line with the limit that alarmed widened, None if nothing of it is left; and the change in words.

    Args:
        line: of the configuration.
        kind: of the fault.
        alarm: that a healthy log gave.
        again: it has been widened before: now it is taken out.
    """
    keys = dict(line.keys)
    where = "in what was held out" if alarm.held_out else "in what was learned from"
    change = _changed(keys, kind, alarm, again)
    said = f"{kind} alarmed {where}: {change}"
    left = asks(line.table, keys)
    return (replace(line, keys=keys, why=f"{line.why}; {said}") if left else None), said


def asks(table: str, keys: Mapping[str, Any]) -> bool:
    """Return whether a line of a table asks for something, by its keys."""
    if table == SIGNAL:
        return (bool(set(keys) - {"signal", "name", "failed_ms", "passed_ms"}) and keys.get("invalid") != []) or bool(
            set(keys) & {"plausible", "gradient", "stuck", "undefined"}
        )
    return table != RULE or "holds" in keys


def _changed(keys: dict[str, Any], kind: str, alarm: Alarm, again: bool) -> str:
    """Change the keys of a line; returns what was done."""
    if kind == "timeout" and not again:
        keys["timeout_ms"] = short(WIDER * max(alarm.value, keys["timeout_ms"]), 2)
        return f"timeout {inline(keys['timeout_ms'])} ms"
    if kind == "early" and not again:
        frames = math.ceil(1.25 * keys["most"]["frames"] * max(alarm.value / alarm.threshold, 1.0))
        keys["most"] = keys["most"] | {"frames": frames}
        return f"{frames} frames"
    if kind in ("low", "high") and not again:
        low, high = keys["plausible"]
        room = high - low
        low, high = (min(low, alarm.value) - room, high) if kind == "low" else (low, max(high, alarm.value) + room)
        keys["plausible"] = [short(low), short(high)]
        return f"range {shown(low)} to {shown(high)}"
    if kind == "gradient" and not again:
        keys["gradient"] = short(WIDER * max(alarm.value, keys["gradient"]), 3)
        return f"gradient {inline(keys['gradient'])}"
    counter = keys.get("counter")
    if kind == "counter" and counter is not None and not again:
        most = counter.get("modulus", alarm.threshold + 2.0) - 1
        step = max(counter.get("max_step", 1) + 1, min(alarm.value, most))
        keys["counter"] = dict(counter) | {"max_step": int(step)}
        return f"steps up to {int(step)}"
    return _taken_out(keys, kind)  # a relation, too: one that did not hold in all of the log is none


def _taken_out(keys: dict[str, Any], kind: str) -> str:
    if kind in ("crc", "rule") and "holds" not in keys:
        for name in ("crc", "checksum", "e2e"):
            keys.pop(name, None)
        return "protection taken out"
    if kind == "counter" and "e2e" in keys:
        del keys["e2e"]
        return "protection taken out"
    if kind == "length" and keys.get(kind, True) is not True:
        keys[kind] = True
        return "any that is long enough"
    if kind in ("length", "value"):
        keys[kind] = False
        return "off"
    if kind == "invalid":
        keys["invalid"] = []
        return "not tested"
    name = {"low": "plausible", "high": "plausible", "rule": "holds", **_OUT}.get(kind, kind)
    keys.pop(name, None)
    return "taken out"
