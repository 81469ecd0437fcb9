"""Evidence in words: what an entry of the fault memory says to somebody who does not read status bytes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from gateway.engine.buckets import nearness
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
    said = [f"{now}; it came {times} and is {sure}."]
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


def _times(value: float, limit: float) -> str:
    if limit == 0:
        return ""
    near = nearness(True, value, limit)
    return f" ({near:.3g} of what is allowed)" if near > 1 else ""
