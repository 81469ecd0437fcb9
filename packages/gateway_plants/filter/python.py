"""A filter that is not linear, stepped in Python, as its author would."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from gateway_plants.filter.kernel import MOST
from gateway_plants.filter.params import Params


@dataclass(frozen=True)
class Made:
    """A filter that has been checked.

    Attributes:
        make: makes another one.
        kind: class of filterpy's that it is of.
        filter: it.
        options: arguments of an ExtendedKalmanFilter's update.
        states: of it.
        matrices: of one that is compiled: F, B, Q, H, R, x, P, for one period; {}: it is stepped in Python.
        modes: of an IMMEstimator.
    """

    make: Callable[[], Any]
    kind: str
    filter: Any
    options: Mapping[str, Callable[..., Any]]
    states: int
    matrices: Mapping[str, Any] = field(default_factory=dict)
    modes: int = 0


def pair(made: Any) -> tuple[Any, Mapping[str, Any]]:
    """Return the filter and its options of what make() returned."""
    if isinstance(made, tuple) and len(made) == 2 and isinstance(made[1], Mapping):
        return made[0], made[1]
    return made, {}


class Stepper:
    """Steps a filter of filterpy's.

    Args:
        p: parameters.
        made: the filter; another one is made at each beginning.
    """

    def __init__(self, p: Params, made: Made) -> None:
        self._p, self._made = p, made
        self.begin()

    def begin(self) -> None:
        """Begin again, with a new filter."""
        self.filter, self._options = pair(self._made.make())

    def take(self, z: Any, u: Any, lost: int) -> Any:
        """Take a sample; returns what was to be expected of its measurements.

        Args:
            z: measurements, shape (m,); NaN: missing. One that lacks any is predicted only.
            u: inputs, shape (r,).
            lost: samples that are lost before it.
        """
        kf = self.filter
        for _ in range(lost + 1):
            self._predict(u)
        if not np.isfinite(z).all():
            return z
        flat = self._made.kind == "UnscentedKalmanFilter" or self.shown.x.ndim == 1
        kf.update(z if flat else z.reshape(-1, 1), **self._options)
        return z - np.ravel(self.shown.y)

    def _predict(self, u: Any) -> None:
        if not u.size:
            self.filter.predict()
        elif self._made.kind == "UnscentedKalmanFilter":
            self.filter.predict(u=u)
        else:
            self.filter.predict(u if self.shown.x.ndim == 1 else u.reshape(-1, 1))

    @property
    def shown(self) -> Any:
        """The filter whose innovation is shown: an IMMEstimator's likeliest."""
        kf = self.filter
        return kf.filters[int(np.argmax(kf.mu))] if self._made.modes else kf

    def on(self, s: Any) -> Callable[[], None]:
        """Return what steps it with a monitor's state."""
        m, r, n = len(self._p.z), len(self._p.u), min(self._made.states, MOST)
        z_of, u_of, x_of, mode = s.z[:m], s.u[:r], s.x[:n], s.mode[: self._made.modes]
        y_of, variance = s.y[:m], s.variance[:m]

        def step() -> None:
            if s.anew:
                self.begin()
            z = z_of.copy()
            self.take(z, u_of.copy(), int(s.lost))
            kf = self.shown
            x_of[:] = np.ravel(self.filter.x)[:n]
            if self._made.modes:
                mode[:] = self.filter.mu
            if np.isfinite(z).all():
                y = np.ravel(kf.y)
                y_of[:], variance[:], s.seen, s.nis = y, kf.S.diagonal(), m, float(y @ kf.SI @ y)
            else:
                y_of[:], s.seen, s.nis = np.nan, 0, np.nan

        return step
