"""The quantity itself: level and slope, followed by a Kalman filter.

State (x, v), x' = x + v dt, process noise of the slope q per sample. All in the unit of the readings and in
samples; variances are squares of that.
"""

from __future__ import annotations

from gateway_fdi.jit import Record, f8, kernel, means

#: Samples for which a slope is held when nothing is believed; then it fades.
HOLD, FADE = 30.0, 0.9


class State(Record):
    """State."""

    x: f8 = means("level")
    v: f8 = means("slope")
    p00: f8 = means("variance of the level")
    p01: f8 = means("covariance of level and slope")
    p11: f8 = means("variance of the slope")
    coasted: f8 = means("time since a reading was taken", "samples")


@kernel
def restart(m: State, x: float, v: float, variance: float, slope_variance: float) -> None:
    """Begin anew at a level and a slope that are not related."""
    m.x, m.v = x, v
    m.p00, m.p01, m.p11 = variance, 0.0, slope_variance
    m.coasted = 0.0


@kernel
def predict(m: State, dt: float, q: float, widest: float) -> None:
    """Go ``dt`` samples ahead; equation x(k) = F x(k-1), P = F P F' + Q.

    Args:
        dt: samples.
        q: standard deviation of the slope's change in one sample.
        widest: largest standard deviation of the level.
    """
    if m.coasted > HOLD:
        m.v *= FADE**dt
    m.x += m.v * dt
    noise = q * q * dt
    m.p00 += dt * (2.0 * m.p01 + dt * m.p11) + noise * dt * dt / 3.0
    m.p01 += dt * m.p11 + noise * dt / 2.0
    m.p11 += noise
    excess = m.p00 / (widest * widest)
    if excess > 1.0:
        m.p00 /= excess
        m.p01 /= excess
        m.p11 /= excess


@kernel
def copy(to: State, m: State) -> None:
    """Copy a track."""
    to.x, to.v = m.x, m.v
    to.p00, to.p01, to.p11 = m.p00, m.p01, m.p11
    to.coasted = m.coasted


@kernel
def correct(m: State, innovation: float, variance: float) -> None:
    """Correct by one innovation, measurement variance given."""
    total = m.p00 + variance
    k0, k1 = m.p00 / total, m.p01 / total
    m.x += k0 * innovation
    m.v += k1 * innovation
    m.p11 -= k1 * m.p01
    m.p01 *= 1.0 - k0
    m.p00 *= 1.0 - k0
    m.coasted = 0.0
