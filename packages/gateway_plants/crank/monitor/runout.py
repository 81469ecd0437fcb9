"""Runout of the wheel, told from the engine's torque by how they change with speed.

The first order of ln(pitch) is the sum of two vectors, one of the wheel's geometry, the same at any speed, and one of
the torque (one or two cylinders, a misfire), whose kinetic energy is a share of the engine's that falls with the
square of the speed: with x = (T / T0)^2, T the time of a pitch::

    u(x) = g + h x,       g = (mean(x^2) mean(u) - mean(x) mean(x u)) / var(x)

the line of least squares over the turns, older ones counted less. Where the speed has not changed enough for that
(:data:`SPREAD`), g is not known; then the whole amplitude has to exceed what a torque could bring at that speed.
"""

from __future__ import annotations

from gateway_fdi.jit import Record, f8, kernel, means

#: Ripple of the first order that an engine may have at :data:`ALLOWED_RPM`; it falls with the square of the speed.
ALLOWED, ALLOWED_RPM = 0.14, 850.0
#: An engine that is slower is cranked: another torque, which says nothing of how that of its firing falls.
FIRING_RPM = 500.0
#: Weight of a turn after one more [1].
FADING = 0.98
#: Least deviation of x, as a share of its mean, from which the two are told apart, and turns that takes.
SPREAD, TURNS = 0.2, 20.0


class Law(Record):
    """Fading sums over the turns."""

    weight: f8 = means("sum of weights")
    x: f8 = means("sum of x")
    xx: f8 = means("sum of x^2")
    even: f8 = means("sum of u, even part")
    odd: f8 = means("sum of u, odd part")
    x_even: f8 = means("sum of x u, even part")
    x_odd: f8 = means("sum of x u, odd part")


@kernel
def take(law: Law, rpm: float, even: float, odd: float) -> None:
    """Take the first order of one turn of an engine that fires."""
    if rpm < FIRING_RPM:
        return
    x = (ALLOWED_RPM / rpm) ** 2
    law.weight = FADING * law.weight + 1.0
    law.x = FADING * law.x + x
    law.xx = FADING * law.xx + x * x
    law.even = FADING * law.even + even
    law.odd = FADING * law.odd + odd
    law.x_even = FADING * law.x_even + x * even
    law.x_odd = FADING * law.x_odd + x * odd


@kernel
def geometry(law: Law, rpm: float, amplitude: float, runout: float) -> tuple[float, float]:
    """Return the amplitude that is judged, and the one that it must not exceed.

    Args:
        law: record of Law.
        rpm: speed at which the amplitude was learned.
        amplitude: of the first order, as learned.
        runout: of the wheel that is a fault.
    """
    w = law.weight
    if w == 0.0:
        return amplitude, max(runout, ALLOWED * (ALLOWED_RPM / rpm) ** 2)
    x, even, odd = law.x / w, law.even / w, law.odd / w
    variance = law.xx / w - x * x
    if w > TURNS and variance > (SPREAD * x) ** 2:
        slope_even = (law.x_even / w - x * even) / variance
        slope_odd = (law.x_odd / w - x * odd) / variance
        return ((even - slope_even * x) ** 2 + (odd - slope_odd * x) ** 2) ** 0.5, runout
    return amplitude, max(runout, ALLOWED * (ALLOWED_RPM / rpm) ** 2)


@kernel
def forget(law: Law) -> None:
    """Begin anew."""
    law.weight = 0.0
    law.x = 0.0
    law.xx = 0.0
    law.even = 0.0
    law.odd = 0.0
    law.x_even = 0.0
    law.x_odd = 0.0
