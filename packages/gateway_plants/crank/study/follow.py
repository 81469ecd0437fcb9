"""A pulse train through a method: which tooth it takes each pulse for, and what it reports."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from gateway_fdi.jit import kernel, zeros
from gateway_plants.crank.arrays import track
from gateway_plants.crank.monitor import sync_state
from gateway_plants.crank.monitor.monitor import MONITOR, Params
from gateway_plants.crank.study.peers import PEER, ratio, threshold
from gateway_plants.crank.wheel import Wheel

Method = Literal["adaptive", "ratio", "threshold"]
METHODS: tuple[Method, ...] = ("adaptive", "ratio", "threshold")
#: Reports kept of one train.
MOST_REPORTS = 4096


@dataclass(frozen=True)
class Followed:
    """What a method made of a train of n pulses.

    Attributes:
        teeth: shape (n - 1,), tooth it took pulse k + 1 for, -1 while not synchronised.
        proven: shape (n - 1,), whether synchronisation was proven.
        pulse: shape (m,), the pulse at which each report came.
        fault: shape (m,), the fault reported.
        count: shape (m,), its count, the first value of its evidence.
        tooth: shape (m,), the second one: the tooth, where pulses were missed or added.
        alarms: losses of synchronisation (peers).
        reversals: times that the engine turned back (adaptive).
    """

    teeth: NDArray[np.int64]
    proven: NDArray[np.bool_]
    pulse: NDArray[np.int64]
    fault: NDArray[np.int64]
    count: NDArray[np.int64]
    tooth: NDArray[np.int64]
    alarms: int
    reversals: int = 0


@kernel
def _peer(s: Any, by_ratio: bool, pulses: int, gap: float, y: Any, teeth: Any, proven: Any) -> None:
    for k in range(y.shape[0]):
        if by_ratio:
            ratio(s, pulses, gap, y[k])
        else:
            threshold(s, pulses, gap, y[k])
        teeth[k] = s.index if s.synced == 1 else -1
        proven[k] = s.synced == 1


def follower(
    method: Method, wheel: Wheel, *, report_reversal: bool = False
) -> Callable[[NDArray[np.float64]], Followed]:
    """Return a function that takes the pulse times of one train [us], each from the start.

    Args:
        method: ours, or a peer (see :mod:`.peers`).
        wheel: the wheel.
        report_reversal: of the adaptive method's parameters.
    """
    out = zeros(1, MONITOR.results)
    defaults = Params(wheel=wheel)
    pulses, gap = wheel.pulses, max(wheel.pitches)

    def follow(times_us: NDArray[np.float64]) -> Followed:
        y = np.diff(times_us)
        teeth = np.full(len(y), -1, np.int64)
        proven = np.zeros(len(y), np.bool_)
        reports = np.zeros((MOST_REPORTS, 4))
        n = alarms = reversals = 0
        s: Any
        c: Any
        if method == "adaptive":
            s, c = zeros(1, sync_state.State), zeros(1, sync_state.Const)
            sync_state.prepare(s[0], c[0], wheel, defaults.acceleration, defaults.runout, defaults.reversal_rpm)
            c[0]["told"] = report_reversal
            n = track(s[0], c[0], out[0], y, teeth, proven, reports)
            reversals = int(s[0]["reversal"]["total"])
        else:
            s = zeros(1, PEER)
            _peer(s[0], method == "ratio", pulses, gap, y, teeth, proven)
            alarms = int(s[0]["losses"])
        found = reports[:n].astype(np.int64)
        return Followed(teeth, proven, found[:, 0], found[:, 1], found[:, 2], found[:, 3], alarms, reversals)

    return follow


@cache
def follower_of(method: Method, wheel: str) -> Callable[[NDArray[np.float64]], Followed]:
    """Return :func:`follower` of a wheel by its text, one for all runs of a process."""
    return follower(method, Wheel.parse(wheel))


def warm(methods: Sequence[Method]) -> None:
    """Fill the kernels' cache before several processes want it."""
    for method in methods:
        follower_of(method, "60-2")(np.arange(100.0) * 1e3)
