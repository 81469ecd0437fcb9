"""Payloads into columns of physical values: many frames of one message at once, through the engine's own decoder."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gateway.bus.frames import ERROR, FRAME, MORE, REMOTE, Frames
from gateway.signals.bits import read_bits
from gateway.signals.decode import FLOAT16, OK, decode, lookup
from gateway.signals.tables import DecodePlan
from gateway_fdi.jit import kernel


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
    there: Any,
    results: Any,
) -> int:
    """Decode all frames of one message, as :func:`gateway.signals.decode.decode` does one; returns how many are OK.

    ``words`` and ``lengths`` have a row a frame; ``values`` and ``present`` are scratch for one. ``out`` (float64) and
    ``there`` (uint8, 0 on entry), shape (signals of the message, frames), take what is in each frame, and whether it
    is; ``results`` (uint8) takes what became of each: OK, TOO_SHORT, UNKNOWN_MUX.
    """
    good = 0
    count = messages[row].count
    for k in range(words.shape[0]):
        result = decode(words[k], lengths[k], row, messages, signals, mux_ids, values, present)
        results[k] = result
        good += result == OK
        for j in range(count):
            if present[j] == 1:
                out[j, k] = values[j]
                there[j, k] = 1
    return good


@kernel
def rows_of(cells: Any, keys: Any, rows: Any, out: Any) -> int:
    """Look up the message of each frame by the keys and rows of a decode plan; returns how many have one.

    ``cells`` are the frames as 64-bit words, shape (frames, 10). ``out``, int16, shape (frames,), takes the row of each
    frame's message, -1: foreign, a remote or error frame.
    """
    found = 0
    for k in range(cells.shape[0]):
        can_id = np.int64(cells[k, 1] & np.uint64(0xFFFFFFFF))
        bus = np.int64((cells[k, 1] >> np.uint64(32)) & np.uint64(0xFF))
        out[k] = -1
        if (can_id & REMOTE == 0) == (can_id & ERROR == 0):  # neither, or woven
            out[k] = lookup(keys, rows, bus, can_id)  # type: ignore[arg-type]
        if out[k] >= 0:
            found += 1
    return found


@kernel
def read_all(words: Any, field: Any, out: Any) -> int:
    """Read a field of all payloads, uint64, shape (frames, 8), into ``out``, uint64, shape (frames,)."""
    for k in range(words.shape[0]):
        out[k] = read_bits(words[k], field)
    return int(words.shape[0])


def words_of(frames: Frames) -> NDArray[np.uint64]:
    """Return the payloads as the kernels want them, shape (frames, 8)."""
    return np.ascontiguousarray(frames["data"]).view("<u8").reshape(len(frames), 8)


def are_last(frames: Frames) -> NDArray[np.bool_]:
    """Return which frames end a message, shape (n,): all but those of a woven one that goes on in the next frame."""
    return np.asarray(frames["flags"] & MORE == 0, np.bool_)


def payloads_of(frames: Frames, plan: DecodePlan, row: int) -> tuple[NDArray[np.uint64], NDArray[np.int64]]:
    """Return the payloads of one message, shape (messages, words), zero beyond their lengths, and these [byte].

    Of a woven message all frames that belong together are to be there.
    """
    words, lengths, parts = words_of(frames), frames["length"].astype(np.int64), plan.parts(row)
    if parts == 1:
        return words, lengths
    ends = np.flatnonzero(are_last(frames))
    begins = np.concatenate([[0], ends[:-1] + 1]).astype(np.intp)[: len(ends)]
    of = np.repeat(np.arange(len(ends)), ends - begins + 1)
    made = np.zeros((len(ends), parts, 8), np.uint64)
    made[of, np.arange(len(of)) - begins[of]] = words[: len(of)]
    return made.reshape(len(ends), 8 * parts), lengths[ends] + 64 * (ends - begins)


class Columns(NamedTuple):
    """Signals of frames of one message.

    Attributes:
        values: physical values, shape (signals, frames), in the plan's order; any number where there is none.
        there: whether a frame has them, shape (signals, frames).
        results: OK, TOO_SHORT or UNKNOWN_MUX (``signals.decode``), shape (frames,).
        words: the payloads, shape (frames, 8), of more than 64 bytes (frames, words).
    """

    values: NDArray[np.float64]
    there: NDArray[np.bool_]
    results: NDArray[np.uint8]
    words: NDArray[np.uint64]


def decode_columns(frames: Frames, plan: DecodePlan, row: int) -> Columns:
    """Decode frames of one message by a plan of all its signals; of a woven one all that :func:`payloads_of` joins."""
    return decode_payloads(*payloads_of(frames, plan, row), plan, row)


def decode_payloads(words: NDArray[np.uint64], lengths: NDArray[np.int64], plan: DecodePlan, row: int) -> Columns:
    """Decode payloads of one message, as :func:`payloads_of` has them; else as above."""
    count, frames = int(plan.messages[row]["count"]), len(words)
    values, present = np.zeros(max(count, 1)), np.zeros(max(count, 1), np.uint8)
    out, there = np.zeros((count, frames)), np.zeros((count, frames), np.uint8)
    results = np.zeros(frames, np.uint8)
    decode_all(words, lengths, row, plan.messages, plan.signals, plan.mux_ids, values, present, out, there, results)
    return Columns(out, there.view(np.bool_), results, words)


def message_rows(frames: Frames, plan: DecodePlan) -> NDArray[np.int16]:
    """Return the row of each frame's message in a plan, -1: it has none; shape (frames,)."""
    return looked_up(frames, plan.keys, plan.rows)


def among(frames: Frames, plan: DecodePlan, slots: Sequence[int]) -> NDArray[np.bool_]:
    """Return which frames are of the messages of some mailbox slots, shape (n,)."""
    return np.isin(message_rows(frames, plan), plan.slot_message[np.asarray(slots, np.intp)])


def looked_up(frames: Frames, keys: NDArray[np.uint64], rows: NDArray[np.int32]) -> NDArray[np.int16]:
    """Return the row of each frame in a table of keys, as ``rows_of`` has it; shape (frames,)."""
    frames = np.ascontiguousarray(frames)
    out = np.zeros(len(frames), np.int16)
    rows_of(frames.view(np.uint64).reshape(len(frames), FRAME.itemsize // 8), keys, rows, out)
    return out


def columns(frames: Frames, plan: DecodePlan, row: int) -> NDArray[np.float64]:
    """Return the physical values of a message's signals in its frames, by a plan with all of them.

    Returns:
        shape (frames, signals), in the plan's order; NaN where a frame has none, or one without a value.
    """
    return valued(decode_columns(frames, plan, row), plan, row)


def valued(found: Columns, plan: DecodePlan, row: int) -> NDArray[np.float64]:
    """Return what was decoded as :func:`columns` does."""
    found.values[~found.there] = np.nan
    first, count = int(plan.messages[row]["first"]), len(found.values)
    for values, signal in zip(found.values, plan.signals[first : first + count], strict=True):
        if signal["kind"] >= FLOAT16:
            values[~((values >= signal["low"]) & (values <= signal["high"]))] = np.nan
    return np.ascontiguousarray(found.values.T)


def bits_of(words: NDArray[np.uint64], field: Any) -> NDArray[np.uint64]:
    """Return the raw bits of a field of all payloads, shape (frames,)."""
    out = np.zeros(len(words), np.uint64)
    read_all(words, field.view(np.recarray) if not hasattr(field, "word") else field, out)
    return out
