"""Whether a log is of the car that a database is of: more identifiers are common than by chance."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln

from gateway_fleet.learn.observe import Observation

#: Identifiers of 11 bits; chance explains what both have in common less often than this.
IDENTIFIERS, CHANCE = 2048, 1e-3


def strangers(observation: Observation, buses: Sequence[str]) -> list[str]:
    """Return the buses whose log does not look as if it belonged to their databases, one line each.

    Of M identifiers in a database and n in a log, all of 2048 that there may be, chance gives m in common with the
    hypergeometric law. Those that have another length than in the database are not in common. An identifier of 29 bits
    that both have is no chance.
    """
    said = []
    for bus, name in enumerate(buses):
        all_ = [seen for (index, _), seen in observation.seen.items() if index == bus]
        mine = [seen for seen in all_ if not seen.unknown]
        alike = [seen for seen in mine if seen.lengths and max(seen.lengths) <= seen.message.length]
        told = len(mine) + sum(index == bus for index, _ in observation.absent)
        if not told or any(seen.message.is_extended_frame for seen in alike):
            continue
        came = len(all_) + sum(index == bus for index, _ in observation.foreign)
        chance = _chance(len(alike), min(told, IDENTIFIERS), min(came, IDENTIFIERS))
        if chance > CHANCE:
            said.append(
                f"{name}: THE LOG DOES NOT LOOK AS IF IT WERE OF THIS DATABASE: of its {told} messages {len(alike)}"
                f" came, of {came} identifiers in the log; chance alone gives as many with probability {chance:.2g}"
            )
    return said


def _chance(alike: int, told: int, came: int) -> float:
    """Return how likely two sets of identifiers have as many in common, or more: the hypergeometric law's tail."""
    common = np.arange(max(alike, told + came - IDENTIFIERS), min(told, came) + 1)
    ways = _log_ways(told, common) + _log_ways(IDENTIFIERS - told, came - common) - _log_ways(IDENTIFIERS, came)
    return float(np.exp(ways).sum())


def _log_ways(of: int, chosen: int | NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the logarithm of a binomial coefficient."""
    return np.asarray(gammaln(of + 1) - gammaln(np.add(chosen, 1)) - gammaln(np.subtract(of, chosen) + 1), np.float64)
