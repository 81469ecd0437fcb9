"""A protection that frames have, as a configuration says it, with what proves it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from cantools.database.can import Message

from gateway.errors import InputError
from gateway.learn.judged import Payloads, judged
from gateway.signals.bits import mask_of
from gateway.signals.protection.params import ProtectionParams, protection_for
from gateway.signals.protection.protection import Protection

#: Evidence that a claim needs beyond what was free to be chosen [bit]: chance claims one in 10^12.
LEAST_EVIDENCE = 40
#: Least frames that a claim is proven on, none of which it was found with.
LEAST_PROOF = 16


@dataclass(frozen=True)
class Claim:
    """A protection that the frames of a message have.

    Attributes:
        keys: as a configuration has them, of [[bus.check]].
        protection: made of them.
        frames: that were looked at and not used to find it.
        matched: of these.
        note: for people: what is not sure about it; "" nothing.
    """

    keys: Mapping[str, Any]
    protection: Protection
    frames: int
    matched: int
    note: str = ""


def fitting(message: Message, keys: Mapping[str, Any]) -> Protection | None:
    """Return the protection of keys of [[bus.check]], None where they do not fit the message."""
    try:
        return protection_for(message, ProtectionParams.model_validate(dict(keys)))
    except InputError:
        return None


def evidence(payloads: Payloads, asked: Protection, free_bits: int, hypotheses: int) -> float:
    """Return how much more frames say for a protection than was free to be chosen [bit].

    Frames that are equal but for the checksum say the same thing once.
    """
    assert asked.checksum is not None
    width = int(asked.field["length"])
    cleared = payloads.words & ~owned_by_checksum(asked)
    different = len(np.unique(cleared, axis=0))
    return float(width * (different - 1) - free_bits - np.log2(max(hypotheses, 1)))


def owned_by_checksum(asked: Protection) -> Any:
    """Return the bits of a payload that are the checksum's, uint64, shape (8,)."""
    return np.frombuffer(mask_of(asked.field).to_bytes(64, "little"), "<u8")


def proven(
    message: Message,
    keys: Mapping[str, Any],
    proof: Payloads,
    *,
    free_bits: int = 0,
    hypotheses: int = 1,
    note: str = "",
) -> Claim | None:
    """Return a claim if frames that it was not found with prove it.

    Args:
        message: of the frames.
        keys: of the protection, as a configuration has them.
        proof: frames that were not used to find it.
        free_bits: what was chosen so that other frames fit [bit].
        hypotheses: how many others were tried.
        note: see :class:`Claim`.
    """
    asked = protection_for(message, ProtectionParams.model_validate(dict(keys)))
    if len(proof) < LEAST_PROOF or evidence(proof, asked, free_bits, hypotheses) < LEAST_EVIDENCE:
        return None
    good = int(judged(proof, asked).good.sum())
    # A frame that the bus disturbed and the recorder kept is no proof against it; one in a hundred is.
    if good < 0.99 * len(proof):
        return None
    return Claim(keys, asked, len(proof), good, note)
