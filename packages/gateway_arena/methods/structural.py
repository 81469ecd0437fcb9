"""Ours: residuals of the structural model; and the same residuals with thresholds that are fixed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gateway_arena.contract import Array, Found, NotForThisPlantError, Plant, Record
from gateway_arena.methods.accumulated import Accumulated, settled
from gateway_fdi import FAILED, PASSED, Component, Diagnoser, GatewayError, Link, Test, residuals

#: Bandwidth of the residuals' filters, in samples; and the power that a test is believed to have.
BANDWIDTH, POWER = 0.05, 0.9


class Structural:
    """Residuals that tell apart as much as the structure gives, a CUSUM each, and the Diagnoser of what fires."""

    def fit(self, plant: Plant, healthy: Sequence[Record], faulty: Sequence[Record]) -> None:
        """Derive the residuals, and learn what is typical of each.

        Raises:
            NotForThisPlantError: no residual of it can be computed.
        """
        del faulty
        self._faults, self._knowns = tuple(plant.sizes), plant.knowns
        try:
            self._residuals = residuals(plant.model, filter_bandwidth=BANDWIDTH / plant.period_s)
        except GatewayError as error:
            raise NotForThisPlantError(str(error)) from error
        runs = [self._computed(record) for record in healthy]
        self._learn([[run[k] for run in runs] for k in range(len(self._residuals))])
        self._known: dict[bytes, Array] = {}

    def _computed(self, record: Record) -> list[Array]:
        values = dict(zip(self._knowns, record.values.T, strict=True))
        return [residual.run(record.t_s, values) for residual in self._residuals]

    def _learn(self, healthy: list[list[Array]]) -> None:
        self._rules = [Accumulated(each) for each in healthy]

    def _norms(self, residual: Array, k: int) -> Array:
        """Return a residual over its threshold, shape (n,)."""
        return self._rules[k].run(residual)

    def run(self, record: Record) -> Found:
        """Return the largest of the tests, and the causes of those that have fired."""
        norms = np.stack([self._norms(residual, k) for k, residual in enumerate(self._computed(record))], 1)
        fired = norms > 1.0
        return Found(norms.max(1), np.stack([self._causes(row) for row in fired]))

    def _causes(self, fired: np.ndarray) -> Array:
        """Return the probability of each fault for a pattern of tests."""
        if (key := fired.tobytes()) not in self._known:
            diagnoser = Diagnoser(
                [Component(fault, "plant") for fault in self._faults],
                [
                    Test(str(k), tuple(Link(f, POWER) for f in r.faults if f in self._faults))
                    for k, r in enumerate(self._residuals)
                ],
            )
            for k, failed in enumerate(fired.tolist()):
                diagnoser.update(str(k), FAILED if failed else PASSED, 1)
            weights = np.zeros(len(self._faults))
            for names, probability in diagnoser.causes() if fired.any() else ():
                weights[[self._faults.index(name) for name in names]] += probability
            self._known[key] = weights
        return self._known[key]


class Fixed(Structural):
    """The residuals of :class:`Structural` against the largest that a healthy one was: no accumulation."""

    def _learn(self, healthy: list[list[Array]]) -> None:
        self._largest = [max(float(np.abs(settled(run)).max()) for run in each) for each in healthy]

    def _norms(self, residual: Array, k: int) -> Array:
        return np.asarray(np.abs(residual) / self._largest[k])
