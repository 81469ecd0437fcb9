"""Columns of physical values into payloads: many frames of one message at once."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gateway.signals.bits import mask_of, write_bits
from gateway.signals.decode import FLOAT16, FLOAT32, FLOAT64, SIGNED
from gateway.signals.encode import insert
from gateway_fdi.jit import kernel

#: Floating-point kinds of signals -> what NumPy calls their numbers, and their bits.
IEEE = {FLOAT16: ("<f2", "<u2"), FLOAT32: ("<f4", "<u4"), FLOAT64: ("<f8", "<u8")}


@kernel
def insert_each(words: Any, s: Any, values: Any, there: Any) -> None:
    """Put a value of one integer signal into each payload that carries it; its bits must be zero before.

    Args:
        words: payloads, uint64, shape (frames, 8).
        s: record of SIGNAL.
        values: physical values, float64, shape (frames,).
        there: which frames carry the signal, bool, shape (frames,).
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
    """Return the lowest and highest physical value that a signal's bits can carry.

    Args:
        s: record of SIGNAL.
    """
    length = int(s["length"])
    if int(s["kind"]) in IEEE:
        return -np.inf, np.inf
    low, high = (-(1 << length - 1), (1 << length - 1) - 1) if int(s["kind"]) == SIGNED else (0, (1 << length) - 1)
    ends = [float(raw * s["scale"] + s["offset"]) for raw in (low, high)]
    return min(ends), max(ends)
