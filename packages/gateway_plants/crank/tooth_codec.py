"""Times between tooth pulses as 12-bit codes (CTW_PT4) and 16-bit codes (CTW_FD27).

A 12-bit code is a 2-bit range ``r`` above a 10-bit mantissa: ``mantissa << 2 r`` microseconds, up to 65.4 ms, at most
0.4 % coarse. An interval that a lower range holds is coded in that, so that mantissas below 256 of the highest range
are free: they carry the long ones, a 3-bit exponent ``x`` above a 5-bit mantissa ``m``, ``(32 + m) << (11 + x)``
microseconds, 65.5 ms to 16.5 s, at most 3.2 % coarse: an engine that cranks slowly shows no other in its gap. The
encoder codes the difference to the time already decoded, so that rounding errors do not add up; after a long code it
starts again.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gateway_fdi.jit import kernel

#: Fills up a frame that was sent before it was full.
PADDING_CODE = 0x000
#: An interval too long for any code: the engine stands.
OVERFLOW_CODE = 0xFFF
#: Longest interval of a 12-bit code [us], and of a long one.
LONGEST_US = 1022 << 6
LONGEST_LONG_US = 63 << 18
#: First long code, and how many there are.
_LONG, _LONGS = 0xC00, 256


@kernel
def period_us(code: int) -> float:
    """Return the interval of a 12-bit code [us]."""
    if _LONG <= code < _LONG + _LONGS:
        return float((32 + (code & 0x1F)) << (11 + ((code >> 5) & 7)))
    return float((code & 0x3FF) << (2 * (code >> 10)))


@kernel
def code_of(interval_us: float) -> int:
    """Return the 12-bit code of an interval [us]; OVERFLOW_CODE where it is too long."""
    for r in range(4):
        mantissa = int(np.rint(interval_us / (1 << (2 * r))))
        if mantissa <= (1023 if r < 3 else 1022):
            return (r << 10) | max(mantissa, 1 if r == 0 else 0)
    for x in range(8):
        mantissa = max(int(np.rint(interval_us / (1 << (11 + x)))), 32)
        if mantissa <= 63:
            return _LONG | (x << 5) | (mantissa - 32)
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
        # The error of a long code can be longer than the teeth after it: they would take it over.
        if codes[k] == OVERFLOW_CODE or _LONG <= codes[k] < _LONG + _LONGS:
            decoded = times_us[k + 1]
        else:
            decoded += period_us(codes[k])
