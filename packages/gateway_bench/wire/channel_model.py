"""Frames on their way: some are lost, some wait, some overtake others."""

from __future__ import annotations

import numpy as np

from gateway.bus.frames import Frames


def road(
    frames: Frames,
    rng: np.random.Generator,
    *,
    loss: float = 0.0,
    stamps_ms: float = 0.0,
    reorder: float = 0.0,
    overtakes: bool = False,
) -> Frames:
    """Return the frames as they arrive.

    Args:
        frames: as they are sent, in order.
        rng: of all that is random.
        loss: share of them that is lost.
        stamps_ms: mean wait of each, exponentially distributed [ms].
        reorder: share of them that is swapped with the next one.
        overtakes: whether one that waits is overtaken, by all that wait less; else all after it wait, too.
    """
    t = frames["t_ns"].astype(np.float64)
    if stamps_ms:
        t += rng.exponential(1e6 * stamps_ms, len(t))
    if not overtakes:
        t = np.maximum.accumulate(t)
    order = np.argsort(t, kind="stable")
    came = frames[order].copy()
    came["t_ns"] = t[order].astype(np.int64)
    swapped = np.flatnonzero(rng.random(len(came) - 1) < reorder)
    swapped = swapped[np.diff(swapped, prepend=-2) > 1]
    first = came["data"][swapped].copy()
    came["data"][swapped] = came["data"][swapped + 1]
    came["data"][swapped + 1] = first
    return came[rng.random(len(came)) >= loss]
