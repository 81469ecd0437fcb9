"""CRC-8 of a payload, for the checks of received frames and for virtual ECUs alike."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gateway.jit import kernel


@dataclass(frozen=True)
class Algorithm:
    """Parameters of a CRC-8 without reflection."""

    polynomial: int
    init: int
    xorout: int


#: SAE J1850, and CRC8H2F of AUTOSAR's E2E profile 2.
ALGORITHMS = {
    "crc8_sae_j1850": Algorithm(0x1D, 0xFF, 0xFF),
    "crc8_autosar": Algorithm(0x2F, 0xFF, 0xFF),
}


def crc8_table(name: str) -> NDArray[np.uint8]:
    """Return the 256 byte table of an algorithm."""
    polynomial = ALGORITHMS[name].polynomial
    table = np.zeros(256, np.uint8)
    for value in range(256):
        register = value
        for _ in range(8):
            register = (register << 1) ^ (polynomial if register & 0x80 else 0)
        table[value] = register & 0xFF
    return table


@kernel
def crc8(words: Any, length: int, crc_byte: int, data_id: int, table: Any, init: int, xorout: int) -> int:
    """Return the CRC over a payload without its CRC byte, then the data id.

    Args:
        words: payload, 8 little-endian uint64.
        length: payload length [byte].
        crc_byte: place of the byte left out, -1 for none.
        data_id: 16 bits appended, low byte first; -1 for none.
        table: uint8, shape (256,).
        init: first value of the register.
        xorout: applied at the end.
    """
    register = np.int64(init)
    for k in range(length):
        if k != crc_byte:
            byte = np.int64((words[k >> 3] >> np.uint64((k & 7) * 8)) & np.uint64(0xFF))
            register = np.int64(table[register ^ byte])
    if data_id >= 0:
        register = np.int64(table[register ^ (data_id & 0xFF)])
        register = np.int64(table[register ^ (data_id >> 8)])
    return int(register ^ xorout)
