"""Rival that knows the plant's dynamics, by filterpy: innovations of a Kalman filter."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gateway_arena.contract import Array, Dynamics, Found, Plant, Record
from gateway_arena.methods.cusum import Accumulated, settled

#: Disturbance of each state per sample, as a share of its typical value: the likeliest of these is taken.
SHARES = (1e-6, 1e-5, 1e-4, 1e-3, 1e-2)


class Kalman:
    """Innovations of a Kalman filter, squared by their covariance (chi-squared), and their CUSUM."""

    def fit(self, plant: Plant, healthy: Sequence[Record], faulty: Sequence[Record]) -> None:
        """Choose the disturbance that makes the first healthy record likeliest."""
        del faulty
        self._plant, self._m = plant, len(plant.commands)
        self._r = np.diag(np.array(plant.noise[self._m :]) ** 2)
        self._flows: dict[bytes, Dynamics] = {}
        here = self._flow(healthy[0].values[0, : self._m])
        self._start = np.linalg.lstsq(here.c, healthy[0].values[0, self._m :] - here.d, rcond=None)[0]
        self._typical = np.abs(self._start) + 1e-6
        likely = []
        for share in SHARES:
            self._q = np.diag((share * self._typical) ** 2)
            likely.append(sum(settled(self._innovations(healthy[0])[1])))
        self._q = np.diag((SHARES[int(np.argmax(likely))] * self._typical) ** 2)
        self._rule = Accumulated([self._statistic(record) for record in healthy])

    def _flow(self, command: Array) -> Dynamics:
        if (key := command.tobytes()) not in self._flows:
            self._flows[key] = self._plant.dynamics(command)
        return self._flows[key]

    def _innovations(self, record: Record) -> tuple[Array, Array]:
        """Return the squared innovations, and their log-likelihoods, shape (n,)."""
        from filterpy.kalman import KalmanFilter  # noqa: PLC0415 - slow to load

        states, outputs = len(self._start), len(self._r)
        kalman = KalmanFilter(states, outputs)
        kalman.x, kalman.P = self._start[:, None].copy(), np.diag((0.3 * self._typical) ** 2)
        kalman.R, kalman.Q = self._r, self._q
        squared, likely = np.empty(len(record.values)), np.empty(len(record.values))
        before = self._flow(record.values[0, : self._m])
        for k, row in enumerate(record.values):
            if k:
                kalman.predict(F=before.phi, B=before.g[:, None], u=np.ones((1, 1)))
            before = self._flow(row[: self._m])
            kalman.update((row[self._m :] - before.d)[:, None], H=before.c)
            e, inverse = kalman.y[:, 0], kalman.SI
            squared[k] = e @ inverse @ e
            likely[k] = 0.5 * (np.linalg.slogdet(inverse)[1] - squared[k])
        return squared, likely

    def _statistic(self, record: Record) -> Array:
        return self._innovations(record)[0]

    def run(self, record: Record) -> Found:
        """Return the CUSUM of the statistic."""
        return Found(self._rule.run(self._statistic(record)))
