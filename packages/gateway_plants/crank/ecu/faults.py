"""Faults of the crankshaft sensor: pulses missed and pulses added."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gateway_bench.vecu.contract import Truth


def _first(times_ns: NDArray[np.int64], pulses: int, at_ns: int, tooth: int | None) -> int | None:
    """Return the place of the first healthy pulse at or after a time, of a given tooth."""
    at = int(np.searchsorted(times_ns, at_ns))
    if tooth is not None:
        at += (tooth - at) % pulses
    return at if at + 1 < len(times_ns) else None


def missed_pulses(
    times_ns: NDArray[np.int64], pulses: int, at_ns: int, count: int, tooth: int | None = None
) -> tuple[NDArray[np.int64], list[Truth]]:
    """Leave out neighbouring pulses.

    Args:
        times_ns: shape (n,), healthy train: place k is tooth ``k % pulses``.
        pulses: of one turn.
        at_ns: not before this time.
        count: how many.
        tooth: the first of them; None: whichever comes first.

    Returns:
        the places to leave out, and what was injected (nothing, if the train ends before).
    """
    at = _first(times_ns, pulses, at_ns, tooth)
    if at is None:
        return np.zeros(0, np.int64), []
    places = np.arange(at, min(at + count, len(times_ns)))
    return places, [Truth(int(times_ns[at]), "missed_pulses", len(places), at % pulses)]


def added_pulses(
    times_ns: NDArray[np.int64],
    pulses: int,
    at_ns: int,
    count: int,
    rng: np.random.Generator,
    tooth: int | None = None,
) -> tuple[NDArray[np.int64], list[Truth]]:
    """Add pulses between two teeth, at random places of the interval.

    Args:
        times_ns: as for :func:`missed_pulses`.
        pulses: of one turn.
        at_ns: not before this time.
        count: how many.
        rng: source of the places.
        tooth: the tooth before them; None: whichever comes first.

    Returns:
        the times to add [ns], and what was injected.
    """
    at = _first(times_ns, pulses, at_ns, tooth)
    if at is None:
        return np.zeros(0, np.int64), []
    start, width = int(times_ns[at]), int(times_ns[at + 1] - times_ns[at])
    # Each pulse gets a share of the interval of its own, so that none coincide.
    shares = (np.arange(count) + rng.uniform(0.2, 0.8, count)) / count
    added = start + np.rint(shares * width / 1000).astype(np.int64) * 1000
    return added, [Truth(int(added[0]), "added_pulses", count, at % pulses)]
