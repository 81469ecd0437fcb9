"""Encode kernel: physical values into a payload, the reverse of :mod:`gateway.signals.decode`."""

from __future__ import annotations

from typing import Any

import numpy as np

from gateway.signals.bits import write_bits
from gateway.signals.decode import SIGNED
from gateway_fdi.jit import kernel


@kernel
def insert(words: Any, s: Any, value: float) -> None:
    """Put the value of one integer signal into a payload; its bits must be zero before.

    A value outside what the signal can carry becomes the nearest that it can; NaN becomes raw 0.

    Args:
        words: payload, 8 little-endian uint64.
        s: record of SIGNAL.
        value: physical value.
    """
    most = ~np.uint64(0) >> np.uint64(64 - s.length)
    low, high = 0.0, float(most)
    if s.kind == SIGNED:
        high = float(most >> np.uint64(1))
        low = -high - 1.0
    raw = np.rint((value - s.offset) / s.scale)
    if np.isnan(raw):
        raw = 0.0
    raw = min(max(raw, low), high)
    if raw < 0.0:
        bits = np.uint64(np.int64(raw))
    else:
        # 2^64 - 1 is not a float64: values that round up to 2^64 are the largest value.
        bits = np.uint64(raw) if raw < 2.0**64 else np.uint64(0xFFFFFFFFFFFFFFFF)
    write_bits(words, s, bits)
