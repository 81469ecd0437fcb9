"""Ours: residuals of the structural model; and the same residuals with thresholds that are fixed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from gateway_arena.contract import SAMPLES, Array, Found, NotForThisPlantError, Plant, Record
from gateway_arena.indexes import Bools
from gateway_arena.methods.cusum import Accumulated, settled
from gateway_fdi import FAILED, PASSED, Component, Diagnoser, GatewayError, Link, Sized, Test, residuals

#: Bandwidth of the residuals' filters, in samples; and the power that a test is believed to have.
BANDWIDTH, POWER = 0.05, 0.9
#: Samples whose mean residual is explained by sizes of faults; and from one explanation to the next one.
WINDOW, EVERY = 120, 400
#: Size of a fault whose gain is its slope; by what share gains are believed to be wrong; and by what factor noise is
#: larger than a few healthy records say.
SMALL, GAIN_ERROR, MORE = 1e-4, 0.1, 2.0
#: How often something else than a fault of the model is the cause; and how often a test fails that does not see it.
OTHER, ALARM = 1e-4, 1e-4
#: A fault is told apart from the likeliest one if it is this many times less likely; else they share.
APART = 10.0


class Structural:
    """Residuals that tell apart as much as the structure gives, a CUSUM each, and the Diagnoser of what fires.

    Which tests fire is not enough: a small fault fires some of its tests only, which is the pattern of another one. So
    the Diagnoser gets the residuals' means and what each fault leaves in each for 1 of its size, 0 where the structure
    says so: one size has to fit all. Something that is no fault of the model is always among the causes.

    Attributes:
        every: samples from one explanation to the next.
    """

    every = EVERY

    def fit(self, plant: Plant, healthy: Sequence[Record], faulty: Sequence[Record]) -> None:
        """Derive the residuals, and learn what is typical of each."""
        del faulty
        self._faults, self._knowns = tuple(plant.sizes), plant.knowns
        self._residuals = self._derived(plant)
        runs = [self._computed(record) for record in healthy]
        self._learn([[run[k] for run in runs] for k in range(len(self._residuals))])
        means = [[_means(settled(run[k])) for run in runs] for k in range(len(self._residuals))]
        self._noise = MORE * np.sqrt([np.mean(np.concatenate(each) ** 2) for each in means])

    def _derived(self, plant: Plant) -> Sequence[Any]:
        try:
            return residuals(plant.model, filter_bandwidth=BANDWIDTH / plant.period_s)
        except GatewayError as error:
            raise NotForThisPlantError(str(error)) from error

    def _computed(self, record: Record) -> list[Array]:
        values = dict(zip(self._knowns, record.values.T, strict=True))
        return [residual.run(record.t_s, values) for residual in self._residuals]

    def _learn(self, healthy: list[list[Array]]) -> None:
        self._rules = [Accumulated(each) for each in healthy]

    def _norms(self, residual: Array, k: int) -> Array:
        """Return a residual over its threshold, shape (n,)."""
        return self._rules[k].run(residual)

    def _begun(self, norms: Array) -> int:
        """Return the sample at which a test that fires now left its rest: the likeliest begin of what it sees."""
        resting = np.flatnonzero(norms == 0.0)
        return int(resting[-1]) + 1 if len(resting) else 0

    def run(self, record: Record) -> Found:
        """Return the largest of the tests, and the causes of those that have fired."""
        computed = self._computed(record)
        norms = np.stack([self._norms(residual, k) for k, residual in enumerate(computed)], 1)
        return Found(norms.max(1), self._weighed(record, computed, norms))

    def _weighed(self, record: Record, computed: Sequence[Array], norms: Array) -> Array:
        """Return the probability of each fault, shape (n, faults)."""
        weights = np.zeros((len(norms), len(self._faults)))
        for end in range(self.every, len(norms) + 1, self.every):
            if self._fired(norms[:end]).any():
                weights[end - 1 : end - 1 + self.every] = self._causes(record, computed, norms[:end])
        return weights

    def _fired(self, norms: Array) -> Bools:
        """Return the tests that fire now, shape (tests,)."""
        return np.asarray(norms[-1] > 1.0)

    def _causes(self, record: Record, computed: Sequence[Array], norms: Array) -> Array:
        """Return the probability of each fault at the end of some samples, in which a test has fired."""
        end, failed = len(norms), self._fired(norms)
        begun = min(self._begun(column) for column in norms.T[failed])
        window = slice(max(begun, end - WINDOW), end)
        means = np.array([residual[window].mean() for residual in computed])
        noise = self._noise * np.sqrt(WINDOW / (window.stop - window.start))
        gains = self._gains(record, begun, window, means, noise)
        tests = [Test(str(k), (*self._links(k), Link("", 0.5))) for k in range(len(gains))]
        diagnoser = Diagnoser([*(Component(f, "plant") for f in self._faults), Component("", prior=OTHER)], tests)
        for k, known in enumerate(gains):
            diagnoser.size(str(k), Sized(means[k], noise[k], known, GAIN_ERROR))
            diagnoser.update(str(k), FAILED if failed[k] else PASSED, 1, means[k])
        weights = np.zeros(len(self._faults))
        for names, probability in diagnoser.causes():
            weights[[self._faults.index(name) for name in names if name]] += probability
        return apart(weights)

    def _links(self, k: int) -> list[Link]:
        """Return how a test sees each fault: one that leaves no residual there has to fit that none is there."""
        return [Link(f, POWER if f in self._residuals[k].faults else ALARM) for f in self._faults]

    def _gains(self, record: Record, begun: int, window: slice, means: Array, noise: Array) -> list[dict[str, float]]:
        """Return the gain of each fault in each residual's mean: first the slope, then that of the size it gives."""
        first, end = max(window.stop - SAMPLES, 0), window.stop
        times, values = record.t_s[first:end], dict(zip(self._knowns, record.values[first:end].T, strict=True))
        window, begun = slice(window.start - first, end - first), max(begun - first, 0)
        found = [dict.fromkeys(set(self._faults) - set(residual.faults), 0.0) for residual in self._residuals]
        for fault in self._faults:
            sees = [k for k, residual in enumerate(self._residuals) if fault in residual.faults]
            size = SMALL
            for _ in range(2):
                courses = (self._residuals[k].gain(fault, times, values, size=size, since=begun) for k in sees)
                gains = np.array([course[window].mean() for course in courses])
                if not np.isfinite(gains).all():
                    break
                for k, gain in zip(sees, gains.tolist(), strict=True):
                    found[k][fault] = gain
                scaled = gains / noise[sees]
                if not scaled.any():
                    break
                size = float(scaled @ (means[sees] / noise[sees]) / (scaled @ scaled))
                if size == 0.0:
                    break
        return found


def apart(weights: Array) -> Array:
    """Have faults share that are not told apart."""
    alike = weights > weights.max() / APART
    if alike.any():
        weights[alike] = weights[alike].mean()
    return weights


def _means(values: Array) -> Array:
    """Return the means of all windows."""
    return np.convolve(values, np.full(WINDOW, 1.0 / WINDOW), "valid")


class Fixed(Structural):
    """The residuals of :class:`Structural` against the largest that a healthy one was: no accumulation."""

    def _learn(self, healthy: list[list[Array]]) -> None:
        self._largest = [max(float(np.abs(settled(run)).max()) for run in each) for each in healthy]

    def _norms(self, residual: Array, k: int) -> Array:
        return np.asarray(np.abs(residual) / self._largest[k])

    def _begun(self, norms: Array) -> int:
        return int(np.argmax(norms > 1.0))
