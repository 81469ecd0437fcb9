"""What the estimators are given: demands, loads, parameter spread, faults (paper 001; nothing of it is published)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gateway_fdi.filters.motor import Motor
from gateway_plants.steering.ecu.plant import Plant

#: Length of a run [s]; its first second is warm-up.
DURATION, WARM_UP = 24.0, 1.0


@dataclass(frozen=True)
class Spread:
    """Ranges from which a run's motor is drawn, factors of its values; loads; dead time [V]; Coulomb [N m]."""

    resistance: tuple[float, float] = (0.9, 1.3)
    flux: tuple[float, float] = (0.95, 1.02)
    inertia: tuple[float, float] = (0.8, 1.3)
    dead: tuple[float, float] = (0.0, 0.05)
    coulomb: tuple[float, float] = (0.01, 0.04)
    load: tuple[float, float] = (-1.5, 1.5)

    def draw(self, rng: np.random.Generator) -> tuple[Plant, float]:
        """Return a plant and the scale of its load."""
        m = Motor()
        drawn = replace(
            m,
            resistance=m.resistance * rng.uniform(*self.resistance),
            flux=m.flux * rng.uniform(*self.flux),
            inertia=m.inertia * rng.uniform(*self.inertia),
        )
        plant = Plant(motor=drawn, dead=rng.uniform(*self.dead), coulomb=rng.uniform(*self.coulomb))
        return plant, float(rng.uniform(*self.load))
