"""A protection applied to many frames at once: the checksum each has, and the one it should have."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gateway.signals.protection.judge import FRAME_OK, judge_frame
from gateway.signals.protection.protection import Protection, compiled
from gateway_fdi.jit import kernel


@dataclass(frozen=True)
class Payloads:
    """Payloads of one message.

    Attributes:
        words: uint64, shape (frames, 8), zero beyond their lengths.
        lengths: int64, shape (frames,) [byte].
    """

    words: NDArray[np.uint64]
    lengths: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.words)

    def __getitem__(self, chosen: Any) -> Payloads:
        return Payloads(self.words[chosen], self.lengths[chosen])

    @property
    def bytes(self) -> NDArray[np.uint8]:
        """The payloads byte by byte, shape (frames, 64), of woven messages a multiple of it."""
        return np.ascontiguousarray(self.words).view(np.uint8).reshape(len(self), 8 * self.words.shape[1])


@kernel
def judge_all(words: Any, lengths: Any, p: Any, tables: Any, received: Any, computed: Any, good: Any) -> int:
    """Judge all frames; returns how many are right.

    Args:
        words: payloads, uint64, shape (frames, 8).
        lengths: int64, shape (frames,) [byte].
        p: record of :class:`gateway.signals.protection.protection.ProtectionConst`.
        tables: of the CRCs, uint64, shape (CRCs, 8, 256).
        received: uint64, shape (frames,), takes the checksums that the frames have.
        computed: uint64, shape (frames,), takes those that they should have.
        good: uint8, shape (frames,), takes 1 where checksum and constants are right.
    """
    count = 0
    for k in range(words.shape[0]):
        received[k], computed[k], verdict = judge_frame(words[k], lengths[k], p, tables)
        good[k] = 1 if verdict == FRAME_OK else 0
        count += good[k]
    return count


@dataclass(frozen=True)
class Judged:
    """Checksums of frames, as received and as computed, and which frames are right."""

    received: NDArray[np.uint64]
    computed: NDArray[np.uint64]
    good: NDArray[np.bool_]

    @property
    def difference(self) -> NDArray[np.uint64]:
        """Their difference by exclusive or."""
        return self.received ^ self.computed


def judged(payloads: Payloads, asked: Protection) -> Judged:
    """Judge payloads by a protection."""
    count = len(payloads)
    received, computed = np.zeros(count, np.uint64), np.zeros(count, np.uint64)
    good = np.zeros(count, np.uint8)
    judge_all(payloads.words, payloads.lengths, *compiled(asked), received, computed, good)
    return Judged(received, computed, good == 1)
