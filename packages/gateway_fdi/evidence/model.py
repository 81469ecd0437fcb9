"""A plant as the evidence takes it: slow errors, faults, noise; and the records that are made of it."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from gateway_fdi.jit import Record, f8s, i8, i8s, means

#: Each size is a mixture of this number of Gaussians, of which each is FINER times as narrow as the one before: faults
#: far below their range are as likely as those that fill it.
SCALES, FINER = 3, 3.0
#: Lengths of the records; a plant's own classes say others. "room": a fault's gains + 1.
LENGTHS = {"residuals": 1, "slow": 1, "gains": 1, "columns": 2, "faults": 1, "edges": 2, "room": 2}


class Const(Record, lengths=LENGTHS):
    """Constants. A fault has a gain for each residual that it moves; columns are slow errors, then gains."""

    residuals: i8 = means("number of residuals")
    slow: i8 = means("number of slow errors")
    faults: i8 = means("number of faults")
    samples: i8 = means("samples of a block")
    weight: Annotated[f8s, "residuals", "residuals"] = means("inverse of the noise's long-run covariance per sample")
    jitter: Annotated[f8s, "slow"] = means("1 / variance of its jitter from block to block")
    first: Annotated[i8s, "edges"] = means("first gain of each fault, and behind the last one their number")
    row: Annotated[i8s, "gains"] = means("residual of each gain")
    scale: Annotated[f8s, "faults", SCALES] = means("standard deviations of a size beforehand")
    error: Annotated[f8s, "faults"] = means("standard deviation of a gain, a share of it")


class State(Record, lengths=LENGTHS):
    """State."""

    a: Annotated[f8s, "columns", "columns"] = means("A of the block at hand")
    b: Annotated[f8s, "columns"] = means("b of the block at hand")
    taken: i8 = means("samples of the block at hand")
    rows: Annotated[f8s, "residuals", "residuals"] = means("scratch: weight of the residuals that are there")
    weighted: Annotated[f8s, "columns", "residuals"] = means("scratch: columns by weight")
    left: Annotated[f8s, "residuals"] = means("scratch: residuals by weight")
    work_a: Annotated[f8s, "columns", "columns"] = means("scratch")
    work_b: Annotated[f8s, "columns"] = means("scratch")
    one_a: Annotated[f8s, "room", "room"] = means("scratch")
    one_b: Annotated[f8s, "room"] = means("scratch")
    likelihood: Annotated[f8s, "faults"] = means("log likelihood ratio of a fault, sizes integrated out")
    found: Annotated[f8s, "faults"] = means("size of the fault")


@dataclass(frozen=True)
class Fault:
    """A fault.

    Attributes:
        name: of it.
        residuals: that it moves, by their numbers.
        size: largest standard deviation of its size beforehand; see :data:`SCALES`.
        error: standard deviation of each of its gains, a share of the gain.
    """

    name: str
    residuals: tuple[int, ...]
    size: float
    error: float = 0.3


@dataclass(frozen=True)
class Model:
    """A plant.

    Attributes:
        slow: standard deviation of each slow error (a parameter, a sensor's gain or bias) beforehand, in the order of
            the columns of H; of an error within +- b it is b / sqrt(3).
        faults: its faults.
        noise: long-run covariance of the residuals' noise per sample, shape (m, m).
        samples: of a block: at least ten times the correlation time of the noise.
        jitter: standard deviation of each slow error from block to block, a share of that.
    """

    slow: tuple[float, ...]
    faults: tuple[Fault, ...]
    noise: NDArray[np.float64]
    samples: int
    jitter: float = 0.0

    @property
    def gains(self) -> tuple[tuple[int, int], ...]:
        """Fault and residual of each gain, in the order of the columns of G."""
        return tuple((f, row) for f, fault in enumerate(self.faults) for row in fault.residuals)

    @property
    def lengths(self) -> dict[str, int]:
        """Lengths of the arrays of its records, by the names of :data:`LENGTHS`."""
        gains = len(self.gains)
        return {
            "residuals": len(self.noise), "slow": max(len(self.slow), 1), "gains": max(gains, 1),
            "columns": max(len(self.slow) + gains, 1), "faults": max(len(self.faults), 1),
            "edges": len(self.faults) + 1,
            "room": 2 * max((len(fault.residuals) for fault in self.faults), default=1) + 1,
        }  # fmt: skip

    def fill(self, c: Any) -> None:
        """Fill a record of Const, or of a class derived from it, that has room for it."""
        m = len(self.noise)
        c.residuals, c.slow, c.faults, c.samples = m, len(self.slow), len(self.faults), self.samples
        c.weight[:m, :m] = np.linalg.inv(self.noise)
        for k, prior in enumerate(self.slow):
            c.jitter[k] = (self.jitter * prior) ** -2 if self.jitter else inf
        c.row[: len(self.gains)] = [row for _, row in self.gains]
        for k, fault in enumerate(self.faults):
            c.first[k + 1] = c.first[k] + len(fault.residuals)
            c.error[k] = fault.error
            c.scale[k] = [fault.size / FINER**n for n in range(SCALES)]
