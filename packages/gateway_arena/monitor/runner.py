"""A fitted method that takes samples one by one, as the engine has them.

A sample with a value that is no number is a missing one. Up to ``missing`` in a row the values before them stand for
them, because a method knows no gaps; after more it begins again, and settles.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, Protocol

import numpy as np

from gateway_arena.contract import Array
from gateway_arena.monitor.params import Params
from gateway_arena.score import NAMED


class Stepper(Protocol):
    """Python behind a monitor: the method, or who keeps its samples."""

    def step(self, s: Any) -> None:
        """Take the sample of the monitor's state, and leave there what is said of it."""


class Runner:
    """Steps a method.

    Args:
        p: parameters.
        method: fitted; it has ``reset`` and ``feed``.
        low: values below are taken as this one, shape (inputs,).
        high: values above likewise.
    """

    def __init__(self, p: Params, method: Any, low: Array, high: Array) -> None:
        self._p, self._method, self._low, self._high = p, method, low, high
        self._last: Array | None = None
        self._away = self._done = 0

    def step(self, s: Any) -> None:
        """Take a sample."""
        s.judged, s.score = 0, np.nan
        value = np.array(s.value[: len(self._p.inputs)])
        most = self._p.missing + 1
        self._away += int(min(max(s.gap - 1.0, 0.0), most)) if np.isfinite(s.gap) else most
        if not np.isfinite(value).all():
            self._away += 1
            s.left_out += 1
            return
        value = np.clip(value, self._low, self._high)
        if self._last is None or self._away > self._p.missing:
            s.begun += self._last is not None
            self._method.reset()
            self._done = self._away = 0
        rows = np.array([*[self._last] * self._away, value])
        self._last, self._away = value, 0
        found = self._method.feed(rows)
        self._done += len(rows)
        s.samples += 1
        if self._done <= self._p.settle:
            return
        s.score, s.which, s.judged = float(found.score[-1]), -1, 1
        s.weight[:] = 0.0
        if found.weights is not None and len(self._p.faults):
            weights = found.weights[-1]
            s.weight[: len(weights)] = weights
            s.which = int(np.argmax(weights)) if weights.max() > NAMED else -1


class Collector:
    """Keeps samples instead, to be fitted on."""

    def __init__(self, p: Params) -> None:
        self._count = len(p.inputs)
        self.t_ns: list[int] = []
        self.values: list[Array] = []

    def step(self, s: Any) -> None:
        """Keep a sample, if all of it is there."""
        value = np.array(s.value[: self._count])
        s.judged = 0
        if np.isfinite(value).all():
            self.t_ns.append(int(s.at_ns))
            self.values.append(value)


_collecting: ContextVar[dict[str, list[Collector]] | None] = ContextVar("collecting", default=None)


@contextmanager
def collecting() -> Iterator[dict[str, list[Collector]]]:
    """Have monitors that are made within keep their samples; yields them by their ``fitted``."""
    found: dict[str, list[Collector]] = {}
    token = _collecting.set(found)
    try:
        yield found
    finally:
        _collecting.reset(token)


def collector(p: Params) -> Collector | None:
    """Return a collector for a monitor, if samples are collected."""
    found = _collecting.get()
    if found is None:
        return None
    made = Collector(p)
    found.setdefault(p.fitted, []).append(made)
    return made


def is_collecting() -> bool:
    """Return whether samples are collected."""
    return _collecting.get() is not None
