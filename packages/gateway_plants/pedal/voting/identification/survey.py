"""What long records of healthy channels say of their noise, resolution, lag and mismatch, and how sure it is.

The same estimators that the voter learns by (:mod:`.noise`, :mod:`.lag`), begun anew in each block of a record: what
they differ by from block to block is how sure they are. Offset and gain of a channel are those against the mean of all,
by least squares over short windows in which the quantity hardly moves; their deviation is that of the jackknife over
blocks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gateway_fdi.jit import kernel, zeros
from gateway_plants.pedal.voting.identification import lag, noise
from gateway_plants.pedal.voting.tracking import scale

Array = NDArray[np.float64]

#: Length of a block [ms], and least samples of one.
BLOCK_MS, LEAST_SAMPLES = 20_000.0, 8192
#: Length of a window [ms], and movement in it up to which it is a slow one, share of the span.
WINDOW_MS, SLOW = 250.0, 0.02
#: Largest lag that is looked for [ms].
MOST_LAG_MS = 12.0


@dataclass(frozen=True)
class Estimate:
    """A number and its standard deviation."""

    value: float
    sd: float


@dataclass(frozen=True)
class Survey:
    """What the records say; readings in the unit of the span.

    Attributes:
        noise: of each channel.
        resolution: likewise; 0: none was seen.
        lag_ms: likewise, behind the quickest [ms]; none where the quantity did not move enough.
        offset: likewise, against the mean of all, where that is 0.
        gain: likewise, share.
        mismatch: largest difference of two channels in a slow window.
        blocks: that were looked at.
        moved: blocks in which it moved enough for the lag.
        low, high: where slow windows lay, their 2 % and 98 % quantiles.
    """

    noise: tuple[Estimate, ...]
    resolution: tuple[float, ...]
    lag_ms: tuple[Estimate, ...]
    offset: tuple[Estimate, ...]
    gain: tuple[Estimate, ...]
    mismatch: float
    blocks: int
    moved: int
    low: float
    high: float


@kernel
def _learn(
    ns: noise.State,
    nc: noise.Const,
    ls: lag.State,
    lc: lag.Const,
    gates: scale.Scale,
    n: int,
    y: Any,
    at: Any,
    span: float,
    bend: float,
    aligned: Any,
) -> None:
    """Let noise and lag be learned of a block.

    ``y``: readings, shape (samples, channels); ``at``: numbers of these samples; ``aligned``: room for a sample.
    """
    fine = (1 << n) - 1
    for k in range(y.shape[0]):
        noise.learn(ns, nc, n, y[k], fine, float(at[k] - at[k - 1]) if k > 0 else 1.0)
    scale.measure(gates, noise.largest_noise(ns, nc, n), noise.widest_step(ns, nc, n), span, bend)
    for k in range(y.shape[0]):
        dt = float(at[k] - at[k - 1]) if k > 0 else 1.0
        smooth = lag.smooth(ls, n, y[k], 0, gates.straight, dt)
        lag.align(ls, lc, n, y[k], smooth, 0.0, aligned)
        lag.learn(ls, lc, n, aligned, fine, smooth, dt, gates.variance)


def _of_blocks(values: Sequence[float]) -> Estimate:
    """Return the mean of blocks, and its standard deviation."""
    found = np.asarray(values)
    return Estimate(float(found.mean()), float(found.std(ddof=1) / np.sqrt(len(found))) if len(found) > 1 else np.inf)


def _windows(block: Array, size: int, span: float) -> Array:
    """Return the means of a block's slow windows, shape (windows, channels)."""
    count = len(block) // size
    cut = block[: count * size].reshape(count, size, block.shape[1])
    half = size // 2
    there: NDArray[np.bool_] = np.asarray(np.isfinite(cut).all(axis=2))
    cut = cut[np.minimum(there[:, :half].sum(axis=1), there[:, half:].sum(axis=1)) >= size // 4]
    means = np.nanmean(cut, axis=1)
    moved = np.abs(np.nanmean(cut[:, half:], axis=1) - np.nanmean(cut[:, :half], axis=1)).max(axis=1)
    return np.asarray(means[moved < SLOW * span], np.float64)


def _lines(windows: Sequence[Array], channel: int) -> tuple[Estimate, Estimate]:
    """Return offset and gain of a channel against the mean of all, with the jackknife's deviations."""

    def fit(parts: Sequence[Array]) -> NDArray[np.float64]:
        all_of = np.concatenate(parts)
        mean = all_of.mean(axis=1)
        design = np.stack([np.ones(len(mean)), mean], axis=1)
        return np.asarray(np.linalg.lstsq(design, all_of[:, channel] - mean, rcond=None)[0], np.float64)

    whole = fit(windows)
    left = np.array([fit([*windows[:k], *windows[k + 1 :]]) for k in range(len(windows))])
    count = len(windows)
    sd = np.sqrt((count - 1) / count * ((left - left.mean(axis=0)) ** 2).sum(axis=0))
    return Estimate(float(whole[0]), float(sd[0])), Estimate(float(whole[1]), float(sd[1]))


def survey(records: Sequence[Array], *, period_ms: float, told: float, step: float, span: float, bend: float) -> Survey:
    """Look at records.

    Args:
        records: readings in a row, each of shape (samples, channels); NaN: lost.
        period_ms: between two samples.
        told: noise that is told.
        step: resolution that is told.
        span: of the quantity.
        bend: change of its slope in a sample that is usual, as the voter has it.
    """
    length = max(round(BLOCK_MS / period_ms), LEAST_SAMPLES)
    size = max(round(WINDOW_MS / period_ms), 4)
    channels = records[0].shape[1] if records else 0
    noises: list[list[float]] = [[] for _ in range(channels)]
    lags: list[list[float]] = [[] for _ in range(channels)]
    steps: list[list[float]] = [[] for _ in range(channels)]
    windows, blocks = [], 0
    for record in records:
        for first in range(0, len(record) - length + 1, length):
            block = record[first : first + length]
            at = np.flatnonzero(np.isfinite(block).all(axis=1))
            came = np.ascontiguousarray(block[at])
            nc = zeros(1, noise.Const)[0]
            expected = told
            for _ in range(2):  # its classes are as wide as what is expected: what was told must not show in it
                ns, ls, lc = zeros(1, noise.State)[0], zeros(1, lag.State)[0], zeros(1, lag.Const)[0]
                noise.prepare(nc, noise=expected, step=step, span=span)
                lag.prepare(lc, period_ms=period_ms, most_ms=MOST_LAG_MS)
                _learn(ns, nc, ls, lc, zeros(1, scale.Scale)[0], channels, came, at, span, bend, np.zeros(channels))
                expected = max(float(ns.noise[i]) for i in range(channels))
            if ns.known == 0:
                continue  # hardly any readings in a row
            blocks += 1
            for i in range(channels):
                noises[i].append(float(ns.noise[i]))
                if ns.resolution[i] > 0.0:
                    steps[i].append(float(ns.resolution[i]))
                if ls.known == 1:
                    lags[i].append(float(ls.tau[i]) * period_ms)
            slow = _windows(block, size, span)
            if len(slow):
                windows.append(slow)
    lines = [_lines(windows, i) for i in range(channels)] if len(windows) > 1 else []
    together = np.concatenate(windows) if windows else np.zeros((1, max(channels, 1)))
    low, high = np.quantile(together.mean(axis=1), [0.02, 0.98])
    return Survey(
        noise=tuple(_of_blocks(each) for each in noises if each),
        resolution=tuple(min(each, default=0.0) for each in steps),
        lag_ms=tuple(_of_blocks(each) for each in lags if each),
        offset=tuple(offset for offset, _ in lines),
        gain=tuple(gain for _, gain in lines),
        mismatch=float((together.max(axis=1) - together.min(axis=1)).max()),
        blocks=blocks,
        moved=len(lags[0]) if lags else 0,
        low=float(low),
        high=float(high),
    )
