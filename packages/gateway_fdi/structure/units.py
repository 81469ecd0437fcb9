"""Units as they are compared."""

from __future__ import annotations


def plain_unit(unit: str) -> str:
    """Return a unit as it is compared: without spaces, and empty for a pure number."""
    text = "".join(unit.split()).replace("·", "").replace("*", "").replace("²", "2")
    return "" if text in ("1", "-") else text


def differ(a: str, b: str) -> bool:
    """Return whether two quantities have different units; one without a unit fits everything."""
    return bool(plain_unit(a)) and bool(plain_unit(b)) and plain_unit(a) != plain_unit(b)
