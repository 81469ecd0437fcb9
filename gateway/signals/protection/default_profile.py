"""How the gateway protects its own messages and its virtual ECUs: CRC8 over payload and identifier, counter."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gateway.signals.bits import field_of
from gateway.signals.protection.checksum import Checksum
from gateway.signals.protection.crc import KNOWN
from gateway.signals.protection.protection import Counter, Protection, compiled
from gateway_fdi.errors import InputError

if TYPE_CHECKING:
    from cantools.database.can import Message

#: Signals that are filled, where a message has them.
COUNTER, CRC = "FrameCnt", "Crc"


def own_protection(message: Message, *, crc: str = CRC, counter: str | None = COUNTER) -> Protection:
    """Return the protection of a message by its signals' names; none where it has no such signals.

    Args:
        message: of the gateway's own databases, or of a virtual ECU.
        crc: name of the CRC's signal.
        counter: name of the counter's signal, None: it is none of the protection's.

    Raises:
        InputError: a CRC that has not 8 bits on a byte boundary.
    """
    signals = {signal.name: signal for signal in message.signals}
    checksum = field = alive = None
    if crc in signals:
        signal = signals[crc]
        edge = 7 if signal.byte_order == "big_endian" else 0
        if signal.length != 8 or signal.start % 8 != edge:
            raise InputError(
                "a CRC signal has 8 bits on a byte boundary",
                key=f"{message.name}.{crc}",
                value=f"start {signal.start}, length {signal.length}",
            )
        data_id = message.frame_id & 0xFF, message.frame_id >> 8 & 0xFF
        checksum, field = Checksum(KNOWN["crc8_sae_j1850"], after=data_id), field_of(signal)
    if counter is not None and counter in signals:
        alive = Counter(field_of(signals[counter]), 1 << signals[counter].length)
    return Protection(checksum, field, alive)


@cache
def prepared(message: Message, crc: str, counter: str | None) -> tuple[Any, NDArray[np.uint64]]:
    """Return what the kernel ``protect`` wants of a message: its record, and the tables of the CRCs."""
    return compiled(own_protection(message, crc=crc, counter=counter))
