"""Driving cycles: the speed asked for, from shipped tables."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache

import numpy as np
from numpy.typing import NDArray

from gateway_fdi.common.resources import shipped

Array = NDArray[np.float64]

#: Names of the cycles that there are.
CYCLES = ("udds", "ftp75")
#: Second at which FTP75 begins the first part of UDDS again, and how long that is.
_COLD, _HOT = 1369, 505


@cache
def cycle(name: str) -> tuple[tuple[float, float], ...]:
    """Return a cycle as points (time [s], speed [m/s]).

    Raises:
        KeyError: there is no such cycle.
    """
    table = np.loadtxt(shipped("cycles/udds.csv"), delimiter=",", skiprows=1)
    points: Mapping[str, Array] = {
        "udds": table,
        "ftp75": np.vstack([table, table[1 : _HOT + 1] + np.array([_COLD, 0.0])]),
    }
    return tuple((float(t), float(v)) for t, v in points[name])


def speeds(name: str, times: Array, start_s: float = 0.0) -> Array:
    """Return the speed asked for [m/s] at times [s] of a run that begins at a second of the cycle; 0 behind its end."""
    points = np.array(cycle(name))
    found: Array = np.interp(times + start_s, points[:, 0], points[:, 1], right=0.0)
    return found
