"""What the voters are given: strokes, environments and faults (paper 002, section IV)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from gateway_bench.vecu.sensor_faults import at_rail, digitised, drift, impulses, offset, stuck
from gateway_plants.pedal.ecu import strokes

#: A run: samples of 1 ms, 0 to 5 V.
SAMPLES, SPAN = 1000, 5.0
STROKES: dict[str, Callable[..., strokes.Travel]] = {
    "exponential": strokes.exponential,
    "ramp": strokes.ramp,
    "cosine": strokes.cosine,
}
#: Channels given to every voter; those that take two see the first two.
CHANNELS = 3


@dataclass(frozen=True)
class Environment:
    """How readings are made: noise, standard deviation [V]; ADC bits (0: none); clipped to the span or not."""

    name: str
    noise: float = 0.0
    bits: int = 0
    clipped: bool = True

    @property
    def step(self) -> float:
        """Least difference of two readings [V]; 0: none."""
        return SPAN / (1 << self.bits) if self.bits else 0.0


IDEAL = Environment("ideal")
UNCLIPPED = Environment("ideal, unclipped", clipped=False)
TEN_BIT = Environment("10 bit", bits=10)
NOISY = Environment("2 mV + 12 bit", noise=0.002, bits=12)
ENVIRONMENTS = {e.name: e for e in (IDEAL, UNCLIPPED, TEN_BIT, NOISY)}

Kind = Literal[
    "none",
    "impulses",
    "clean + impulses",
    "dead",
    "stuck",
    "stuck on plateau",
    "stuck + impulses",
    "offset",
    "offset + impulses",
    "drift",
    "common mode",
    "both garbage",
    "both dead",
]


@dataclass(frozen=True)
class Case:
    """One kind of run.

    Attributes:
        kind: of the faults.
        rate: of impulses, per sample.
        value: of impulses, share of the span.
        onset: sample at which channel 1 dies; None: random.
    """

    kind: Kind
    rate: float = 0.15
    value: float = 0.10
    onset: int | None = None

    def __str__(self) -> str:
        if self.kind == "impulses":
            return f"{round(self.rate * 100)} %, value {round(self.value * 100)} %"
        if self.kind == "dead":
            return f"0 V from {self.onset} + impulses"
        return self.kind


@dataclass(frozen=True)
class Run:
    """One run.

    Attributes:
        truth: shape (n,), the pedal [V].
        readings: shape (n, 3) [V].
        faulty: shape (n, 3), whether the reading is off by a fault.
        bad: channel with a lasting fault, -1: none.
        onset: sample at which that begins.
    """

    truth: NDArray[np.float64]
    readings: NDArray[np.float64]
    faulty: NDArray[np.bool_]
    bad: int
    onset: int


def make(case: Case, environment: Environment, seed: int, stroke: str = "exponential") -> Run:
    """Return a run; the same arguments give the same one.

    Impulses of a lasting fault's case are on the other channels; a third channel is healthy but for impulses.
    """
    rng = np.random.default_rng(seed)
    n = SAMPLES
    truth = SPAN * STROKES[stroke](np.arange(n) * 1e-3)
    # All is drawn whether it is used or not, so that one seed means one run in every case.
    noise = rng.normal(0.0, 1.0, (n, CHANNELS)) * environment.noise
    hits = impulses((n, CHANNELS), case.rate, case.value * SPAN, rng)
    onset = int(rng.integers(50, 800))
    plateau = int(rng.integers(350, 550))
    size = float(rng.uniform(0.05, 0.5) * rng.choice((-1, 1)))
    slope = float(0.001 * rng.choice((-1, 1)))
    healthy = truth[:, None] + noise
    y = healthy.copy()
    bad = -1
    kind = case.kind
    if kind in ("impulses", "clean + impulses"):
        if kind == "clean + impulses":
            hits[:, 0] = 0.0
        y += hits
    elif kind == "common mode":
        y += impulses((n, 1), 0.02, case.value * SPAN, rng)
    elif kind == "both garbage":
        y[onset : onset + 30] = rng.uniform(0, SPAN, (30, CHANNELS))
    elif kind == "both dead":
        y[onset : onset + 30] = 0.0
    elif kind != "none":
        bad = 0
        if kind == "dead":
            onset = onset if case.onset is None else case.onset
            y[:, 0] = at_rail(y[:, 0], onset, n, 0.0)
        elif kind.startswith("stuck"):
            onset = plateau if kind == "stuck on plateau" else onset
            y[:, 0] = stuck(y[:, 0], onset, n)
        elif kind.startswith("offset"):
            y[:, 0] += offset(n, onset, n, size)
        elif kind == "drift":
            onset = onset % 500 + 50
            y[:, 0] += drift(n, onset, n, slope)
        if kind == "dead" or kind.endswith("impulses"):
            y[:, 1:] += hits[:, 1:]
    faulty = y != healthy
    if environment.clipped:
        y = digitised(y, SPAN, environment.bits)
    return Run(truth, y, faulty, bad, onset if bad >= 0 else n)


def oracle(run: Run) -> NDArray[np.float64]:
    """Return the mean of the first two channels' healthy readings; where there is none, on along a line."""
    good = ~run.faulty[:, :2]
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.where(good, run.readings[:, :2], 0).sum(1) / good.sum(1)
    r: NDArray[np.float64] = mean.copy()
    for k in np.flatnonzero(np.isnan(mean)):
        r[k] = 2 * r[k - 1] - r[k - 2] if k > 1 else (r[k - 1] if k else 0.0)
    return r
