"""A protection that frames have, as a configuration says it, with what proves it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from cantools.database.can import Message
from numpy.typing import NDArray
from scipy.special import gammaln

from gateway.signals.bits import mask_of
from gateway.signals.payloads import bits_of
from gateway.signals.protection.params import CHECKSUMS, ProtectionParams, protection_for
from gateway.signals.protection.protection import Protection
from gateway.signals.protection.rules import RULES
from gateway_fdi.errors import InputError
from gateway_fleet.learn.counters import LEAST_EVIDENCE
from gateway_fleet.learn.protection_check import Payloads, judged

#: Frames whose bits are turned, one at a time, to see what a rule covers.
TURNED = 4
#: Share of the pairs that must be right: the bus may have disturbed a frame that the recorder kept.
RIGHT = 0.99


@dataclass(frozen=True)
class Claim:
    """A protection that the frames of a message have.

    Attributes:
        keys: as a configuration has them, of [[bus.check]].
        protection: made of them.
        frames: that were looked at and not used to find it.
        matched: of these.
        note: for people: its uncertain parts; "" none.
    """

    keys: Mapping[str, Any]
    protection: Protection
    frames: int
    matched: int
    note: str = ""

    @property
    def maker(self) -> str:
        """Name of the carmaker's rule that it is; "": it is none."""
        rule = str(self.keys.get("checksum", {}).get("rule", ""))
        return rule if rule in RULES else ""


def called_checksum(name: str) -> bool:
    """Return whether a signal is called as checksums are."""
    called = name.upper()
    return called.rstrip("0123456789_").endswith(CHECKSUMS) or "CHECKSUM" in called or called.startswith("CRC_")


def fitting(message: Message, keys: Mapping[str, Any]) -> Protection | None:
    """Return the protection of keys of [[bus.check]], None where they do not fit the message."""
    try:
        return protection_for(message, ProtectionParams.model_validate(dict(keys)))
    except InputError:
        return None


def covered(payloads: Payloads, asked: Protection, length: int) -> NDArray[np.uint64]:
    """Return the bits of a payload that a checksum covers, uint64, shape (8,).

    They are found by turning each: only what changes the computed checksum goes in.

    Args:
        payloads: frames of the message.
        asked: the protection.
        length: of the message [byte].
    """
    mask = np.zeros(8, np.uint64)
    turned = np.zeros((8 * length, 8), np.uint64)
    for bit in range(8 * length):
        turned[bit, bit // 64] = np.uint64(1) << np.uint64(bit % 64)
    for k in np.unique(np.linspace(0, len(payloads) - 1, TURNED).astype(np.int64)):
        lengths = np.full(8 * length, payloads.lengths[k])
        plain = judged(payloads[k : k + 1], asked).computed[0]
        moved = judged(Payloads(payloads.words[k] ^ turned, lengths), asked).computed != plain
        mask |= np.bitwise_or.reduce(turned[moved], axis=0, initial=np.uint64(0))
    return mask & ~owned(asked.field)


def distinct_pairs(payloads: Payloads, asked: Protection, mask: NDArray[np.uint64]) -> NDArray[np.intp]:
    """Return one frame for each pair of what is covered and its checksum: frames that repeat a pair say nothing new."""
    both = payloads.words & (mask | owned(asked.field))
    _, places = np.unique(both, axis=0, return_index=True)
    return np.sort(places)


def evidence(pairs: Payloads, asked: Protection, free_bits: int, hypotheses: int, *, called: bool) -> float:
    """Return how much more distinct pairs say for a protection than was free to be chosen [bit].

    Chance is a permutation: the same checksums, dealt out to what they cover in any order. All are right in one of
    n! / (n1! n2! ...) orders, n1, n2 being how often each value comes (Fisher's exact test); so a field that hardly
    changes proves little, however many frames there are. A field that is known to be a checksum before a frame is seen
    says its width for each of its values.

    Args:
        pairs: a frame for each pair.
        asked: the protection.
        free_bits: chosen so that frames fit [bit].
        hypotheses: how many others were tried.
        called: the database calls the field a checksum.
    """
    width = int(asked.field["length"])
    _, counts = np.unique(bits_of(pairs.words, asked.field), return_counts=True)
    orders = (gammaln(len(pairs) + 1) - gammaln(counts + 1).sum()) / np.log(2.0)
    said = min(width * len(pairs), float(orders))
    if called:
        said = max(said, float(width * len(counts)))
    return float(said - free_bits - np.log2(max(hypotheses, 1)))


def _copies(pairs: Payloads, mask: NDArray[np.uint64], width: int) -> bool:
    """Return whether one byte alone may say what is taken for a checksum: a copy of it, not a sum.

    A table of as many constants as that byte has values would explain the frames; only evidence beyond it counts.
    """
    bytes_ = Payloads(pairs.words & mask, pairs.lengths).bytes
    most = max(len(np.unique(bytes_[:, k])) for k in range(bytes_.shape[1]))
    return bool(width * (len(pairs) - most) < LEAST_EVIDENCE)


def owned(field: Any) -> NDArray[np.uint64]:
    """Return the bits of a payload that are a field's, uint64, shape (8,)."""
    return np.frombuffer(mask_of(field).to_bytes(64, "little"), "<u8")


def proven(
    message: Message,
    keys: Mapping[str, Any],
    proof: Payloads,
    *,
    free_bits: int = 0,
    hypotheses: int = 1,
    note: str = "",
) -> Claim | None:
    """Return a claim if frames prove it.

    Args:
        message: of the frames.
        keys: of the protection, as a configuration has them.
        proof: frames that were not used to choose ``free_bits``; a rule without a constant may be proven by all frames.
        free_bits: chosen so that other frames fit [bit].
        hypotheses: how many others were tried.
        note: see :class:`Claim`.
    """
    asked = protection_for(message, ProtectionParams.model_validate(dict(keys)))
    if not len(proof):
        return None
    called = any(called_checksum(str(part.get("signal", ""))) for part in keys.values() if isinstance(part, Mapping))
    mask = covered(proof, asked, message.length)
    pairs = proof[distinct_pairs(proof, asked, mask)]
    if evidence(pairs, asked, free_bits, hypotheses, called=called) < LEAST_EVIDENCE:
        return None
    if not called and "e2e" not in keys:  # a profile says itself what it covers
        changing = np.bitwise_or.reduce(proof.words ^ proof.words[0], axis=0)
        if (changing & ~(mask | owned(asked.field))).any() or _copies(pairs, mask, int(asked.field["length"])):
            return None
    good = judged(proof, asked).good
    if good.mean() < RIGHT or judged(pairs, asked).good.mean() < RIGHT:
        return None
    return Claim(keys, asked, len(proof), int(good.sum()), note)
