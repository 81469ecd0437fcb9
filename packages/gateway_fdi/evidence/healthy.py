"""Noise and jitter of a plant, from healthy records.

The noise is the long-run covariance: that of sums over blocks, of what is left of the residuals when each record's own
slow errors are taken off. Residuals of a model share sensors and equations, so that there are often more of them than
independent ones; what a linear model leaves of each beside, :data:`FLOOR` of its variance, keeps the others from being
told apart by less than that.

Blocks are not independent, and a model is a little wrong. So the jitter is the least one with which the largest healthy
ratios are about as near to theory as they get (the scale of :class:`gateway_fdi.evidence.alarm.Law`), and the noise is
as much larger as they still are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gateway_fdi.errors import InputError
from gateway_fdi.evidence import alarm
from gateway_fdi.evidence.model import Model, Slow
from gateway_fdi.evidence.record import over

#: Share of each residual's variance that is its own.
FLOOR = 0.01
#: Jitters that are tried, shares of the priors; time of each maximum [s], and blocks that are not judged at first.
JITTERS, WINDOW_S, FIRST = (0.0, 0.1, 0.3, 0.6, 1.0, 1.5, 2.0, 3.0), 20.0, 3
#: Multiple of the least scale that is about as near.
NEAR = 1.1

Arrays = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]


def noise(records: Sequence[Arrays], slow: Sequence[Slow], samples: int) -> NDArray[np.float64]:
    """Return the long-run covariance of the residuals' noise per sample, shape (m, m).

    Args:
        records: healthy ones, each (r, h, g) as :func:`gateway_fdi.evidence.record.over` takes them.
        slow: slow errors, in the order of h's columns.
        samples: of a block.

    Raises:
        InputError: fewer than two blocks for each residual, or a residual that is always the same.
    """
    total, blocks = 0.0, 0
    prior = np.diag(np.array([one.prior**-2 for one in slow]))
    for r, h, _ in records:
        count = len(r) // samples
        there: NDArray[np.bool_] = np.asarray(np.isfinite(r).all(1))
        own, columns = r[there], h[there]
        spread = own.std(0)
        if not (spread > 0.0).all():
            raise InputError("a residual is always the same", key="records", value=str(int(np.argmin(spread))))
        a = (columns / spread[:, None]).reshape(own.size, len(slow))
        x = np.linalg.solve(a.T @ a / samples + prior, a.T @ (own / spread).reshape(-1) / samples)
        left = np.where(there[:, None], r - h @ x, 0.0)[: count * samples]
        sums = left.reshape(count, samples, -1).sum(1)[there[: count * samples].reshape(count, samples).all(1)]
        total, blocks = total + sums.T @ sums / samples, blocks + len(sums)
    if blocks < 2 * records[0][0].shape[1]:
        raise InputError("two whole blocks at least for each residual", key="records", value=str(blocks))
    found: NDArray[np.float64] = np.asarray(total) / blocks
    return found + FLOOR * np.diag(np.diag(found))


class Fitted(NamedTuple):
    """Result of :func:`fitted`.

    Attributes:
        model: with noise, jitter and threshold.
        law: of its largest healthy ratios.
        hours: of the records.
    """

    model: Model
    law: alarm.Law
    hours: float


def maxima(model: Model, records: Sequence[Arrays]) -> tuple[NDArray[np.float64], float]:
    """Return the largest ratio of each :data:`WINDOW_S` of the records, and the length of such a time [h].

    Args:
        model: the plant.
        records: each (r, h, g).
    """
    count = max(round(WINDOW_S / (model.samples * model.period_s)), 1)
    found: list[NDArray[np.float64]] = []
    for record in records:
        ratio = over(model, *record).ratio[FIRST:]
        found.append(ratio[: len(ratio) // count * count].reshape(-1, count).max(1))
    return np.concatenate(found), count * model.samples * model.period_s / 3600.0


def fitted(model: Model, records: Sequence[Arrays], per_h: float) -> Fitted:
    """Return a model with the noise, jitter and threshold of healthy records.

    Args:
        model: the plant; its noise, jitter and threshold do not matter.
        records: healthy ones, each (r, h, g).
        per_h: false alarms in an hour that are accepted; :func:`gateway_fdi.evidence.alarm.supported` says of which
            rate the records are proof.

    Raises:
        InputError: too little of them.
    """
    own = noise(records, model.slow, model.samples)
    tried = [replace(model, noise=own, jitter=share) for share in JITTERS]
    laws = [alarm.fit(*maxima(one, records)) for one in tried]
    enough = NEAR * min(law.scale for law in laws)
    best = next(k for k, law in enumerate(laws) if law.scale <= enough)
    found = replace(tried[best], noise=own * laws[best].scale)
    law = alarm.fit(*maxima(found, records))
    hours = sum(len(r) for r, _, _ in records) * model.period_s / 3600.0
    return Fitted(replace(found, threshold=law.threshold(per_h)), law, hours)
