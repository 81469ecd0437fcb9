"""Diagnostic trouble codes: text and three bytes (SAE J2012-DA, ISO 15031-6)."""

from __future__ import annotations

import re
from dataclasses import dataclass

from gateway_fdi.errors import InputError

_TEXT = re.compile(r"([PCBU])([0-3])([0-9A-F]{3})(?:-([0-9A-F]{2}))?")
_LETTERS = "PCBU"

#: Stands for "no DTC" in the all-clear form of the DTC frame.
NO_DTC = 0x000000
#: The group of all DTCs (ISO 14229-1, 0x14).
ALL_DTCS = 0xFFFFFF
#: The group of all emission related DTCs (ISO 14229-1, Annex D.1; ISO 27145-3, functional group 0x33).
EMISSION_DTCS = 0xFFFF33
#: The groups of the letters C, B, U: the first code of each. That of P would be 0x000000, which ISO 14229-1
#: reserves, and which scanners send to see what happens: it clears nothing.
LETTER_GROUPS = (0x400000, 0x800000, 0xC00000)


def is_group(value: int) -> bool:
    """Return whether a number names a group of DTCs, or may by the standards (0xFFFF00 and above)."""
    return value in LETTER_GROUPS or value >= 0xFFFF00


def in_group(value: int, group: int, *, emission_related: bool) -> bool:
    """Return whether a DTC belongs to a group, or is the one that is named."""
    if group == ALL_DTCS:
        return True
    if group == EMISSION_DTCS:
        return emission_related
    if group in LETTER_GROUPS:
        return value >> 22 == group >> 22
    return value == group


@dataclass(frozen=True, order=True)
class Dtc:
    """A DTC as UDS carries it: 24 bits, two of the base code and one of the failure type.

    Attributes:
        value: 0x000000 .. 0xFFFFFF.
    """

    value: int

    def __post_init__(self) -> None:
        if not 0 <= self.value <= 0xFFFFFF:
            raise InputError("a DTC has 24 bits", value=self.value)

    @classmethod
    def parse(cls, text: str) -> Dtc:
        """Read ``P0336-39``; without a failure type byte it is 00.

        Raises:
            InputError: it is not a DTC.
        """
        found = _TEXT.fullmatch(text.strip().upper())
        if found is None:
            raise InputError(
                "a DTC is a letter P, C, B or U, a digit 0 to 3, three hex digits, "
                'and "-" with a failure type byte of two: "P0336-39"',
                value=text,
            )
        letter, first, rest, failure = found.groups()
        base = (_LETTERS.index(letter) << 14) | (int(first) << 12) | int(rest, 16)
        return cls((base << 8) | int(failure or "00", 16))

    @property
    def is_powertrain(self) -> bool:
        """Whether its letter is P."""
        return self.value >> 22 == 0

    @classmethod
    def from_bytes(cls, data: bytes) -> Dtc:
        """Read three bytes, high byte first (ISO 14229-1, DTCHighByte first)."""
        if len(data) != 3:
            raise InputError("a DTC has three bytes", value=data.hex())
        return cls(int.from_bytes(data, "big"))

    def __bytes__(self) -> bytes:
        return self.value.to_bytes(3, "big")

    def __str__(self) -> str:
        base, failure = self.value >> 8, self.value & 0xFF
        return f"{_LETTERS[base >> 14]}{(base >> 12) & 3}{base & 0xFFF:03X}-{failure:02X}"
