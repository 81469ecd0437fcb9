"""Evidence in words: an entry of the fault memory for people who do not read status bytes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from gateway.engine.buckets import nearness
from gateway.faults.cases import named, percent
from gateway.faults.explained import CAUSE, HELD, OPEN
from gateway.faults.remedy import WHEN
from gateway.faults.status import Status

_COUNTS = {1: "once", 2: "twice"}


def number(value: float | None) -> str:
    """Return a number as people write it; "unknown" for none."""
    return "unknown" if value is None else f"{value:.6g}"


def told_in_words(entry: Mapping[str, Any]) -> list[str]:
    """Return sentences about one entry, the most important first.

    Args:
        entry: as :func:`gateway.faults.service.list_entries` has it.
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
    if value is not None and limit is not None:
        said.append(f"The test found {number(value)}; its limit is {number(limit)}{_times(value, limit)}.")
    known = [f"{name.replace('_', ' ')} {number(each)}" for name, each in evidence.items() if each is not None]
    if known:
        said.append("Known of it: " + ", ".join(known) + ".")
    if entry.get("remedy"):
        said.append(f"What to do: {entry['remedy']}; {WHEN[entry['severity']]}.")
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
    return f" ({near:.3g} of what is allowed)" if near > 1 else ""
