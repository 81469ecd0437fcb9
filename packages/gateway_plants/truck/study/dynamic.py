"""T3 and T4: what both do around their residual generators, with integral causality as with mixed.

The speed that an integrated residual begins with is corrected by the residual's mean over the first second: 0.1 rad/s
of noise behind the filter (37) would stay in the residual for as long as the clutch holds, and in one window of some
thousand the CUSUM would grow without a fault.
"""

from __future__ import annotations

from gateway_fdi.jit import Record, f8, i8, kernel, means
from gateway_plants.truck.study import excitation

#: Time over which the speed at the start is corrected [s].
CORRECTED = 1.0


class State(Record):
    """State."""

    on: i8 = means("1: the generators run")
    total: f8 = means("sum of the residuals of the first second", "rad/s")
    count: f8 = means("residuals in that sum; 0: they have corrected the speed")
    excitation: excitation.State = means("which faults have shown")


@kernel
def begin(s: State) -> None:
    """Begin with the residual generators."""
    s.on, s.total, s.count = 1, 0.0, 0.0
    excitation.restart(s.excitation)


@kernel
def settled(s: State) -> bool:
    """Tell whether the speed at the start has been corrected; asked before :func:`correction`."""
    return bool(s.excitation.time > CORRECTED and s.count == 0.0)


@kernel
def correction(s: State, residual: float) -> float:
    """Take a residual (36); returns the correction of its speed: once a window, when its first second is over."""
    if s.excitation.time <= CORRECTED:
        if residual == residual:  # noqa: PLR0124 - not NaN
            s.total += residual
            s.count += 1.0
        return 0.0
    mean = s.total / s.count if s.count > 0.0 else 0.0
    s.count = 0.0
    return float(mean)
