"""Freshness values of AUTOSAR SecOC: how a sender makes them, and which one a truncated value may stand for.

Three kinds. COUNTER: a number that each frame raises. SYNC: the message of the freshness master, trip counter and
reset counter, sent whole. SYNCED: trip, reset and message counter and the reset flag, the reset counter's lowest bits
(SWS_SecureOnboardCommunication, annex on freshness management; JASPAR): the message counter begins again with each
reset.

A value is kept as one unsigned number, its parts most significant first, so that later ones are greater.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from gateway.signals.bits import Field, read_bits
from gateway_fdi.jit import Record, i4, i8, kernel, means, u1, u8

COUNTER, SYNC, SYNCED = range(3)
#: Frames that a payload's truncated value is looked for among, by :func:`count_of`.
_AHEAD = 4096


@dataclasses.dataclass(frozen=True)
class Freshness:
    """The freshness value of a message: as :class:`FreshConst`; ``sync`` is the message with trip and reset counter."""

    kind: int = COUNTER
    bits: int = 0
    truncated: int = 0
    field: Any = None  # no truncated value is sent
    start: int = 0
    reset: int = 0
    flag: int = 0
    message: int = 0
    sync: str = ""
    attempts: int = dataclasses.field(default=0, repr=False)
    per_sync: int = dataclasses.field(default=1, repr=False)


class FreshConst(Record):
    """A message's freshness value as the kernels want it."""

    kind: u1 = means("COUNTER, SYNC or SYNCED")
    bits: u1 = means("of the whole value; 0: there is none", "bit")
    truncated: u1 = means("lowest bits that are sent", "bit")
    reset: u1 = means("of the reset counter", "bit")
    flag: u1 = means("of the reset flag", "bit")
    message: u1 = means("of the message counter", "bit")
    field: Field = means("where the truncated value lies")
    attempts: i4 = means("further values that are tried")
    start: u8 = means("first value; of SYNCED the first trip and reset counter")
    per_sync: i8 = means("frames that a virtual ECU sends between two resets")


def fill_freshness(row: Any, asked: Freshness) -> None:
    """Fill a record of :class:`FreshConst`, zeroed before."""
    for name in ("kind", "bits", "truncated", "reset", "flag", "message", "start", "attempts", "per_sync"):
        row[name] = getattr(asked, name)
    if asked.field is not None:
        row["field"] = asked.field


@kernel
def mask(bits: int) -> Any:
    """Return a number whose lowest bits are set, uint64."""
    if bits == 0:
        return np.uint64(0)
    return (~np.uint64(0)) >> np.uint64(64 - bits)


@kernel
def made_value(f: Any, count: int) -> Any:
    """Return the whole value, uint64, of a sender's next frame, by how many it has sent before."""
    if f.kind != SYNCED:
        return (np.uint64(f.start) + np.uint64(count)) & mask(int(f.bits))
    epoch = np.uint64(f.start) + np.uint64(count // f.per_sync)
    return (epoch << np.uint64(f.message + f.flag)) | within(f, epoch, np.uint64(count % f.per_sync + 1))


@kernel
def within(f: Any, epoch: Any, number: Any) -> Any:
    """Return the parts of a value of SYNCED below the reset counter: message counter and reset flag, uint64."""
    return ((number & mask(int(f.message))) << np.uint64(f.flag)) | (epoch & mask(int(f.flag)))


@kernel
def truncated_of(words: Any, f: Any) -> Any:
    """Return the truncated value in a payload, uint64; 0 where none is sent."""
    if f.truncated == 0:
        return np.uint64(0)
    return read_bits(words, f.field)


@kernel
def count_of(words: Any, f: Any, least: int) -> int:
    """Return how many frames a sender had sent before a payload: the first count from ``least`` on that fits it."""
    received, low = truncated_of(words, f), mask(int(f.truncated))
    for k in range(_AHEAD):
        if made_value(f, least + k) & low == received:
            return least + k
    return least


@kernel
def next_value(f: Any, received: Any, least: Any) -> Any:
    """Return the smallest whole value from ``least`` on that ends with a truncated one, uint64; less: there is none."""
    low = mask(int(f.truncated))
    value = (least & ~low) | received
    if value < least:
        value += low + np.uint64(1)
    return value
