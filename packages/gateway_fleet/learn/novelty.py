"""Values that a minute of the drives shows and no minute before it: whether more drive would teach more."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gateway_fleet.learn.snapshots import Snapshots

#: A signal shows something new in a minute in which it goes farther by this share of all that it went at the end.
FARTHER = 0.01
#: Minutes that are shown one by one.
SHOWN = 12


def per_minute(seen: Snapshots) -> list[int]:
    """Return how many signals came for the first time, or went farther than ever before, in each minute of the logs."""
    matrix, minute = seen.matrix(), max(1, round(60.0 / seen.step_s))
    starts = np.arange(0, len(matrix), minute)
    if not matrix.size:
        return []
    low = np.minimum.accumulate(np.minimum.reduceat(np.where(np.isnan(matrix), np.inf, matrix), starts))
    high = np.maximum.accumulate(np.maximum.reduceat(np.where(np.isnan(matrix), -np.inf, matrix), starts))
    least = FARTHER * np.where(high[-1] > low[-1], high[-1] - low[-1], np.inf)
    came = np.isfinite(low)
    before = np.vstack([np.zeros((1, matrix.shape[1]), bool), came[:-1]])

    def farther(ends: NDArray[np.float64]) -> NDArray[np.bool_]:
        with np.errstate(invalid="ignore"):  # of a signal that has not come yet
            return np.asarray(np.abs(np.diff(ends, axis=0, prepend=ends[:1])) > least)

    new = (came & ~before) | (before & (farther(low) | farther(high)))
    return [int(count) for count in new.sum(1)]


def in_words(minutes: list[int]) -> str:
    """Return what is new in each minute, and whether more drive would teach more; two lines."""
    some = ("..., " if len(minutes) > SHOWN else "") + ", ".join(map(str, minutes[-SHOWN:]))
    quiet = next((k for k, count in enumerate(reversed(minutes)) if count), len(minutes))
    # Rule of three: none in k minutes leaves a rate of at most 3 / k (95 %).
    end = f"none for {quiet} min: on drives like these at most one in {quiet / 3:.1f} min (95 %)"
    return f"signals that went farther in each minute: {some}\n  {end if quiet >= 3 else 'more drive teaches more'}"
