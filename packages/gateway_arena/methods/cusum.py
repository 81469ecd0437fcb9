"""A CUSUM over any statistic, which methods share; and samples without those at which a record begins."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gateway_arena.contract import SETTLE, Array, Record
from gateway_fdi import Cusum

#: The CUSUM of :mod:`gateway_fdi.cusum` is cut off at some J; scores are to be compared beyond.
_FAR = 1e9


def settled(values: Array) -> Array:
    """Return the samples of a record's values behind its beginning."""
    return values[SETTLE:]


def joined(records: Sequence[Record]) -> Array:
    """Return the samples of all records behind their beginnings, shape (samples, knowns)."""
    return np.concatenate([settled(record.values) for record in records])


def summed(values: Array, window: int) -> Array:
    """Return the sums of the last samples up to each, shape (n, columns)."""
    sums, end = np.vstack([np.zeros(values.shape[1]), values.cumsum(0)]), np.arange(1, len(values) + 1)
    return np.asarray(sums[end] - sums[np.maximum(end - window, 0)])


class Accumulated:
    """CUSUM of a statistic, as learned from healthy records, for any number of runs.

    Args:
        healthy: the statistic in healthy records, each of shape (n,), their beginnings included.

    Attributes:
        most: T over J at which the sum is cut off is some times this.
    """

    def __init__(self, healthy: Sequence[Array]) -> None:
        learned = Cusum.learned(np.concatenate([settled(each) for each in healthy]) + 1e-12)
        self._nu, self._threshold, self.most = learned.nu, learned.threshold, _FAR
        self.reset()

    def reset(self) -> None:
        """Begin a record."""
        self._rule, self._done = Cusum(self._nu, self._threshold * self.most), 0

    def __getstate__(self) -> tuple[float, float]:
        return self._nu, self._threshold

    def __setstate__(self, kept: tuple[float, float]) -> None:
        self._nu, self._threshold, self.most = *kept, _FAR
        self.reset()

    def feed(self, statistic: Array) -> Array:
        """Return T over J of the next samples, shape (n,); 0 until a record is settled."""
        early = min(max(SETTLE - self._done, 0), len(statistic))
        self._done += len(statistic)
        values = np.nan_to_num(statistic[early:], nan=np.inf, posinf=1e300, neginf=-1e300)
        sums = self._rule.run(np.minimum(np.abs(values), 1e6 * self._threshold)) * self.most
        return np.concatenate([np.zeros(early), sums])

    def run(self, statistic: Array) -> Array:
        """Return T over J of a record's samples, shape (n,)."""
        self.reset()
        return self.feed(statistic)
