"""Rival: residuals of the equations, selected by data with the L1 norm (Jung, Frisk, Automatica 97, 2018).

The winners of LiU-ICE 2025, too, feed residuals of the structure to a classifier (Coursey and others, OASIcs 136.15).
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import islice

import numpy as np

from gateway_arena.contract import Array, Found, NotForThisPlantError, Plant, Record
from gateway_arena.methods.cusum import Accumulated, settled, summed
from gateway_arena.methods.machine_learning import KEPT, SEED, Classes
from gateway_arena.methods.structural import BANDWIDTH
from gateway_fdi import analyse
from gateway_fdi.residual import of_set

#: Residuals that are given to the classifier at most; samples that it sees the mean of; weight of the norm.
MOST, WINDOW, NORM = 32, 60, 3e-3


class Selected:
    """A linear classifier (logistic, L1) of the mean residuals of 32 sets, the smallest; the CUSUM of its alarm."""

    supervised = True

    def fit(self, plant: Plant, healthy: Sequence[Record], faulty: Sequence[Record]) -> None:
        """Derive the residuals, and learn which of them tell what."""
        from sklearn.linear_model import SGDClassifier  # noqa: PLC0415 - slow to load, and an extra

        self._knowns = plant.knowns
        analysis = analyse(plant.model)
        usable = np.flatnonzero(analysis.candidates.sets(analysis.candidates.chosen("SDI", "unique")))
        options = {"filter_bandwidth": BANDWIDTH / plant.period_s}
        made = (
            residual
            for number in usable[np.argsort(analysis.msos[usable].sum(1), kind="stable")].tolist()
            for residual in islice(of_set(analysis, number, options), 1)
        )
        self._residuals = list(islice(made, MOST))
        if not self._residuals:
            raise NotForThisPlantError("no equation of the model can be checked by the others")
        first = [settled(self._means(record)) for record in healthy[:-KEPT]]
        self._scale = np.concatenate(first).std(0) + 1e-12
        classifier = SGDClassifier(
            loss="log_loss", penalty="l1", alpha=NORM, class_weight="balanced", random_state=SEED
        )
        seen = [(r.fault, self._shaped(self._means(r)[r.onset + WINDOW :])) for r in faulty]
        self._classes = Classes(classifier, self._shaped(np.concatenate(first)), seen, tuple(plant.sizes))
        self._rule = Accumulated([self._judged(record)[0] for record in healthy[-KEPT:]])

    def _means(self, record: Record) -> Array:
        """Return the mean residuals of the last samples, shape (n, residuals)."""
        values = dict(zip(self._knowns, record.values.T, strict=True))
        found = np.array([residual.run(record.t_s, values) for residual in self._residuals])
        return summed(np.nan_to_num(found).T, WINDOW) / WINDOW

    def _shaped(self, means: Array) -> Array:
        bent = np.arcsinh(means / self._scale)
        return np.hstack([bent, np.abs(bent)])

    def _judged(self, record: Record) -> tuple[Array, Array]:
        return self._classes.judged(self._shaped(self._means(record)))

    def run(self, record: Record) -> Found:
        """Return the CUSUM of the probability that something is wrong, and that of each fault."""
        statistic, weights = self._judged(record)
        return Found(self._rule.run(statistic), weights)
