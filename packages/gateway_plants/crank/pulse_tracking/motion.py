"""Motion of the wheel between two pulses: prediction and correction of time, pitch period and growth.

The state of a hypothesis is the (filtered) time of its last tooth, the period ``T`` of one pitch there
[us], and the growth ``r`` of the squared speed per pitch. Under constant torque the kinetic energy, so
``w = 1 / T^2``, is linear in the angle: ``w(S) = w (1 + r S)``. Over ``S`` pitches therefore, exactly::

    q = sqrt(1 + r S),   dt = 2 T S / (1 + q),   T' = T / q,   r' = r / q^2

A constant slope of ``ln T`` instead, the usual form, lags by ``T''`` and mistakes a coarse wheel's
strong deceleration for a missed pulse.

The residual is in pitches, ``e = (t - th - dt) / T'``; it is the paper's r (8) by the current pitch,
without the correlation -1/2 that pulse times have when edges jitter. Correction by a Kalman filter over
(position error [pitch], error of ln T, error of r), with covariance in units of the edge's variance::

    F = [[1, S, -S^2/4], [0, 1, -S/2], [0, 0, 1]],   H = [1, 0, 0]
"""

from __future__ import annotations

from math import sqrt

from gateway_fdi.jit import Record, f8, i4, kernel, means, u1


class Hypothesis(Record):
    """One hypothesis about which pulse was which tooth."""

    elapsed: f8 = means("time since its last tooth, filtered", "us")
    period: f8 = means("time of a pitch", "us")
    growth: f8 = means("growth of the squared speed", "1/pitch")
    p11: f8 = means("covariance, of the position with itself")
    p12: f8 = means("covariance, of position and ln T")
    p13: f8 = means("covariance, of position and growth")
    p22: f8 = means("covariance, of ln T with itself")
    p23: f8 = means("covariance, of ln T and growth")
    p33: f8 = means("covariance, of the growth with itself")
    cost: f8 = means("minus log likelihood above the best", "nat")
    index: i4 = means("its last tooth")
    missed: i4 = means("pulses missed since all hypotheses agreed")
    added: i4 = means("pulses added since all hypotheses agreed")
    missed_at: i4 = means("first tooth missed")
    added_at: i4 = means("tooth before the first pulse added")
    clutter: i4 = means("pulses held for spurious since its last tooth")
    associated: u1 = means("1: the latest pulse is its last tooth")
    outlier: u1 = means("1: it took that pulse for an edge far off")


#: Process noise per pitch: variances of the position [pitch^2] and of ln T. They are the engine's, not the
#: sensor's: a noisy sensor is smoothed, not followed. That of the growth depends on the speed.
Q1, Q2 = 0.6e-4, 0.3e-4
#: Share of the torque's square that changes per pitch, and the least variance of the growth per pitch.
TORQUE, Q3 = 0.1, 0.03e-4
MOST_SHARE = 0.4
#: The speed is not believed to fall by more than this share of its square within one prediction.
LEAST_SQUARE = 0.1
MOST_GROWTH = 0.3
#: The torque that brings the growth lasts so many pitches, about.
LASTS = 10.0


@kernel
def travel(h: Hypothesis, span: float) -> tuple[float, float]:
    """Return time [us] over ``span`` pitches from the last tooth, and ``q = sqrt(1 + r S)``."""
    q = sqrt(max(1.0 + h.growth * span, LEAST_SQUARE))
    return 2.0 * h.period * span / (1.0 + q), q


@kernel
def torque(h: Hypothesis, acceleration: float) -> float:
    """Return the variance of the growth that the engine's torque can bring.

    Args:
        h: hypothesis.
        acceleration: that the engine can have [pitch/s^2].
    """
    growth = min(2e-12 * acceleration * h.period * h.period, MOST_SHARE)
    return float(growth * growth)


@kernel
def spread(h: Hypothesis, span: float, scale: float) -> float:
    """Return the predicted variance of the position over ``span`` pitches (units of the edge's).

    Args:
        h: hypothesis.
        span: pitches.
        scale: 1 / variance of an edge [1/pitch^2].
    """
    b = -span * span / 4
    return float(
        h.p11
        + span * span * h.p22
        + b * b * h.p33
        + 2 * (span * h.p12 + b * h.p13 + span * b * h.p23)
        + (Q1 + Q2 * span * span * span / 3) * scale
    )


@kernel
def correct(
    h: Hypothesis,
    span: float,
    e: float,
    q: float,
    edge: float,
    step: float,
    jolt: float,
    scale: float,
    q3: float,
) -> tuple[float, float, float]:
    """Take a pulse as the tooth ``span`` pitches on, with residual ``e``.

    Args:
        h: hypothesis; its ``elapsed`` is the time of the pulse since the last tooth.
        span: pitches travelled.
        e: residual [pitch].
        q: of :func:`travel`.
        edge: variance of this edge in units of the usual one (more than 1: an outlier).
        step: variance added to ln T before (units of the edge's).
        jolt: variance added to the growth before (units of the edge's).
        scale: 1 / variance of an edge [1/pitch^2].
        q3: process noise of the growth per pitch.

    Returns:
        the gains.
    """
    period = h.period / q
    p22, p33 = h.p22 + step, h.p33 + jolt
    b, d = -span * span / 4, -span / 2
    # P' = F P F^T + Q
    f12 = h.p12 + span * p22 + b * h.p23
    f13 = h.p13 + span * h.p23 + b * p33
    f11 = h.p11 + span * h.p12 + b * h.p13 + span * f12 + b * f13 + (Q1 + Q2 * span * span * span / 3) * scale
    f12 = f12 + d * f13 + Q2 * span * span / 2 * scale
    f23 = h.p23 + d * p33
    f22 = p22 + d * h.p23 + d * f23 + Q2 * span * scale
    f33 = p33 + q3 * span * scale
    certainty = 1.0 / (f11 + edge)
    k1, k2, k3 = f11 * certainty, f12 * certainty, f13 * certainty
    h.p11 = f11 - k1 * f11
    h.p12 = f12 - k1 * f12
    h.p13 = f13 - k1 * f13
    h.p22 = f22 - k2 * f12
    h.p23 = f23 - k2 * f13
    h.p33 = f33 - k3 * f13
    change = min(max(k2 * e, -0.6), 0.6)
    h.elapsed = e * period * (1.0 - k1)
    h.period = period * (1.0 + change + 0.5 * change * change)
    growth = h.growth / (q * q) * max(1.0 - span / LASTS, 0.5) + k3 * e
    h.growth = min(max(growth, -MOST_GROWTH), MOST_GROWTH)
    return k1, k2, k3
