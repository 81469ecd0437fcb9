"""Ranges that a quantity has in any car, by what it is called and by its unit; only where the drive keeps them.

The supply of a 12 V system is 10.5 to 16 V while its generator or converter runs (ISO 16750-2, test code D); cranking
takes seconds. A coolant above 130 degC boils in any engine.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from cantools.database.can.signal import Signal


@dataclass(frozen=True)
class Standard:
    """A range of any car.

    Attributes:
        low, high: of it, unit of the signal.
        seen: values that the drive must keep within for the range to be taken.
        why: for people.
        failed_ms: time that a healthy one may be beyond, while cranking [ms]; None: that of any signal.
    """

    low: float
    high: float
    seen: tuple[float, float]
    why: str
    failed_ms: float | None = None


_COOLANT = Standard(-40.0, 130.0, (-40.0, 122.0), "no engine's coolant is above 130 degC")
_SUPPLY = Standard(
    10.5, 16.0, (11.0, 15.8), "a 12 V supply is 10.5 to 16 V (ISO 16750-2), but while cranking", 10_000.0
)
_DEGREES = re.compile(r"(deg|degree|degrees|\u00b0)? ?(c|celsius)|degrees celsius", re.IGNORECASE)
_IS_COOLANT = re.compile(r"COOLANT|CLT$|\bECT|_ECT|ENG\w*WATER|KUEHLMITTEL", re.IGNORECASE)
#: Other temperatures of messages that are called so.
_OTHER = re.compile(r"OIL|OEL|AIR|CABIN|AMB|OUTSIDE|BATT|MOTOR|INV|TRANS|FUEL|EXH", re.IGNORECASE)
_IS_SUPPLY = re.compile(
    r"BATT|SUPPLY|VPWR|VBAT|MODULE_?VOLT|CTRL_?MOD_?V|CONTROLMODULEVOLT|SYSTEM_?VOLT|KL_?(15|30)", re.IGNORECASE
)


def standard(message: str, signal: Signal, lowest: float, highest: float) -> Standard | None:
    """Return the range that any car keeps of a quantity; None: it is none of those, or the drive does not keep it."""
    unit, name = (signal.unit or "").strip(), f"{message}.{signal.name}"
    if _DEGREES.fullmatch(unit) and _IS_COOLANT.search(name) and not _OTHER.search(signal.name):
        found = _COOLANT
    elif unit.lower() in ("v", "volt", "volts") and _IS_SUPPLY.search(name):
        found = _SUPPLY
    else:
        return None
    return found if found.seen[0] <= lowest and highest <= found.seen[1] else None
