"""Onset of a step of the voltage residual: a current sensor's error shows at once, a voltage's after the inductance.

The first sample of the voltage residual is, for a current sensor, R T/2 + L times the error's step over T, and R times
the error from then on.
"""

from __future__ import annotations

from math import hypot, sqrt
from typing import Annotated

from gateway_fdi.jit import Record, f8s, i8, i8s, kernel, means

#: Voltage residuals that are kept.
RING = 256
#: Of the last ones so many are searched for the onset; before it, and behind it, so many are averaged.
SEARCH, BEFORE, BEHIND = 220, 12, 6
#: First sample over the following ones: a current sensor's error lies above the one, a voltage's below the other.
AT_LEAST, AT_MOST = 1.5, 1.2
#: A step stands out of the noise before it by this factor at least.
STANDS_OUT = 3.5
#: How a step begins; UNKNOWN: none stands out, or too little was kept; UNSEEN: while nothing was kept, or neither.
UNKNOWN, AT_ONCE, DELAYED, UNSEEN = range(4)


class State(Record):
    """State: the last voltage residuals, in stator co-ordinates."""

    at: i8 = means("place of the next residual")
    held: i8 = means("residuals that there are")
    alpha: Annotated[f8s, RING] = means("voltage residual", "V")
    beta: Annotated[f8s, RING] = means("likewise", "V")
    behind: Annotated[i8s, RING] = means("1: residuals are missing before it")
    torn: i8 = means("1: the next residual does not follow the last one")


@kernel
def keep(s: State, alpha: float, beta: float) -> None:
    """Keep a voltage residual [V]."""
    s.alpha[s.at] = alpha
    s.beta[s.at] = beta
    s.behind[s.at], s.torn = s.torn, 0
    s.at = (s.at + 1) % RING
    s.held = min(s.held + 1, RING)


@kernel
def _step(s: State, back: int) -> tuple[float, float, float]:
    """Look at the step whose first sample is ``back`` frames ago.

    Args:
        back: frames, BEHIND at least.

    Returns:
        the step over the noise before it; the product of its first sample with the mean of the following ones [V^2];
        magnitude of this mean [V].
    """
    base_a = base_b = 0.0
    spread = 0.0
    for k in range(BEFORE):
        j = (s.at - 1 - back - BEFORE + k) % RING
        base_a += s.alpha[j] / BEFORE
        base_b += s.beta[j] / BEFORE
    for k in range(BEFORE):
        j = (s.at - 1 - back - BEFORE + k) % RING
        spread += (s.alpha[j] - base_a) ** 2 + (s.beta[j] - base_b) ** 2
    first = (s.at - 1 - back) % RING
    y_a, y_b = s.alpha[first] - base_a, s.beta[first] - base_b
    m_a = m_b = 0.0
    for k in range(1, BEHIND + 1):
        j = (first + k) % RING
        m_a += (s.alpha[j] - base_a) / BEHIND
        m_b += (s.beta[j] - base_b) / BEHIND
    step = hypot(m_a, m_b)
    noise = sqrt(spread / BEFORE) + 1e-3
    standing = min(step, hypot(y_a, y_b)) / noise if step > 0.0 else 0.0
    return standing, y_a * m_a + y_b * m_b, step


@kernel
def shape(s: State) -> int:
    """Tell how the step of the voltage residual begins."""
    if s.held < RING:
        return UNKNOWN
    best, ratio, unseen = 0.0, 0.0, 0
    for back in range(BEHIND + 1, SEARCH):
        # The onset is where the step stands out most from what was before.
        standing, product, step = _step(s, back)
        if standing > best:
            best = standing
            ratio = product / (step * step)
            unseen = s.behind[(s.at - 1 - back) % RING]
    if best < STANDS_OUT:
        return UNKNOWN
    if ratio > AT_LEAST and unseen == 0:
        return AT_ONCE
    return DELAYED if ratio < AT_MOST and unseen == 0 else UNSEEN
