"""Whether a frame is as its protection says: constants, checksum; the counter's step; the state machine over frames."""

from __future__ import annotations

from typing import Any

import numpy as np

from gateway.signals.bits import read_bits
from gateway.signals.protection.checksum import NOWHERE, checksum_of
from gateway.signals.protection.protection import counter_of, same_constants
from gateway_fdi.jit import kernel

#: FRAME_CONSTANT: the first constant of the header differs, FRAME_CONSTANT + 1: the second.
FRAME_OK, FRAME_CHECKSUM, FRAME_CONSTANT = range(3)


@kernel
def judge_frame(words: Any, length: int, p: Any, tables: Any) -> Any:
    """Compare a frame's checksum and constants with what they should be.

    Args:
        words: payload, 8 little-endian uint64, zero beyond its length.
        length: payload length [byte].
        p: record of :class:`gateway.signals.protection.protection.ProtectionConst`.
        tables: of the CRCs, uint64, shape (CRCs, 8, 256).

    Returns:
        the checksum received and the one computed, uint64, and FRAME_OK or FRAME_CHECKSUM; or, where the checksum is
        right, the constant received and the one expected, and FRAME_CONSTANT + its place in the header.
    """
    received = computed = np.uint64(0)
    verdict = FRAME_OK
    if p.has_checksum == 1:
        received = read_bits(words, p.field)
        counter = counter_of(words, p) if p.checksum.listed != NOWHERE else 0
        computed = checksum_of(words, length, counter, p.checksum, tables)
        if received != computed:
            verdict = FRAME_CHECKSUM
    if verdict == FRAME_OK and p.constants > 0 and not same_constants(words, p):
        for k in range(p.constants):
            received, computed = read_bits(words, p.header[k]), p.expected[k]
            if received != computed:
                return received, computed, FRAME_CONSTANT + k
    return received, computed, verdict
