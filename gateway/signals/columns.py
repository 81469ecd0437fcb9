"""Physical values into payloads, the reverse of :mod:`gateway.signals.decode`: one, or many frames at once."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gateway.signals.bits import mask_of, write_bits
from gateway.signals.decode import FLOAT16, FLOAT32, FLOAT64, SIGNED
from gateway_fdi.jit import kernel

#: Floating-point kinds of signals -> what NumPy calls their numbers, and their bits.
IEEE = {FLOAT16: ("<f2", "<u2"), FLOAT32: ("<f4", "<u4"), FLOAT64: ("<f8", "<u8")}


@kernel
def insert(words: Any, s: Any, value: float) -> None:
    """Put the value of one integer signal into a payload; its bits must be zero before.

    A value outside what the signal can carry becomes the nearest that it can; NaN becomes raw 0. ``words`` and ``s``
    are as of :func:`gateway.signals.bits.write_bits`.
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


@kernel
def insert_each(words: Any, s: Any, values: Any, there: Any) -> None:
    """Put a value of one integer signal into each payload that carries it; its bits must be zero before.

    Arguments as of :func:`put_column`.
    """
    for k in range(words.shape[0]):
        if there[k]:
            insert(words[k], s, values[k])


@kernel
def write_each(words: Any, s: Any, bits: Any, there: Any) -> None:
    """Put raw bits of one signal into each payload that carries it; arguments as of :func:`insert_each`."""
    for k in range(words.shape[0]):
        if there[k]:
            write_bits(words[k], s, bits[k])


def put_column(words: NDArray[np.uint64], s: Any, values: NDArray[np.float64], there: NDArray[np.bool_]) -> None:
    """Put a signal's values into payloads, over any bits.

    An integer signal takes the nearest value that it can carry.

    Args:
        words: payloads, shape (frames, 8).
        s: record of SIGNAL.
        values: physical values, shape (frames,).
        there: which frames carry the signal, shape (frames,).
    """
    row = s if hasattr(s, "word") else s.view(np.recarray)
    words[there] &= ~np.frombuffer(mask_of(row).to_bytes(64, "little"), "<u8")
    kind = IEEE.get(int(row.kind))
    if kind is None:
        insert_each(words, row, values, there)
        return
    number, bits = kind
    with np.errstate(over="ignore"):
        raw = ((values - row.offset) / row.scale).astype(number).view(bits).astype(np.uint64)
    write_each(words, row, raw, there)


def limits(s: Any) -> tuple[float, float]:
    """Return the lowest and highest physical value that a signal's bits (record of SIGNAL) can carry."""
    length = int(s["length"])
    if int(s["kind"]) in IEEE:
        return -np.inf, np.inf
    low, high = (-(1 << length - 1), (1 << length - 1) - 1) if int(s["kind"]) == SIGNED else (0, (1 << length) - 1)
    ends = [float(raw * s["scale"] + s["offset"]) for raw in (low, high)]
    return min(ends), max(ends)
