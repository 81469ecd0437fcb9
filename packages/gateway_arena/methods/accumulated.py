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


class Accumulated:
    """CUSUM of a statistic, as learned from healthy records, for any number of runs.

    Args:
        healthy: the statistic in healthy records, each of shape (n,), their beginnings included.
    """

    def __init__(self, healthy: Sequence[Array]) -> None:
        values = np.concatenate([settled(each) for each in healthy])
        self._cusum = Cusum.learned(values + 1e-12)

    def run(self, statistic: Array) -> Array:
        """Return T over J, shape (n,); it begins where a record is settled, and is 0 before."""
        rule = Cusum(self._cusum.nu, self._cusum.threshold * _FAR)
        values = np.nan_to_num(statistic[SETTLE:], nan=np.inf, posinf=1e300, neginf=-1e300)
        return np.concatenate(
            [np.zeros(SETTLE), rule.run(np.minimum(np.abs(values), 1e6 * self._cusum.threshold)) * _FAR]
        )
