"""Rivals that learn from data, by scikit-learn: PCA, one-class SVM, random forest."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.stats import chi2

from gateway_arena.contract import Array, Fed, Found, Plant, Record
from gateway_arena.methods.accumulated import Accumulated, settled

#: Samples of a window; records at the end of the healthy ones that the CUSUM is learned from; seed of what is random.
WINDOW, KEPT, SEED = 20, 2, 1


class _Learned(Fed):
    """Windows of the scaled samples -> a statistic -> its CUSUM."""

    #: Least threshold: J itself.
    least = 1.0

    def fit(self, plant: Plant, healthy: Sequence[Record], faulty: Sequence[Record]) -> None:
        """Learn from healthy records, and from faulty ones if it is supervised."""
        first = np.concatenate([settled(record.values) for record in healthy[:-KEPT]])
        self._mean, self._scale = first.mean(0), first.std(0) + 1e-12
        self._faults = tuple(plant.sizes)
        self._learn(np.concatenate([settled(self._features(record)) for record in healthy[:-KEPT]]), faulty)
        self._rule = Accumulated([self._judged(self._features(record))[0] for record in healthy[-KEPT:]])

    def reset(self) -> None:
        """Begin a record."""
        self._before: Array | None = None
        self._rule.reset()

    def limit(self, threshold: float) -> None:
        """Have the score stay near a threshold, so that it comes down when a fault is gone."""
        self._rule.most = threshold

    def feed(self, values: Array) -> Found:
        """Return the statistic's CUSUM, and faults if it knows some."""
        statistic, weights = self._judged(self._next(values))
        return Found(self._rule.feed(statistic), weights)

    def _features(self, record: Record) -> Array:
        self._before = None
        return self._next(record.values)

    def _next(self, values: Array) -> Array:
        """Return each sample beside the mean and the change of its window, shape (n, 3 knowns)."""
        z = (values - self._mean) / self._scale
        self._begun = self._before is None
        before = np.repeat(z[:1], WINDOW - 1, 0) if self._before is None else self._before
        padded = np.vstack([before, z])
        self._before = padded[len(padded) - WINDOW + 1 :]
        sums = np.vstack([np.zeros(z.shape[1]), padded.cumsum(0)])
        mean = (sums[WINDOW:] - sums[:-WINDOW]) / WINDOW
        return np.hstack([z, mean, z - padded[: len(z)]])

    @abstractmethod
    def _learn(self, features: Array, faulty: Sequence[Record]) -> None:
        """Learn from features of healthy records, shape (n, 3 knowns), and from faulty records if it is supervised."""

    @abstractmethod
    def _judged(self, features: Array) -> tuple[Array, Array | None]:
        """Return of the next features a statistic, shape (n,), and weights of faults, (n, faults), None if none."""


class Pca(_Learned):
    """T2 and SPE of principal components that hold 95 % of the variance, each over its mean."""

    def _learn(self, features: Array, faulty: Sequence[Record]) -> None:
        from sklearn.decomposition import PCA  # noqa: PLC0415 - slow to load, and an extra

        del faulty
        self._pca = PCA(0.95, svd_solver="full").fit(features)
        self._scales = tuple(float(each.mean()) + 1e-12 for each in self._parts(features))

    def _parts(self, features: Array) -> tuple[Array, Array]:
        inside = self._pca.transform(features)
        left = features - self._pca.inverse_transform(inside)
        t2: Array = (inside**2 / self._pca.explained_variance_).sum(1) / chi2.mean(inside.shape[1])
        return t2, np.asarray((left**2).sum(1))

    def _judged(self, features: Array) -> tuple[Array, None]:
        parts = self._parts(features)
        return np.stack([part / scale for part, scale in zip(parts, self._scales, strict=True)]).max(0), None


class Svm(_Learned):
    """One-class SVM (RBF, nu 0.01) on at most 2000 samples."""

    def _learn(self, features: Array, faulty: Sequence[Record]) -> None:
        from sklearn.svm import OneClassSVM  # noqa: PLC0415 - slow to load, and an extra

        del faulty
        rows = np.random.default_rng(SEED).permutation(len(features))[:2000]
        self._svm: Any = OneClassSVM(nu=0.01, gamma="scale").fit(features[rows])

    def _judged(self, features: Array) -> tuple[Array, None]:
        return np.maximum(-self._svm.decision_function(features), 0.0) + 1e-3, None


class Forest(_Learned):
    """Random forest of 60 trees, which has seen records with each fault."""

    supervised = True

    def _learn(self, features: Array, faulty: Sequence[Record]) -> None:
        from sklearn.ensemble import RandomForestClassifier  # noqa: PLC0415 - slow to load, and an extra

        rng = np.random.default_rng(SEED)
        rows, kinds = [features[rng.permutation(len(features))[:3000]]], [np.zeros(min(3000, len(features)), np.int64)]
        for record in faulty:
            some = self._features(record)[record.onset + WINDOW :: 2]
            rows.append(some)
            kinds.append(np.full(len(some), 1 + self._faults.index(record.fault), np.int64))
        forest = RandomForestClassifier(
            60, max_depth=14, min_samples_leaf=3, class_weight="balanced", random_state=SEED
        )
        self._forest: Any = forest.fit(np.concatenate(rows), np.concatenate(kinds))

    def _judged(self, features: Array) -> tuple[Array, Array]:
        of_class = self._forest.predict_proba(features)
        weights = np.zeros((len(of_class), len(self._faults)))
        weights[:, self._forest.classes_[1:] - 1] = of_class[:, 1:]
        before: Array = np.zeros((WINDOW, weights.shape[1])) if self._begun else self._kept
        rows = np.vstack([before, weights])
        self._kept: Array = rows[len(rows) - WINDOW :]
        sums = np.vstack([np.zeros(weights.shape[1]), rows.cumsum(0)])
        return 1.0 - of_class[:, 0] + 1e-3, (sums[WINDOW + 1 :] - sums[1:-WINDOW]) / WINDOW
