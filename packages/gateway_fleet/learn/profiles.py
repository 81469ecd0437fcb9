"""AUTOSAR E2E profiles, and their data ids, found in frames.

A data id goes into a CRC linearly: the difference between the CRC of a frame and the one computed with id 0 is the same
for all frames, and a sum of the effects of each bit of the id. So the id is solved for, not searched.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np
from cantools.database.can import Message
from numpy.typing import NDArray

from gateway.signals.bits import field_at
from gateway.signals.payloads import bits_of
from gateway.signals.protection.checksum import LIST
from gateway.signals.protection.e2e import PROFILES
from gateway.signals.protection.params import ProtectionParams, protection_for
from gateway.signals.protection.protection import Protection
from gateway_fleet.learn.claims import Claim, proven
from gateway_fleet.learn.polynomials import solved
from gateway_fleet.learn.protection_check import Payloads, judged

Keys = dict[str, Any]


def e2e_claim(message: Message, found_with: Payloads, proof: Payloads) -> Claim | None:
    """Return the profile that frames of a message have, None if there is none.

    Args:
        message: whose frames all have its length.
        found_with: frames, one after the other.
        proof: others.
    """
    for keys, free_bits, note in _candidates(message, found_with):
        claim = proven(message, {"e2e": keys}, proof, free_bits=free_bits, hypotheses=1 << 10, note=note)
        if claim is not None:
            return claim
    return None


def _candidates(message: Message, frames: Payloads) -> Iterator[tuple[Keys, int, str]]:
    """Yield profiles with ids that fit the frames; the bits free to be chosen [bit]; their uncertain parts."""
    for name, profile in PROFILES.items():
        last = message.length - profile.header if profile.offset_may_differ else 0
        for offset in range(last + 1):
            if profile.header + offset > message.length:
                continue
            keys: Keys = {"profile": name} | ({"offset": offset} if offset else {})
            keys |= {"data_ids": [0] * LIST} if _SOLVE[name] is _list else {}
            found = _SOLVE[name](message, keys, frames) if _counts(_made(message, keys), frames) else None
            if found is not None:
                yield found


def _made(message: Message, keys: Mapping[str, Any]) -> Protection:
    return protection_for(message, ProtectionParams.model_validate({"e2e": dict(keys)}))


def _difference(message: Message, keys: Mapping[str, Any], frames: Payloads) -> NDArray[np.uint64]:
    return judged(frames, _made(message, keys)).difference


def _images(message: Message, keys: Keys, bits: int, frame: Payloads, set_id: Callable[[int], Keys]) -> list[int]:
    """Return what each bit of an id alone does to a frame's CRC."""
    zero = _difference(message, keys | set_id(0), frame)[0]
    return [int(_difference(message, keys | set_id(1 << k), frame)[0] ^ zero) for k in range(bits)]


def _one_id(message: Message, keys: Keys, frames: Payloads) -> tuple[Keys, int, str] | None:
    """Solve for one id of 16 bits: profiles 1 and 11 (both), 5, 6."""
    if keys["profile"] == "P06" and not _constant(frames, field_at(keys.get("offset", 0) + 2, 16, big=True), message):
        return None
    difference = _difference(message, keys, frames)
    if (difference != difference[0]).any():
        return _alternating(message, keys, frames) if keys["profile"] == "P01" else None
    images = _images(message, keys, 16, frames[:1], lambda value: {"data_id": value})
    data_id = solved(images, int(difference[0]))
    if data_id is None:
        return None
    same = 1 << (16 - _rank(images))
    note = f"one of {same} data ids that give these CRCs" if same > 1 else ""
    return keys | {"data_id": data_id}, 16, note


def _alternating(message: Message, keys: Keys, frames: Payloads) -> tuple[Keys, int, str] | None:
    """Solve for the two bytes of an id that take turns with the counter."""
    keys = keys | {"data_id_mode": "alternating"}
    counter = bits_of(frames.words, field_at(keys.get("offset", 0) + 1, 4))
    difference = _difference(message, keys, frames)
    halves = []
    for odd in (0, 1):
        mine = counter % 2 == odd
        if not mine.any() or (difference[mine] != difference[mine][0]).any():
            return None
        images = _images(message, keys, 8, frames[mine][:1], lambda byte: {"data_id": byte << 8 | byte})
        half = solved(images, int(difference[mine][0]))
        if half is None:
            return None
        halves.append(half)
    return keys | {"data_id": halves[1] << 8 | halves[0]}, 16, ""


def _list(message: Message, keys: Keys, frames: Payloads) -> tuple[Keys, int, str] | None:
    """Solve for the list of profiles 2 and 22, an id for each value of the counter."""
    counter = bits_of(frames.words, field_at(keys.get("offset", 0) + 1, 4))
    difference = _difference(message, keys, frames)
    ids = []
    for value in range(LIST):
        mine = counter == value
        if not mine.any() or (difference[mine] != difference[mine][0]).any():
            return None
        images = _images(message, keys, 8, frames[mine][:1], lambda byte: {"data_ids": [byte] * LIST})
        one = solved(images, int(difference[mine][0]))
        if one is None:
            return None
        ids.append(one)
    return keys | {"data_ids": ids}, 8 * LIST, ""


def _in_header(message: Message, keys: Keys, frames: Payloads) -> tuple[Keys, int, str] | None:
    """Read the id of profiles 4 and 7, which their headers carry beside the length."""
    offset = keys.get("offset", 0)
    first, at, bits = (0, 4, 16) if keys["profile"] == "P04" else (8, 16, 32)
    if not _constant(frames, field_at(offset + first, bits, big=True), message):
        return None
    ids = bits_of(frames.words, field_at(offset + at, 32, big=True))
    if (ids != ids[0]).any():
        return None
    return keys | {"data_id": int(ids[0])}, 32, ""


_SOLVE = {
    "P01": _one_id, "P02": _list, "P04": _in_header, "P05": _one_id, "P06": _one_id, "P07": _in_header, "P11": _one_id,
    "P22": _list,
}  # fmt: skip


def _constant(frames: Payloads, field: Any, message: Message) -> bool:
    """Return whether a header says the message's length in each frame."""
    return bool((bits_of(frames.words, field) == message.length).all())


def _rank(images: list[int]) -> int:
    kept: list[int] = []
    for image in images:
        if solved(kept, image) is None:
            kept.append(image)
    return len(kept)


def _counts(asked: Protection, frames: Payloads) -> bool:
    """Return whether the header's counter goes up by one from frame to frame, nearly always."""
    assert asked.counter is not None
    values = bits_of(frames.words, asked.counter.field).astype(np.int64)
    if (
        len(values) < 2
        or (values < asked.counter.first).any()
        or (values >= asked.counter.first + asked.counter.modulus).any()
    ):
        return False
    return bool((np.mod(np.diff(values), asked.counter.modulus) == 1).mean() > 0.5)
