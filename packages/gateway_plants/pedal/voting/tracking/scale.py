"""How far readings may lie apart for noise and resolution alone: what every gate of the voter is made of.

As the data sheet says, until something has measured the sensors (:mod:`gateway_plants.pedal.voting.identification`).
"""

from __future__ import annotations

import math

from gateway_fdi.jit import Record, f8, i8, kernel, means
from gateway_plants.pedal.voting.tracking.channel_activity import FEW

#: Standard deviations of a gate: 6e-7 of normal innovations lie outside.
GATE = 5.0
#: Steps of the resolution that the others must stray for a channel's silence to count: a sensor quieter than its data
#: sheet says repeats itself at rest, and in slow movement, while its neighbour goes on by a step or two.
LIVELY = 3.0
#: A count that is not reached.
NEVER = 1 << 62


class Scale(Record):
    """Gates, in the unit of the readings."""

    variance: f8 = means("variance of a reading")
    agree: f8 = means("largest difference of readings that agree")
    straight: f8 = means("largest second difference on a line")
    noise_gate: f8 = means("largest change of a parity that is noise")
    silent: i8 = means("repetitions that no live channel makes")
    lively: f8 = means("movement of the others that a live channel shows, too")
    step: f8 = means("resolution")


@kernel
def silent(noise: float, step: float) -> int:
    """Return how often a live channel hardly ever repeats a reading: probability 1e-8 at the likeliest one."""
    if noise == 0.0:
        return NEVER
    likeliest = math.erf(step / (2.0 * math.sqrt(2.0) * noise))
    if likeliest == 0.0:
        return FEW
    if likeliest >= 0.9:
        return NEVER
    return max(FEW, math.ceil(math.log(1e-8) / math.log(likeliest)))


@kernel
def measure(s: Scale, noise: float, step: float, span: float, bend: float) -> None:
    """Fill the scale.

    Args:
        noise: standard deviation of a reading.
        step: resolution of a reading.
        span: of the quantity.
        bend: standard deviation of the change of slope in one sample.
    """
    least = 2e-5 * span  # arithmetic and what no data sheet says
    s.variance = noise**2 + step**2 / 12.0 + least**2
    s.agree = max(GATE * math.sqrt(2.0 * s.variance) + step / 2.0, 1.2e-3 * span)
    s.noise_gate = GATE * math.sqrt(2.0 * s.variance) + step
    s.straight = GATE * math.sqrt(6.0 * s.variance) + 6.0 * bend
    s.silent = silent(noise, step)
    s.lively = LIVELY * step
    s.step = step
