"""A DTC event in words: its evidence against the limit, its meaning, what to do."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from gateway.cli.lines import number, wrapped
from gateway.faults.catalogue import FaultDefinition
from gateway.faults.remedy import WHEN, severity_names
from gateway.faults.status import Status
from gateway.monitors.evidence import in_words, stands_for_names

#: Significant digits of evidence in short form.
FEW = 3


def against(evidence: Mapping[str, float | None], tested: str, digits: int = 6) -> str:
    """Return what was tested against its limit: ``"pulse away from its place: 0.992, limit 0.5 [pitch]"``.

    Args:
        evidence: of the event.
        tested: name of the value, with its unit in brackets at the end; "": not known.
        digits: significant ones of the numbers.
    """
    name, bracket, unit = tested.partition(" [")
    value, limit = (number(evidence.get(key), digits) for key in ("value", "threshold"))
    return f"{name or 'value'}: {value}, limit {limit}{bracket}{unit}"


def others(evidence: Mapping[str, float | None], tested: str, digits: int = 6) -> Iterator[str]:
    """Yield the other values of the evidence, each with its name and unit."""
    for name, value in evidence.items():
        if name not in ("value", "threshold", tested):
            told = number(value, digits)
            yield ": ".join(in_words(name, value, told)) if stands_for_names(name) else f"{name} {told}"


def few(evidence: Mapping[str, float | None], tested: str, width: int) -> str:
    """Return the evidence in short form: the tested value, and as many others as two lines have place for."""
    found = [against(evidence, tested, FEW), *others(evidence, tested, FEW)]
    for kept in range(len(found), 0, -1):
        text = "  ".join([*found[:kept], *(["..."] if kept < len(found) else [])])
        if wrapped(text, width, 0).count("\n") < 2:
            return text
    return found[0]


def advice(definition: FaultDefinition) -> str:
    """Return what to do about a fault, and when."""
    severity, _ = severity_names(definition.severity)
    return definition.remedy + ("" if severity == "none" else f"; {WHEN[severity]}")


def state_in_words(status: int) -> str:
    """Return the bits of a status byte that matter to most readers: ``"failed now, confirmed"``."""
    bits = Status(status)
    words = ["failed now" if bits & Status.TEST_FAILED else "not failed now"]
    if bits & Status.CONFIRMED_DTC:
        words.append("confirmed")
    elif bits & Status.PENDING_DTC:
        words.append("pending")
    if bits & Status.WARNING_INDICATOR:
        words.append("warning lamp on")
    return ", ".join(words)
