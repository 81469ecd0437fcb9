"""Times in integer nanoseconds."""

from __future__ import annotations

from datetime import UTC, tzinfo

from gateway_fdi.errors import InputError

#: A time that never comes [ns]: the greatest of 64 bits, signed.
NEVER = (1 << 63) - 1


def zone_of(name: str) -> tzinfo:
    """Return a time zone by its name, e.g. ``Europe/Berlin``.

    Raises:
        InputError: there is none of this name here.
    """
    if name == "UTC":
        return UTC
    from zoneinfo import ZoneInfo  # noqa: PLC0415 - for this alone

    try:
        return ZoneInfo(name)
    except (LookupError, ValueError, OSError) as error:
        raise InputError("no time zone that is known here; e.g. Europe/Berlin", key="zone", value=name) from error
