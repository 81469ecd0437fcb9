"""Remedy of a fault: when to have it checked, and where to look."""

from __future__ import annotations

from gateway.faults.settings import CLASSES, SEVERITIES

#: Severity (ISO 14229-1, Annex D.3) -> when to have it checked.
WHEN = {
    "none": "no statement on when to have it checked",
    "maintenance": "have it checked at the next service",
    "next_halt": "have it checked at the next halt",
    "immediately": "stop, and have it checked at once",
}

#: Upper digit of the failure type byte -> where to look, by the categories of SAE J2012-DA.
_WHERE = {
    0x1: "check wiring, connectors and supply of the circuit",
    0x2: "check the sensor, its fixing and its signal's line",
    0x3: "check the sensor and the line of its pulses: gap, shield, disturbances",
    0x4: "check the control unit itself: supply, memory, temperature",
    0x5: "check the control unit's software and coding",
    0x6: "compare the signals named in the evidence with each other; one of them or its sensor is wrong",
    0x7: "check the mechanics: seized, loose, worn or damaged parts",
    0x8: "check the sender of the message: supply, its wires to the bus, its software and database",
    0x9: "check the component: fitted, right part, temperature",
}
_ANYWHERE = "look at the evidence and the freeze frames (gateway faults show)"


def remedy_of(dtc: int) -> str:
    """Return where to look, by the failure type byte of a DTC."""
    return _WHERE.get((dtc & 0xFF) >> 4, _ANYWHERE)


def severity_names(byte: int) -> tuple[str, str]:
    """Return the names of severity and class, as the configuration spells them."""
    severity = next((name for name, bits in SEVERITIES.items() if byte & 0xE0 == bits), "none")
    kind = next((name for name, bits in CLASSES.items() if byte & 0x1F == bits), "unclassified")
    return severity, kind
