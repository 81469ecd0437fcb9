"""Rivals that learn from data, by scikit-learn: PCA, one-class SVM, random forest."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.stats import chi2

from gateway_arena.contract import Array, Fed, Found, Plant, Record
from gateway_arena.methods.cusum import Accumulated, settled, summed

#: Samples of a window; records at the end of the healthy ones that the CUSUM is learned from; seed of what is random.
WINDOW, KEPT, SEED = 20, 2, 1


class Classes:
    """A classifier of scikit-learn that has seen what is fine, and each fault.

    Args:
        classifier: not fitted.
        fine: rows without a fault, shape (n, columns).
        seen: fault -> rows with it, several times.
        faults: all of them.
    """

    def __init__(self, classifier: Any, fine: Array, seen: Sequence[tuple[str, Array]], faults: Sequence[str]) -> None:
        kinds = [np.zeros(len(fine), np.int64), *(np.full(len(rows), 1 + faults.index(f)) for f, rows in seen)]
        self._fitted = classifier.fit(np.concatenate([fine, *(rows for _, rows in seen)]), np.concatenate(kinds))
        self._count = len(faults)

    def judged(self, features: Array) -> tuple[Array, Array]:
        """Return the probability of any fault, shape (n,), a little more than 0, and of each, shape (n, faults)."""
        of_class = self._fitted.predict_proba(features)
        weights = np.zeros((len(of_class), self._count))
        weights[:, self._fitted.classes_[1:] - 1] = of_class[:, 1:]
        return 1.0 - of_class[:, 0] + 1e-3, weights


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
        mean = summed(padded, WINDOW)[WINDOW - 1 :] / WINDOW
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
        forest = RandomForestClassifier(
            60, max_depth=14, min_samples_leaf=3, class_weight="balanced", random_state=SEED
        )
        fine = features[rng.permutation(len(features))[:3000]]
        seen = [(record.fault, self._features(record)[record.onset + WINDOW :: 2]) for record in faulty]
        self._classes = Classes(forest, fine, seen, self._faults)

    def _judged(self, features: Array) -> tuple[Array, Array]:
        statistic, weights = self._classes.judged(features)
        before: Array = np.zeros((WINDOW, weights.shape[1])) if self._begun else self._kept
        rows = np.vstack([before, weights])
        self._kept: Array = rows[len(rows) - WINDOW :]
        return statistic, summed(rows, WINDOW)[WINDOW:] / WINDOW
