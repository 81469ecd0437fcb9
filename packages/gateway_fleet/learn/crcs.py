"""CRCs of any polynomial: recovered from what frames differ in, with what is constant or goes in by the counter.

Bytes after the payload, a data id or the byte of the counter's value, are the same for the frames compared, and shift
their difference by their bits: so zero bytes in its place are tried.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from cantools.database.can import Message
from cantools.database.can.signal import Signal
from numpy.typing import NDArray

from gateway.signals.bits import field_of, mask_of
from gateway.signals.payloads import bits_of
from gateway.signals.protection.checksum import LIST
from gateway_fleet.learn.claims import fitting
from gateway_fleet.learn.counters import CounterFound, signal_of
from gateway_fleet.learn.polynomials import polynomial_of, solved
from gateway_fleet.learn.protection_check import Payloads, judged

Keys = dict[str, Any]

#: Frames that a polynomial is looked for in, at least; bytes that may go in after the payload.
LEAST_FRAMES, MOST_AFTER = 12, 2


def crcs(
    message: Message,
    signal: Signal,
    counter: CounterFound | None,
    frames: Payloads,
    ranges: Iterable[Mapping[str, Any]],
) -> Iterator[tuple[Keys, int]]:
    """Yield CRCs that fit the frames, and the bits that were free to be chosen for them [bit].

    Args:
        message: of the frames.
        signal: of the CRC.
        counter: of the message.
        frames: different ones.
        ranges: bytes that the CRC may cover, as keys of a configuration.
    """
    checksums = bits_of(frames.words, field_of(signal))
    same = np.arange(len(frames))
    groups = [(same, after) for after in range(MOST_AFTER + 1)]
    if counter is not None:  # frames of one value: the byte by the counter is the same for them
        values = bits_of(frames.words, field_of(signal_of(message, counter)))
        each, count = np.unique(values, return_counts=True)
        groups.append((np.flatnonzero(values == each[count.argmax()]), 1))
    for over in ranges:
        covered = _covered(message, signal, frames, over)
        for refin in (False, True):
            for refout in (False, True):
                for group, after in groups:
                    if len(group) < LEAST_FRAMES:
                        continue
                    zeros = np.zeros((len(group), after), np.uint8)
                    rows = np.concatenate([covered[group], zeros], axis=1)
                    sums = [int(checksum) for checksum in checksums[group]]
                    poly = polynomial_of(rows, sums, signal.length, refin=refin, refout=refout)
                    if poly is not None:
                        crc = {"signal": signal.name, "width": signal.length, "poly": poly, **over}
                        crc |= {"refin": True} if refin else {}
                        crc |= {"refout": True} if refout else {}
                        yield from _constants(message, crc, after, counter, frames)


def _covered(message: Message, signal: Signal, frames: Payloads, over: Mapping[str, Any]) -> NDArray[np.uint8]:
    """Return the bytes that go in, those without the checksum's own bits; its whole bytes are left out."""
    own = mask_of(field_of(signal))
    first, last = over.get("over", (0, message.length))
    whole = frames.bytes[:, : message.length].copy()
    kept = []
    for k in range(first, last):
        part = own >> (8 * k) & 0xFF
        whole[:, k] &= 0xFF & ~part
        if part != 0xFF:
            kept.append(k)
    return whole[:, kept]


def _constants(
    message: Message, crc: Keys, after: int, counter: CounterFound | None, frames: Payloads
) -> Iterator[tuple[Keys, int]]:
    """Yield a CRC with the constant, or the list by the counter's value, that makes it that of the frames."""
    width = int(crc["width"])
    behind = {} if not after else {"data_id": {"bytes": [0] * after, "place": "after"}}
    asked = fitting(message, {"crc": crc | behind})
    if asked is None:
        return
    difference = judged(frames, asked).difference
    if (difference == difference[0]).all():
        constant = int(difference[0])
        yield {"crc": crc | behind | ({"xorout": constant} if constant else {})}, 2 * width + 16
        return
    if after != 1 or counter is None or counter.first + counter.modulus > LIST:
        return
    found = _by_counter(message, crc, counter, frames)
    if found is not None:
        listed, constant = found
        alive = counter.keys(signal_of(message, counter).length)
        by_counter = crc | {"data_id": {"bytes": listed, "place": "by_counter"}}
        yield {"crc": by_counter | ({"xorout": constant} if constant else {}), "counter": alive}, 2 * width + 8 * LIST


def _by_counter(
    message: Message, crc: Keys, counter: CounterFound, frames: Payloads
) -> tuple[Sequence[int], int] | None:
    """Return the byte that goes in for each value of the counter, and the constant; None where there are none.

    The common part of all bytes and the constant cannot be told apart: the first byte is called 0.
    """
    plain = {"signal": counter.signal}
    values = bits_of(frames.words, field_of(signal_of(message, counter)))

    def difference(byte: int, some: Payloads) -> NDArray[np.uint64]:
        keys = {"crc": crc | {"data_id": {"bytes": [byte] * LIST, "place": "by_counter"}}, "counter": plain}
        asked = fitting(message, keys)
        assert asked is not None
        return judged(some, asked).difference

    constant: int | None = None
    listed = []
    for value in range(LIST):
        mine = frames[values == value]
        if not len(mine):
            if counter.first <= value < counter.first + counter.modulus:
                return None  # a value that it has, and that never came: nothing is known of its byte
            listed.append(0)
            continue
        zero = difference(0, mine)
        if (zero != zero[0]).any():
            return None
        constant = int(zero[0]) if constant is None else constant
        images = [int(difference(1 << k, mine[:1])[0] ^ zero[0]) for k in range(8)]
        byte = solved(images, int(zero[0]) ^ constant)
        if byte is None:
            return None
        listed.append(byte)
    return listed, constant or 0
