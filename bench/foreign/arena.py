"""The plants of ``gateway evaluate structural``, which the arena has too, with parameters that are 5 % off.

One fault at a time, as the study has it.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from foreign.plant import Array, Plant

from gateway_plants.structural.study import foreign
from gateway_plants.structural.study.drives import as_bought, off, run

#: Length of a drive of the study for which times are as the other plants have them [s].
_USUAL_S = 60.0


def _made(own: foreign.Plant) -> Plant:
    """Return a plant of the study as a plant here."""

    def drive(seed: int, count: int, faults: Mapping[str, Array]) -> Array:
        name, course = next(iter(faults.items()), ("", np.zeros(count)))
        onset = float(np.argmax(course != 0.0)) * own.period_s
        rows = run(own, count * own.period_s, seed, name, onset, off(own, 0.05, seed))
        return as_bought(own, rows, seed)

    sensors = {fault: z for fault, moved in own.faults.items() for z in moved if z in own.knowns}
    sizes = dict.fromkeys(own.faults, (1.0,))
    options, pace = own.told + own.options, own.seconds / _USUAL_S
    return Plant(own.name, own.model, own.period_s, own.knowns, options, sizes, sensors, drive, pace)


ARENA = tuple(map(_made, foreign.PLANTS.values()))
