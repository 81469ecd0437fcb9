"""Evidence in words: an entry of the fault memory for people who do not read status bytes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from gateway.engine.buckets import nearness
from gateway.faults.explanation import CAUSE, HELD, OPEN
from gateway.faults.fault_groups import named, percent
from gateway.faults.remedy import WHEN
from gateway.faults.status import Status
from gateway.monitors.evidence import in_words

_COUNTS = {1: "once", 2: "twice"}


def number(value: float | None) -> str:
    """Return a number as people write it; "unknown" for none."""
    return "unknown" if value is None else f"{value:.6g}"


def unit_of(tested: str) -> str:
    """Return the unit of a name with its unit in brackets at the end; "": it has none."""
    return tested.partition(" [")[2].removesuffix("]")


def sentences(entry: Mapping[str, Any]) -> list[str]:
    """Return sentences about one entry, the most important first.

    Args:
        entry: as :func:`gateway.faults.service.list_entries` has it, with the fault's ``tested`` if known.
    """
    status = Status(entry["status"])
    times = _COUNTS.get(entry["occurrence"], f"{entry['occurrence']} times")
    now = "It is there now" if status & Status.TEST_FAILED else "It is not there at present"
    sure = (
        "confirmed" if status & Status.CONFIRMED_DTC else "pending" if status & Status.PENDING_DTC else "not confirmed"
    )
    said = [f"{now}; it came {times} and is {sure}.", *_explained(entry)]
    evidence = dict(entry["evidence"])
    value, limit = evidence.pop("value", None), evidence.pop("threshold", None)
    tested = str(entry.get("tested") or "value")
    evidence.pop(tested, None)
    if value is not None and limit is not None:
        label, found = in_words(tested, value, number(value))
        _, allowed = in_words(tested, limit, number(limit))
        said.append(f"{label[0].upper()}{label[1:]}: {found}, limit {allowed}{_times(value, limit)}.")
    known = [": ".join(in_words(name, each, number(each))) for name, each in evidence.items() if each is not None]
    if known:
        said.append("Measured with it: " + "; ".join(known) + ".")
    if entry.get("remedy"):
        severity = "" if entry["severity"] == "none" else f"; {WHEN[entry['severity']]}"
        said.append(f"What to do: {entry['remedy']}{severity}.")
    return said


def _explained(entry: Mapping[str, Any]) -> list[str]:
    """Return the explanation of an entry, and its meaning for it."""
    cause = entry.get("cause")
    if cause is None:
        return []
    found = f"{named(cause['components'])} ({percent(cause['probability'])})"
    if cause["role"] == OPEN:
        ranked = ", ".join(f"{named(one['components'])} {percent(one['probability'])}" for one in cause["ranked"])
        return [f"Its cause is not isolated: {ranked}."]
    if cause["role"] == CAUSE:
        return [f"It names the cause: {found}."]
    if cause["lead"] == entry["fault"]:
        return [f"It is a symptom, and stands for its cause: {found}."]
    lead = f"It is a symptom of {found}, for which {cause['lead_dtc']} stands."
    return [lead, "It is held: it is not confirmed while that is so."] if entry["hold"] == HELD else [lead]


def _times(value: float, limit: float) -> str:
    if limit == 0:
        return ""
    near = nearness(True, value, limit)
    return f" ({near:.3g} times the limit)" if near > 1 else ""
