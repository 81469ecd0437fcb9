"""Plants and methods, as the arena takes them.

A method is a class without arguments for ``__init__``, with ``fit``, and ``step`` or ``run``::

    class Mine:
        def fit(self, plant, healthy, faulty): ...
        def reset(self): ...                  # a record begins
        def step(self, sample): ...           # shape (knowns,); returns the score, or the score and a weight per fault

``faulty`` is empty unless the class says ``supervised = True``.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from gateway_fdi.errors import GatewayError
from gateway_fdi.structure.model import Model

Array = NDArray[np.float64]

#: Samples of a record, and at its beginning those in which methods settle: they are not judged, nor learned from.
SAMPLES, SETTLE = 1200, 240


class NotForThisPlantError(GatewayError):
    """A method cannot be used on a plant; its text says why."""


@dataclass(frozen=True)
class Record:
    """Samples of a run.

    Attributes:
        t_s: times, shape (n,) [s].
        values: of the known variables, shape (n, knowns), in the model's units.
        fault: that it has, "": none.
        onset: its first sample with the fault; n without one.
    """

    t_s: Array
    values: Array
    fault: str
    onset: int


def cut(values: Array, length: int = SAMPLES) -> list[Array]:
    """Return the parts of this length, one after the other."""
    return [values[k : k + length] for k in range(0, len(values) - length + 1, length)]


@dataclass(frozen=True)
class Dynamics:
    """The plant's states around a commanded value: x(k+1) = phi x(k) + g, y = c x + d.

    Attributes:
        phi: shape (states, states).
        g: shape (states,).
        c: shape (outputs, states).
        d: shape (outputs,).
    """

    phi: Array
    g: Array
    c: Array
    d: Array


class WithoutSlopes:
    """A plant whose equations are not given as slopes of states."""

    def dynamics(self, command: Array) -> Dynamics:
        """Refuse (:class:`Plant`)."""
        raise NotForThisPlantError("its equations are not given as slopes of states")


class Plant(Protocol):
    """A plant of the arena.

    Attributes:
        name: of the plant.
        source: where its equations come from.
        model: its structural model; units, parameters and faults' texts are there.
        period_s: between two samples [s].
        commands: known variables that are commanded; they come first in ``knowns``.
        knowns: known variables, in the order of a record's columns.
        noise: standard deviation of each known variable.
        sizes: fault -> what it does, for people.
    """

    name: str
    source: str
    model: Model
    period_s: float
    commands: tuple[str, ...]
    knowns: tuple[str, ...]
    noise: tuple[float, ...]
    sizes: Mapping[str, str]

    def record(self, seed: int, fault: str = "", off: float = 0.0, size: float = 1.0) -> Record:
        """Return a run.

        Args:
            seed: of commands, noise, and the fault's onset.
            fault: of :attr:`sizes`; "": none.
            off: share by which parameters differ from the model's.
            size: of the fault, in those of :attr:`sizes`.

        Raises:
            InputError: this plant cannot be off, or has faults of one size only.
        """

    def dynamics(self, command: Array) -> Dynamics:
        """Return its states' dynamics while the commands have these values, shape (commands,).

        Raises:
            NotForThisPlantError: its equations are not given as slopes of states.
        """


@dataclass(frozen=True)
class Found:
    """A method's words on a record.

    Attributes:
        score: the larger, the more a fault is likely, shape (n,).
        weights: of each fault, in the order of the plant's ``sizes``, shape (n, faults); all 0: it names none.
            None: the method names no faults.
    """

    score: Array
    weights: Array | None = None


class Method(Protocol):
    """A method that judges whole records; its values at a sample depend on none after it (the arena looks)."""

    def fit(self, plant: Plant, healthy: Sequence[Record], faulty: Sequence[Record]) -> None:
        """Learn what is needed.

        Raises:
            NotForThisPlantError: it cannot be used there.
        """

    def run(self, record: Record) -> Found:
        """Return what is said of a record."""


class Fed(ABC):
    """A method that takes samples as they come, so that it can be a monitor, too."""

    @abstractmethod
    def reset(self) -> None:
        """Begin a record."""

    @abstractmethod
    def feed(self, values: Array) -> Found:
        """Go on with samples, shape (n, knowns), a period apart; returns what is said of them."""

    def run(self, record: Record) -> Found:
        """Return what is said of a record."""
        self.reset()
        return self.feed(record.values)


class Stepped(Fed):
    """A method with ``step`` as one with ``feed``."""

    def __init__(self, method: Any) -> None:
        self._method = method
        self.supervised = bool(getattr(method, "supervised", False))

    def fit(self, plant: Plant, healthy: Sequence[Record], faulty: Sequence[Record]) -> None:
        """Have it fitted."""
        self._method.fit(plant, healthy, faulty)

    def reset(self) -> None:
        """Have it begin again, if it can."""
        if hasattr(self._method, "reset"):
            self._method.reset()

    def feed(self, values: Array) -> Found:
        """Step through samples."""
        said = [self._method.step(sample) for sample in values]
        if not isinstance(said[0], tuple):
            return Found(np.array(said, np.float64))
        return Found(np.array([s for s, _ in said], np.float64), np.array([w for _, w in said], np.float64))
