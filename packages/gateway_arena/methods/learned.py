"""Rivals that learn from data, by scikit-learn: PCA, one-class SVM, random forest."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.stats import chi2

from gateway_arena.contract import Array, Found, Plant, Record
from gateway_arena.methods.accumulated import Accumulated, settled

#: Samples of a window; records at the end of the healthy ones that the CUSUM is learned from; seed of what is random.
WINDOW, KEPT, SEED = 20, 2, 1


class _Learned(ABC):
    """Windows of the scaled samples -> a statistic -> its CUSUM."""

    def fit(self, plant: Plant, healthy: Sequence[Record], faulty: Sequence[Record]) -> None:
        """Learn from healthy records, and from faulty ones if it is supervised."""
        first = np.concatenate([settled(record.values) for record in healthy[:-KEPT]])
        self._mean, self._scale = first.mean(0), first.std(0) + 1e-12
        self._faults = tuple(plant.sizes)
        self._learn(np.concatenate([settled(self._features(record)) for record in healthy[:-KEPT]]), faulty)
        self._rule = Accumulated([self._judged(record)[0] for record in healthy[-KEPT:]])

    def _features(self, record: Record) -> Array:
        """Return each sample beside the mean and the change of its window, shape (n, 3 knowns)."""
        z = (record.values - self._mean) / self._scale
        padded = np.vstack([np.repeat(z[:1], WINDOW - 1, 0), z])
        sums = np.vstack([np.zeros(z.shape[1]), padded.cumsum(0)])
        mean = (sums[WINDOW:] - sums[:-WINDOW]) / WINDOW
        return np.hstack([z, mean, z - padded[: len(z)]])

    @abstractmethod
    def _learn(self, features: Array, faulty: Sequence[Record]) -> None:
        """Learn from features of healthy records, shape (n, 3 knowns), and from faulty records if it is supervised."""

    @abstractmethod
    def _judged(self, record: Record) -> tuple[Array, Array | None]:
        """Return a record's statistic, shape (n,), and weights of faults, shape (n, faults), None if it knows none."""

    def run(self, record: Record) -> Found:
        """Return the statistic's CUSUM, and faults if it knows some."""
        statistic, weights = self._judged(record)
        return Found(self._rule.run(statistic), weights)


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

    def _judged(self, record: Record) -> tuple[Array, None]:
        parts = self._parts(self._features(record))
        return np.max([part / scale for part, scale in zip(parts, self._scales, strict=True)], 0), None


class Svm(_Learned):
    """One-class SVM (RBF, nu 0.01) on at most 2000 samples."""

    def _learn(self, features: Array, faulty: Sequence[Record]) -> None:
        from sklearn.svm import OneClassSVM  # noqa: PLC0415 - slow to load, and an extra

        del faulty
        rows = np.random.default_rng(SEED).permutation(len(features))[:2000]
        self._svm: Any = OneClassSVM(nu=0.01, gamma="scale").fit(features[rows])

    def _judged(self, record: Record) -> tuple[Array, None]:
        return np.maximum(-self._svm.decision_function(self._features(record)), 0.0) + 1e-3, None


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

    def _judged(self, record: Record) -> tuple[Array, Array]:
        of_class = self._forest.predict_proba(self._features(record))
        weights = np.zeros((len(of_class), len(self._faults)))
        weights[:, self._forest.classes_[1:] - 1] = of_class[:, 1:]
        smooth = np.vstack([np.zeros(weights.shape[1]), weights.cumsum(0)])
        weights[WINDOW:] = (smooth[WINDOW + 1 :] - smooth[1:-WINDOW]) / WINDOW
        return 1.0 - of_class[:, 0] + 1e-3, weights
