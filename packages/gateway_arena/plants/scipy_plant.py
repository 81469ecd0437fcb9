"""Plants with slopes of their states, which SciPy solves apart from the gateway's code."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from gateway_arena.contract import SAMPLES, Array, Dynamics, Record
from gateway_fdi.structure.file import load_model
from gateway_plants.structural.study.drives import off as parameters_off
from gateway_plants.structural.study.drives import run
from gateway_plants.structural.study.foreign import PLANTS

#: Plant -> its source.
SOLVED = {
    "spring": "mass, spring, damper; textbook",
    "buck": "buck converter, averaged over a switching period; textbook",
    "stiff_motor": "DC motor, stiff; textbook",
    "quad": "quadruple tank; Johansson 2000",
    "wind": "drive train of the wind turbine benchmark; Odgaard, Stoustrup, Kinnaert 2013",
}
#: Shares of a record between which the fault sets in.
ONSET = (0.45, 0.55)


def onset_of(seed: int) -> int:
    """Return the sample at which the fault of a record sets in."""
    return int(SAMPLES * np.random.default_rng([seed, 3]).uniform(*ONSET))


class SolvedPlant:
    """A plant of :mod:`gateway_plants.structural.study.foreign` as the arena takes it."""

    def __init__(self, name: str) -> None:
        self.name = name
        self._plant = plant = PLANTS[name]
        self.source = SOLVED[name]
        self.model = load_model(tomllib.loads(plant.model))
        self.period_s, self.knowns, self.noise = plant.period_s, plant.knowns, plant.noise
        self.commands = tuple(z for z, sigma in zip(plant.knowns, plant.noise, strict=True) if not sigma)
        self.sizes: Mapping[str, str] = {
            fault: ", ".join(f"{key} = {value:g} (healthy {plant.p[key]:g})" for key, value in changed.items())
            for fault, changed in plant.faults.items()
        }

    def record(self, seed: int, fault: str = "", off: float = 0.0, size: float = 1.0) -> Record:
        """Return a run (:class:`gateway_arena.contract.Plant`)."""
        onset = onset_of(seed) if fault else SAMPLES
        p = parameters_off(self._plant, off, seed) if off else None
        seconds = SAMPLES * self.period_s
        p0 = self._plant.p
        faults = {
            name: {key: p0[key] + size * (value - p0[key]) for key, value in changed.items()}
            for name, changed in self._plant.faults.items()
        }
        values = run(
            replace(self._plant, faults=faults), seconds, seed, fault, onset * self.period_s if fault else 0.0, p
        )
        return Record(np.arange(float(SAMPLES)) * self.period_s, values, fault, onset)

    def dynamics(self, command: Array) -> Dynamics:
        """Return its dynamics; of slopes that are not linear around the state that it begins with."""
        from scipy.linalg import expm  # noqa: PLC0415 - slow to load

        plant = self._plant
        x0 = np.array(plant.begin(plant.p), np.float64)
        n, small = len(x0), 1e-6 * np.maximum(np.abs(x0), 1e-3)

        def rates(x: Array) -> Array:
            return np.asarray(plant.slopes(x, command, plant.p), np.float64)

        def shown(x: Array) -> Array:
            read = np.array([float(value) for value in plant.measured(x, command, plant.p)])
            return np.asarray(read[len(self.commands) :])

        block = np.zeros((n + 1, n + 1))
        steps = [(e * h, h) for e, h in zip(np.eye(n), small, strict=True)]
        block[:n, :n] = np.stack([(rates(x0 + d) - rates(x0 - d)) / (2 * h) for d, h in steps], 1)
        block[:n, n] = rates(x0) - block[:n, :n] @ x0
        c = np.stack([(shown(x0 + d) - shown(x0 - d)) / (2 * h) for d, h in steps], 1)
        power = expm(block * self.period_s)
        return Dynamics(power[:n, :n], power[:n, n], c, shown(x0) - c @ x0)
