"""Cyclic redundancy checks of 1 to 64 bits, by the parameters of the Rocksoft model (R. Williams, 1993)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Crc:
    """A cyclic redundancy check.

    Attributes:
        width: of the register [bit], 1 to 64.
        poly: without its highest term, most significant first.
        init: first value of the register, not reflected.
        refin: whether bytes go in with their least significant bit first.
        refout: whether the register is reflected at the end.
        xorout: applied at the end.
    """

    width: int
    poly: int
    init: int = 0
    refin: bool = False
    refout: bool = False
    xorout: int = 0


_ALL32, _ALL64 = (1 << 32) - 1, (1 << 64) - 1

#: By the names of the CRC catalogue, and by those that AUTOSAR gives them (Specification of CRC Routines).
KNOWN = {
    "crc8_sae_j1850": Crc(8, 0x1D, 0xFF, xorout=0xFF),
    "crc8_autosar": Crc(8, 0x2F, 0xFF, xorout=0xFF),
    "crc16_ccitt_false": Crc(16, 0x1021, 0xFFFF),
    "crc16_xmodem": Crc(16, 0x1021),
    "crc16_arc": Crc(16, 0x8005, 0, refin=True, refout=True),
    "crc32": Crc(32, 0x04C11DB7, _ALL32, refin=True, refout=True, xorout=_ALL32),
    "crc32_autosar": Crc(32, 0xF4ACFB13, _ALL32, refin=True, refout=True, xorout=_ALL32),
    "crc64_xz": Crc(64, 0x42F0E1EBA9EA3693, _ALL64, refin=True, refout=True, xorout=_ALL64),
}


def reflected(value: int, width: int) -> int:
    """Return a value with its ``width`` bits in reverse order."""
    return int(f"{value:0{width}b}"[::-1], 2)


@cache
def table_of(width: int, poly: int, refin: bool) -> NDArray[np.uint64]:
    """Return the tables that take a byte in, and one that 1 to 7 others follow, shape (8, 256).

    The register is right-aligned where bytes go in reflected, else left-aligned in 64 bits: so one kernel serves all
    widths, those below 8 bits too.
    """
    table = np.zeros((8, 256), np.uint64)
    for byte in range(256):
        if refin:
            register, divisor = byte, reflected(poly, width)
            for _ in range(8):
                register = (register >> 1) ^ (divisor if register & 1 else 0)
        else:
            register, divisor = byte << 56, poly << (64 - width)
            for _ in range(8):
                register = ((register << 1) & _ALL64) ^ (divisor if register >> 63 else 0)
        table[0, byte] = register
    for k in range(1, 8):
        before = table[k - 1]
        rest, out = (before >> 8, before & 0xFF) if refin else (before << 8, before >> 56)
        table[k] = rest ^ table[0, out]
    return table


def register_of(crc: Crc) -> int:
    """Return the first value of the register as the kernel keeps it."""
    return reflected(crc.init, crc.width) if crc.refin else crc.init << (64 - crc.width)
