"""Ours: the bank of PI-observers, on the plant's dynamics at its typical command."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from gateway_arena.contract import SETTLE, Found, NotForThisPlantError, Plant, Record
from gateway_arena.methods.cusum import joined
from gateway_fdi import GatewayError
from gateway_plants.linear.arrays import PiBank

#: Sizes of faults that are to be found: of a command's typical value, of a reading's noise; the states' disturbance.
SHARE, NOISES, DISTURBANCE = 0.05, 5.0, 1e-3


class Bank:
    """Which command or sensor is wrong, by :class:`gateway_plants.linear.arrays.PiBank`."""

    def fit(self, plant: Plant, healthy: Sequence[Record], faulty: Sequence[Record]) -> None:
        """Design the bank."""
        del faulty
        m = len(plant.commands)
        u0 = joined(healthy)[:, :m].mean(0)
        here = plant.dynamics(u0)
        steps = [plant.dynamics(u0 + e * max(abs(u), 1.0) * 1e-3) for e, u in zip(np.eye(m), u0, strict=True)]
        gamma = np.stack([(s.g - here.g) / (max(abs(u), 1.0) * 1e-3) for s, u in zip(steps, u0, strict=True)], 1)
        x0 = np.linalg.lstsq(np.eye(len(here.g)) - here.phi, here.g, rcond=None)[0]
        self._u0, self._y0, self._m = u0, here.c @ x0 + here.d, m
        self._limits = np.array([*np.maximum(np.abs(u0), 1.0) * SHARE, *(NOISES * np.array(plant.noise[m:]))])
        self._made = partial(
            PiBank, here.phi, gamma, here.c, plant.period_s,
            noise=plant.noise[m:], actuator=self._limits[:m], sensor=self._limits[m:],
            disturbance=DISTURBANCE * (np.abs(x0) + 1e-6), mtfa_s=1e6 * plant.period_s,
            start_s=SETTLE * plant.period_s, hold_s=20 * plant.period_s, discrete=True,
        )  # fmt: skip
        columns = [*plant.commands, *plant.knowns[m:]]
        # a sensor, or a command that is not followed, is the only known variable of its fault's equation
        alone = {f: e.knowns[0] for e in plant.model.equations for f in e.faults if len(e.knowns) == 1}
        touched = [alone.get(fault) for fault in plant.sizes]
        self._place = [columns.index(z) if z in columns else -1 for z in touched]
        try:
            self._made()
        except GatewayError as error:
            raise NotForThisPlantError(str(error)) from error

    def run(self, record: Record) -> Found:
        """Return the largest size over its limit, or that something is not explained; and whom the bank accuses."""
        bank = self._made()
        found = bank.run(record.values[:, self._m :] - self._y0, record.values[:, : self._m] - self._u0)
        sizes = np.abs(np.hstack([found.fault, found.offset])) / self._limits
        flags = np.hstack([found.actuators, found.sensors]).astype(float)
        weights = np.stack([flags[:, k] if k >= 0 else np.zeros(len(flags)) for k in self._place], 1)
        total = np.maximum(flags.sum(1, keepdims=True), 1.0)
        return Found(sizes.max(1) + flags.max(1) + found.unexplained, weights / total)
