"""The crankshaft tracker over arrays of pulse times.

::

    wheel = CrankWheel("60-2")
    found = wheel.run(times_s)              # or piece by piece: it goes on where it stopped
    print(found.reports, found.tooth[-1], wheel.synchronised)
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gateway.monitors.contract import FAILED
from gateway_api import Table
from gateway_fdi.detectors import numbers
from gateway_fdi.errors import InputError, as_input
from gateway_fdi.jit import kernel, zeros
from gateway_plants.crank.monitor import adaptive, sync_state
from gateway_plants.crank.monitor.faults import FAULTS
from gateway_plants.crank.monitor.monitor import MONITOR, Params
from gateway_plants.crank.wheel import Wheel

__all__ = ["CrankWheel", "Teeth"]

#: Intervals that are taken at once, and rows for what is reported meanwhile: a pulse reports each fault once at most.
PORTION = 256
ROOM = PORTION * len(FAULTS)
#: Columns of what is reported.
REPORTS = {"t_s": float, "fault": str, "count": int, "tooth": int}


@kernel
def collect(out: Any, n: int, pulse: int, reports: Any) -> int:
    """Append what failed at a pulse to the reports; returns how many there are."""
    for j in range(out.n):
        r = out.results[j]
        if r.result == FAILED and n < reports.shape[0]:
            reports[n, 0], reports[n, 1] = pulse, r.fault
            reports[n, 2], reports[n, 3] = r.cells[0], r.cells[1]
            n += 1
    return n


@kernel
def track(s: Any, c: Any, out: Any, y: Any, teeth: Any, proven: Any, reports: Any) -> int:
    """Take intervals; returns how many reports there are.

    Args:
        s: record of State.
        c: record of Const.
        out: record of Out.
        y: intervals [us], shape (n,).
        teeth: the tooth of each, -1 while not synchronised, shape (n,).
        proven: whether that is proven, shape (n,).
        reports: interval, fault and two values of its evidence, shape (m, 4).
    """
    n = k = 0
    while k < y.shape[0]:
        taken = adaptive.regular(s, c, y, k, y.shape[0])
        told = s.placed > sync_state.NOT_TOLD
        for j in range(taken):
            teeth[k + j] = s.index - taken + 1 + j
            proven[k + j] = told
        k += taken
        if k < y.shape[0]:
            out.n = 0
            adaptive.tooth(s, c, y[k], out)
            teeth[k] = s.index if s.phase != sync_state.SEARCHING else -1
            proven[k] = sync_state.proven(s)
            k += 1
            n = collect(out, n, k, reports)
    return n


@dataclass(frozen=True, eq=False)
class Teeth:
    """What a tracker made of pulses; arrays of shape (n,), a value for each pulse that had one before it.

    Attributes:
        t_s: of the pulse [s].
        tooth: that it is taken for, -1 while not synchronised.
        proven: whether that is proven.
        rpm: speed since the pulse before, NaN while not synchronised, and where a pulse was added [rpm].
        reports: faults as they were found: time, fault, count, tooth.
    """

    t_s: NDArray[np.float64]
    tooth: NDArray[np.int64]
    proven: NDArray[np.bool_]
    rpm: NDArray[np.float64]
    reports: Table


class CrankWheel:
    """Follows the teeth of a trigger wheel by their pulse times, through missed and added pulses (docs/crank).

    Args:
        wheel: as ``"60-2"``.
        acceleration: change of speed that is usual, standard deviation [rpm/s].
        runout: variation of the pitch once a turn that is a fault, amplitude.
        reversal_rpm: below this speed the engine may turn back [rpm].

    Raises:
        InputError: no such wheel.
    """

    def __init__(
        self, wheel: str, *, acceleration: float = 3000.0, runout: float = 0.04, reversal_rpm: float = 30.0
    ) -> None:
        with as_input("wheel", wheel):
            self._wheel = Wheel.parse(wheel)
            p = Params(wheel=self._wheel, acceleration=acceleration, runout=runout, reversal_rpm=reversal_rpm)
        self._s, self._c, self._out = (
            zeros(1, sync_state.State)[0],
            zeros(1, sync_state.Const)[0],
            zeros(1, MONITOR.results)[0],
        )
        sync_state.prepare(self._s, self._c, self._wheel, p.acceleration, p.runout, p.reversal_rpm)
        self._last_s: float | None = None

    def __repr__(self) -> str:
        return f"CrankWheel({self._wheel}: {'synchronised' if self.synchronised else 'searching'})"

    @property
    def synchronised(self) -> bool:
        """Whether the place on the wheel is proven."""
        return bool(sync_state.proven(self._s))

    def run(self, times_s: ArrayLike) -> Teeth:
        """Take the times of pulses.

        Args:
            times_s: each after the one before, also after those of the call before, shape (n,) [s].

        Raises:
            InputError: they are not.
        """
        times = numbers(times_s, "times_s")
        if self._last_s is not None:
            times = np.concatenate([[self._last_s], times])
        y = np.diff(times) * 1e6
        if not (y > 0.0).all():
            raise InputError("each pulse comes after the one before", key="times_s")
        self._last_s = float(times[-1]) if len(times) else None
        tooth, proven = np.full(len(y), -1, np.int64), np.zeros(len(y), np.bool_)
        rows: list[tuple[float, str, int, int]] = []
        reports = np.zeros((ROOM, 4))
        for first in range(0, len(y), PORTION):
            part = slice(first, first + PORTION)
            n = track(self._s, self._c, self._out, y[part], tooth[part], proven[part], reports)
            for at, fault, count, where in reports[:n]:
                rows.append((float(times[first + int(at)]), FAULTS[int(fault)].name, int(count), int(where)))
        return Teeth(times[1:], tooth, proven, self._rpm(y, tooth), Table.of(REPORTS, rows))

    def _rpm(self, y: NDArray[np.float64], tooth: NDArray[np.int64]) -> NDArray[np.float64]:
        laid = self._wheel.laid_out
        place = np.asarray(laid.positions)[tooth]
        span = np.diff(place, prepend=np.nan) % laid.turn
        known = (tooth >= 0) & (np.roll(tooth, 1) >= 0) & (span > 0.0)
        return np.where(known, span / self._wheel.turn / (y * 1e-6) * 60.0, np.nan)
