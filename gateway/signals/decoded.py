"""All signals of many frames of one message at once, through the decoder that the engine has."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gateway.bus.frames import Frames
from gateway.jit import kernel
from gateway.signals.bits import read_bits
from gateway.signals.decode import OK, decode
from gateway.signals.tables import DecodePlan


@kernel
def decode_all(
    words: Any,
    lengths: Any,
    row: int,
    messages: Any,
    signals: Any,
    mux_ids: Any,
    values: Any,
    present: Any,
    out: Any,
) -> int:
    """Decode all frames of one message.

    Args:
        words: payloads, uint64, shape (frames, 8), zero beyond their lengths.
        lengths: int64, shape (frames,) [byte].
        row: of the message.
        messages: shape (messages,) of MESSAGE.
        signals: shape (signals,) of SIGNAL.
        mux_ids: int64, the multiplexer values of all signals.
        values: float64, scratch for one frame.
        present: uint8, scratch for one frame.
        out: float64, shape (frames, signals of the message), NaN on entry; takes what is in each frame.

    Returns:
        how many frames could be decoded.
    """
    good = 0
    count = messages[row].count
    for k in range(words.shape[0]):
        if decode(words[k], lengths[k], row, messages, signals, mux_ids, values, present) == OK:
            good += 1
            for j in range(count):
                if present[j] == 1:
                    out[k, j] = values[j]
    return good


@kernel
def read_all(words: Any, field: Any, out: Any) -> int:
    """Read a field of all payloads, uint64, shape (frames, 8), into ``out``, uint64, shape (frames,)."""
    for k in range(words.shape[0]):
        out[k] = read_bits(words[k], field)
    return int(words.shape[0])


def words_of(frames: Frames) -> NDArray[np.uint64]:
    """Return the payloads as the kernels want them, shape (frames, 8)."""
    return np.ascontiguousarray(frames["data"]).view("<u8").reshape(len(frames), 8)


def columns(frames: Frames, plan: DecodePlan, row: int) -> tuple[NDArray[np.float64], int]:
    """Return the physical values of a message's signals, and how many frames could be decoded.

    Args:
        frames: of this message.
        plan: with all its signals.
        row: of the message in the plan.

    Returns:
        shape (frames, signals), in the plan's order; NaN where a frame has no such signal, or cannot be decoded.
    """
    count = int(plan.messages[row]["count"])
    values, present = np.zeros(max(count, 1)), np.zeros(max(count, 1), np.uint8)
    out = np.full((len(frames), count), np.nan)
    lengths = frames["length"].astype(np.int64)
    good = decode_all(words_of(frames), lengths, row, plan.messages, plan.signals, plan.mux_ids, values, present, out)
    return out, int(good)


def bits_of(words: NDArray[np.uint64], field: Any) -> NDArray[np.uint64]:
    """Return the raw bits of a field of all payloads, shape (frames,)."""
    out = np.zeros(len(words), np.uint64)
    read_all(words, field.view(np.recarray) if not hasattr(field, "word") else field, out)
    return out
