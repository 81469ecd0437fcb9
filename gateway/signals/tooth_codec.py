"""Times between tooth pulses as 12-bit codes (CTW_PT4) and 16-bit codes (CTW_FD27).

A 12-bit code is a 2-bit range ``r`` above a 10-bit mantissa: ``mantissa << 2 r`` microseconds, up to
65.4 ms, at most 0.4 % coarse. The encoder codes the difference to the time already decoded, so that
rounding errors do not add up.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gateway.jit import kernel

#: Fills up a frame that was sent before it was full.
PADDING_CODE = 0x000
#: An interval too long to code: the engine stands.
OVERFLOW_CODE = 0xFFF
#: Longest interval of a 12-bit code [us].
LONGEST_US = 1022 << 6


@kernel
def period_us(code: int) -> float:
    """Return the interval of a 12-bit code [us]."""
    return float((code & 0x3FF) << (2 * (code >> 10)))


@kernel
def code_of(interval_us: float) -> int:
    """Return the 12-bit code of an interval [us]; OVERFLOW_CODE where it is too long."""
    for r in range(4):
        mantissa = int(np.rint(interval_us / (1 << (2 * r))))
        if mantissa <= (1023 if r < 3 else 1022):
            return (r << 10) | max(mantissa, 1 if r == 0 else 0)
    return OVERFLOW_CODE


@kernel
def encode_intervals(times_us: NDArray[np.float64], codes: NDArray[np.int64]) -> None:
    """Code the intervals of a pulse train.

    Args:
        times_us: shape (n + 1,), pulse times [us].
        codes: shape (n,), takes the codes.
    """
    decoded = times_us[0]
    for k in range(codes.shape[0]):
        codes[k] = code_of(times_us[k + 1] - decoded)
        if codes[k] == OVERFLOW_CODE:
            decoded = times_us[k + 1]
        else:
            decoded += period_us(codes[k])
