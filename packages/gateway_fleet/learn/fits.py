"""How two courses go together: slope and offset with noise on both sides, delay, and what their movements prove."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

#: Rows that it takes.
LEAST_ROWS = 100
#: Delays between two signals that are looked for [rows], and by how much one must make the deviations smaller.
MOST_DELAY, BETTER = 20, 0.85
#: An offset that is no larger than this number of its standard errors, and this share of the span, is none.
NO_OFFSET, SMALL = 3.0, 0.02
#: Deviations of this number of robust standard deviations do not count for the slope; number of fits.
OUTLIER, FITS = 4.0, 3
#: Rows of one movement: a shorter time is much resolution and little movement.
MOVED = 10


def fitted(x: NDArray[np.float64], y: NDArray[np.float64]) -> tuple[float, float, float]:
    """Return slope, offset and the slope's standard error: total least squares, outliers left out.

    Both signals have noise, estimated by their second differences (a course without corners has none); deviations count
    across the line in units of it (Deming's regression, ratio of the variances known). An offset that may be chance is
    none: laws of physics go through zero.

    Args:
        x: values of the signal that explains, shape (rows,).
        y: those of the signal that is explained, at the same times, shape (rows,).
    """
    ratio = max(noise(y), 1e-12) ** 2 / max(noise(x), 1e-12) ** 2
    used = np.ones(len(x), np.bool_)
    slope = offset = 0.0
    for _ in range(FITS):
        a, b = x[used], y[used]
        xx, yy, xy = float(a.var()), float(b.var()), float(((a - a.mean()) * (b - b.mean())).mean())
        if xy == 0.0 or xx == 0.0:
            return 0.0, float(y.mean()), np.inf
        slope = (yy - ratio * xx + np.sqrt((yy - ratio * xx) ** 2 + 4.0 * ratio * xy**2)) / (2.0 * xy)
        offset = float(b.mean() - slope * a.mean())
        off = y - slope * x - offset
        scale = 1.4826 * float(np.median(np.abs(off - np.median(off))))
        used = np.abs(off) <= max(OUTLIER * scale, 1e-12 * np.ptp(y))
        if used.sum() < LEAST_ROWS // 2:
            used[:] = True
    off = (y - slope * x - offset)[used]
    follows = float(np.corrcoef(off[1:], off[:-1])[0, 1]) if off.std() > 0 and len(off) > 2 else 0.0
    follows = float(np.clip(np.nan_to_num(follows), 0.0, 0.999))
    free = max(len(off) * (1.0 - follows) / (1.0 + follows), 2.0)
    error = float(off.std() / (max(x[used].std(), 1e-12) * np.sqrt(free)))
    if abs(offset) <= max(NO_OFFSET * error * abs(x[used].mean()), 0.0) and abs(offset) <= SMALL * np.ptp(y):
        slope, offset = float((x[used] * y[used]).sum() / (x[used] ** 2).sum()), 0.0
    return float(slope), float(offset), error


def noise(y: NDArray[np.float64]) -> float:
    """Return the standard deviation of a signal around its course, at least that of its rounding."""
    second = y[2:] - 2.0 * y[1:-1] + y[:-2]
    return float(max(1.4826 * float(np.median(np.abs(second))) / np.sqrt(6.0), resolution(y) / np.sqrt(12.0)))


def delay_of(x: NDArray[np.float64], y: NDArray[np.float64]) -> int:
    """Return by how many rows one signal follows another, 0 where that explains little; below 0: the other follows."""
    if len(x) < LEAST_ROWS + 2 * MOST_DELAY:
        return 0
    middle = slice(MOST_DELAY, len(x) - MOST_DELAY)
    off = {}
    for delay in range(-MOST_DELAY, MOST_DELAY + 1):
        a, b = x[MOST_DELAY - delay : len(x) - MOST_DELAY - delay], y[middle]
        good = ~(np.isnan(a) | np.isnan(b))
        if good.sum() < LEAST_ROWS:
            return 0
        a, b = a[good], b[good]
        rest = 1.0 - np.corrcoef(a, b)[0, 1] ** 2 if a.std() > 0 and b.std() > 0 else 1.0
        off[delay] = float(np.sqrt(max(rest, 0.0)))
    best = min(off, key=lambda delay: off[delay])
    return best if off[best] < BETTER * off[0] and abs(best) < MOST_DELAY else 0


def movement(x: NDArray[np.float64], y: NDArray[np.float64], pace: int = 1) -> tuple[float, float]:
    """Return the correlation of movements, and of how many standard deviations it is above chance.

    ``pace``: rows from value to value of the slower one; movements are over this many at least.

    Movements follow each other, too: two slow waves agree by chance. As many of them count as are independent by their
    autocorrelations (Bartlett 1935), and the correlation of this number scatters as Fisher's transform has it.
    """
    over = max(MOVED, pace)
    one, other = x[over:] - x[:-over], y[over:] - y[:-over]
    if len(one) < 2 or one.std() == 0 or other.std() == 0:
        return 0.0, 0.0
    found = float(abs(np.corrcoef(one, other)[0, 1]))
    free = len(one) / max(1.0 + 2.0 * float((_follows(one) * _follows(other)).sum()), 1.0)
    return found, float(np.arctanh(min(found, 1.0 - 1e-9)) * np.sqrt(max(free - 3.0, 0.0)))


def _follows(course: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the autocorrelation of a course at each delay up to a quarter of it."""
    centred = course - course.mean()
    power = np.abs(np.fft.rfft(centred, 2 * len(centred))) ** 2
    own = np.fft.irfft(power)[: len(centred) // 4]
    return np.asarray(own[1:] / own[0], np.float64)


def resolution(y: NDArray[np.float64]) -> float:
    """Return the least difference of two values of a signal."""
    steps = np.diff(np.unique(y))
    return float(steps.min()) if len(steps) else 0.0
