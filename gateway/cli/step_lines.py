"""A step of a monitor as lines for people: its inputs, its state after it, and its results."""

from __future__ import annotations

from typing import Any

from gateway.cli.lines import wrapped

#: Elements of an array that are printed.
_FEW = 8
#: Where a step's fields begin.
_HANG = 24


def text_of(event: dict[str, Any], start_ns: int, width: int) -> list[str]:
    """Return a step as lines for people, of at most ``width`` columns."""
    seconds = (event["t_ns"] - start_ns) / 1e9
    more = f" ({event['not_shown']} before it not shown)" if event["not_shown"] else ""
    lines = [f"{seconds:10.4f} s  {event['monitor']} step {event['step']}: {event['trigger']}{more}"]
    lines += [_fields("in", event["inputs"]), _fields("state", event["state"])]
    for result in event.get("results", ()):
        found = f"{result['fault']} {result['result']}: {_number(result['value'])} against"
        lines.append(f"{'':14}{found} {_number(result['threshold'])}")
        if result["result"] == "failed":
            lines.append(_fields("evidence", result["evidence"]))
    if "sent" in event:
        lines.append(_fields("sent", event["sent"]))
    return [wrapped(line, width, _HANG) for line in lines]


def _fields(title: str, fields: dict[str, Any]) -> str:
    return f"{'':14}{title:<10}" + "  ".join(f"{name} {_shown(value)}" for name, value in fields.items())


def _shown(value: Any) -> str:
    if isinstance(value, dict):
        return "{" + "  ".join(f"{name} {_shown(part)}" for name, part in value.items()) + "}"
    if isinstance(value, list):
        more = " ..." if len(value) > _FEW else ""
        return "[" + " ".join(map(_shown, value[:_FEW])) + more + "]"
    return _number(value)


def _number(value: Any) -> str:
    return "-" if value is None else f"{value:.6g}"
