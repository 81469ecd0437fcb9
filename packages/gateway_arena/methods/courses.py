"""Ours: the residuals of the structural model, and which fault's course fits theirs with one size."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from itertools import islice
from typing import Any

import numpy as np

from gateway_arena.contract import SAMPLES, Array, Plant, Record
from gateway_arena.indexes import Bools
from gateway_arena.methods.cusum import settled
from gateway_arena.methods.structural import BANDWIDTH, GAIN_ERROR, MORE, OTHER, SMALL, Structural, apart
from gateway_arena.score import diagnoses
from gateway_fdi import analyse
from gateway_fdi.residual import of_set

#: Samples that are explained at most, and their parts; iterations for a fault's size, and share at which it stays;
#: samples whose mean is tested.
WINDOW, PARTS, ITERATIONS, STAYS, MEAN = 480, 12, 6, 0.02, 30
#: A test counts above the largest T over J of healthy records by this factor, and above the least one.
BAR, LEAST = 1.2, 0.05


class Courses(Structural):
    """As :class:`Structural`, but a size has to fit the residuals of each part of a window, not their means alone.

    A leak and a sensor's gain can leave the same mean; along a drive, with other pressures, they leave other courses.
    The likelihoods are Gaussian, of mean residuals of the parts; something that is no fault of the model fits all.
    Faults that the structure cannot tell apart share: a clogged valve has no constant force, its course blames others.
    """

    def fit(self, plant: Plant, healthy: Sequence[Record], faulty: Sequence[Record]) -> None:
        """Derive the residuals, and learn what is typical of each and of its means."""
        super().fit(plant, healthy, faulty)
        length = WINDOW // PARTS
        runs = [self._computed(record) for record in healthy]
        means = [
            np.concatenate([np.convolve(settled(run[k]), np.full(length, 1 / length), "valid") for run in runs])
            for k in range(len(self._residuals))
        ]
        self._noise = MORE * np.sqrt([np.mean(each**2) for each in means])
        norms = [[settled(self._norms(run[k], k)).max() for run in runs] for k in range(len(self._residuals))]
        self._bars = np.maximum(BAR * np.array(norms).max(1), LEAST)
        groups = diagnoses(plant.model, self._faults)
        self._shared = np.array([np.isin(np.arange(len(groups)), group) / len(group) for group in groups])

    def _derived(self, plant: Plant) -> Sequence[Any]:
        """Derive the fewest residuals, and for each fault the one of the fewest equations: it has the least noise."""
        found, analysis = list(super()._derived(plant)), analyse(plant.model)
        usable = np.flatnonzero(analysis.candidates.sets(analysis.candidates.chosen("SDI", "unique")))
        small = usable[np.argsort(analysis.msos[usable].sum(1), kind="stable")]
        sees = analysis.signature[small]
        for number in sorted({*small[sees[:, sees.any(0)].argmax(0)].tolist()} - {*analysis.fewest.tolist()}):
            found += islice(of_set(analysis, number, {"filter_bandwidth": BANDWIDTH / plant.period_s}), 1)
        return found

    def _learn(self, healthy: list[list[Array]]) -> None:
        super()._learn([[_mean(run) for run in each] for each in healthy])

    def _norms(self, residual: Array, k: int) -> Array:
        return super()._norms(_mean(residual), k)

    def _fired(self, norms: Array) -> Bools:
        """Return the tests that fired within the window: what a drive hides now, it has shown before."""
        return np.asarray((norms[-WINDOW:] > self._bars).any(0))

    def _causes(self, record: Record, computed: Sequence[Array], norms: Array) -> Array:
        """Return the probability of each fault at the end of some samples, in which a test has fired."""
        end = len(norms)
        first = np.argmax(norms > self._bars, 0)[self._fired(norms)]
        begun = min(self._begun(column[: k + 1]) for column, k in zip(norms.T[self._fired(norms)], first, strict=True))
        start = min(max(begun, end - WINDOW), end - PARTS)
        edges = np.linspace(start, end, PARTS + 1).astype(int)[:-1]
        lengths = np.diff(edges, append=end)

        def parts(course: Array) -> Array:
            return np.asarray(np.add.reduceat(course[:end], edges) / lengths)

        means = np.array([parts(residual) for residual in computed])
        noise = self._noise[:, None] * np.sqrt(WINDOW / PARTS / lengths)
        first = max(end - SAMPLES, 0)
        times, since = record.t_s[first:end], max(begun - first, 0)
        values = dict(zip(self._knowns, record.values[first:end].T, strict=True))

        def gains(fault: str, size: float) -> Array:
            found = np.zeros(means.shape)
            for k, residual in enumerate(self._residuals):
                if fault in residual.faults:
                    course = np.zeros(end)
                    course[first:] = residual.gain(fault, times, values, size=size, since=since)
                    found[k] = parts(course)
            return found

        unlike = [self._unlike(means, noise, partial(gains, fault)) for fault in self._faults]
        unlike.append(means.size - 2.0 * np.log(OTHER))
        weights = np.exp(-0.5 * (np.array(unlike) - min(unlike)))
        weights /= weights.sum()
        return apart(self._shared @ weights[:-1])

    @staticmethod
    def _unlike(means: Array, noise: Array, gains: Callable[[float], Array]) -> float:
        """Return the squared distance of a fault with its best size, by noise and errors of gains."""
        size = SMALL
        for _ in range(ITERATIONS):
            gain = gains(size)
            if not np.isfinite(gain).all() or not gain.any():
                return np.inf
            before = size
            with np.errstate(all="ignore"):  # gains of a record that has run away
                variance = noise**2 + (GAIN_ERROR * gain * size) ** 2
                size = float((gain * means / variance).sum() / (gain**2 / variance).sum())
            if not 0.0 < abs(size) < np.inf:
                return np.inf
            if abs(size - before) < STAYS * abs(size):
                break
        variance = noise**2 + (GAIN_ERROR * gain * size) ** 2
        return float(((means - gain * size) ** 2 / variance).sum())


def _mean(residual: Array) -> Array:
    """Return the mean of the last samples: what a drive's changes leave comes and goes."""
    return np.convolve(residual, np.full(MEAN, 1.0 / MEAN))[: len(residual)]
