"""A plant as the evidence takes it: slow errors, faults, noise; and the records that are made of it."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, isfinite, log
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from gateway_fdi.errors import Gathered, InputError
from gateway_fdi.jit import Record, f8, f8s, i8, i8s, means, zeros

#: Each size is a mixture of this number of Gaussians, of which each is FINER times as narrow as the one before: faults
#: far below their range are as likely as those that fill it.
SCALES, FINER = 3, 3.0
#: Faults that are told as "one of" at most.
MOST = 3
#: Onsets that are kept.
ONSETS = 24
#: Lengths of the records; a plant's own classes, or :meth:`Model.records`, say others. "room": a fault's gains + 1.
LENGTHS = {"residuals": 1, "slow": 1, "gains": 1, "columns": 2, "faults": 1, "edges": 2, "onsets": ONSETS, "room": 2}


class Const(Record, lengths=LENGTHS):
    """Constants. A fault has a gain for each residual that it moves; columns are slow errors, then gains."""

    residuals: i8 = means("number of residuals")
    slow: i8 = means("number of slow errors")
    faults: i8 = means("number of faults")
    samples: i8 = means("samples of a block")
    block_s: f8 = means("length of a block", "s")
    weight: Annotated[f8s, "residuals", "residuals"] = means("inverse of the noise's long-run covariance per sample")
    prior: Annotated[f8s, "slow"] = means("1 / variance of each slow error beforehand")
    walk: Annotated[f8s, "slow"] = means("1 / variance of its walk in a block")
    jitter: Annotated[f8s, "slow"] = means("1 / variance of its jitter from block to block")
    first: Annotated[i8s, "edges"] = means("first gain of each fault, and behind the last one their number")
    row: Annotated[i8s, "gains"] = means("residual of each gain")
    common: Annotated[i8s, "faults"] = means("1: one size for all residuals of a fault; 0: each has its own")
    scale: Annotated[f8s, "faults", SCALES] = means("standard deviations of a size beforehand")
    error: Annotated[f8s, "faults"] = means("standard deviation of a gain, a share of it")
    sign: Annotated[f8s, "faults"] = means("of the size; 0: either")
    rate: Annotated[f8s, "faults"] = means("logarithm of how likely a fault begins in a block")
    present: Annotated[f8s, "faults"] = means("logarithm of how likely it is there before the start")
    transient: i8 = means("fault that stands for the block in which any fault begins; -1: none does")
    threshold: f8 = means("ratio from which on something is told")
    confirm: i8 = means("blocks for which a statement stands before it is told")


class State(Record, lengths=LENGTHS):
    """State."""

    a: Annotated[f8s, "columns", "columns"] = means("A of the block at hand")
    b: Annotated[f8s, "columns"] = means("b of the block at hand")
    taken: i8 = means("samples of the block at hand")
    rows: Annotated[f8s, "residuals", "residuals"] = means("scratch: weight of the residuals that are there")
    weighted: Annotated[f8s, "columns", "residuals"] = means("scratch: columns by weight")
    left: Annotated[f8s, "residuals"] = means("scratch: residuals by weight")
    blocks: i8 = means("blocks so far")
    onsets: i8 = means("onsets that are kept")
    onset: Annotated[i8s, "onsets"] = means("first block of each; the first one of all is before the start")
    entry: Annotated[f8s, "onsets"] = means("log likelihood ratio of the block in which a fault begins")
    since_a: Annotated[f8s, "onsets", "columns", "columns"] = means("A since each onset")
    since_b: Annotated[f8s, "onsets", "columns"] = means("b since each onset")
    born_a: Annotated[f8s, "onsets", "slow", "slow"] = means("A of the slow errors before each onset")
    born_b: Annotated[f8s, "onsets", "slow"] = means("b of the slow errors before each onset")
    window_a: Annotated[f8s, "columns", "columns"] = means("A of the window in which a fault may have gone")
    window_b: Annotated[f8s, "columns"] = means("b of that window")
    watched: i8 = means("blocks of it and 1; 0: there is none")
    evidence: f8 = means("logarithm of the likelihood without a fault, of what is integrated out so far")
    work_a: Annotated[f8s, "columns", "columns"] = means("scratch")
    work_b: Annotated[f8s, "columns"] = means("scratch")
    one_a: Annotated[f8s, "room", "room"] = means("scratch")
    one_b: Annotated[f8s, "room"] = means("scratch")
    likelihood: Annotated[f8s, "onsets", "faults"] = means("log likelihood ratio of a fault, sizes integrated out")
    ratio: Annotated[f8s, "onsets", "faults"] = means("2 log of the largest likelihood ratio, gains taken for exact")
    found: Annotated[f8s, "onsets", "faults"] = means("size of the fault")
    spread: Annotated[f8s, "onsets", "faults"] = means("its standard deviation")
    probability: Annotated[f8s, "edges"] = means("of each fault; the last: there is none")
    chosen: Annotated[i8s, "faults"] = means("onset of each fault that is likeliest, its place")
    listed: Annotated[i8s, MOST] = means("faults of a statement that may be told, likeliest first; -1: no more")
    new: Annotated[i8s, MOST] = means("scratch: those of this block")
    found_kind: i8 = means("kind of it")
    stood: i8 = means("blocks for which it has been the same")
    kind: i8 = means("statement that is told")
    named: Annotated[i8s, MOST] = means("faults of it, likeliest first; -1: no more")
    sure: f8 = means("probability of it")
    since: i8 = means("block in which the likeliest one began; 0: before the start")


@dataclass(frozen=True)
class Slow:
    """A slow error.

    Attributes:
        name: of a parameter, or of a sensor's gain or bias.
        prior: standard deviation beforehand; of an error within +- b it is b / sqrt(3).
        walk: standard deviation of what it changes by in a second.
    """

    name: str
    prior: float
    walk: float = 0.0


@dataclass(frozen=True)
class Fault:
    """A fault.

    Attributes:
        name: of it.
        residuals: that it moves, by their numbers.
        size: largest standard deviation of its size beforehand; see :data:`SCALES`.
        error: standard deviation of each of its gains, a share of the gain.
        sign: 1 or -1: its size has that sign; 0: either.
        per_h: how many of it begin in an hour.
        present: probability that it is there before the start.
        common: one size explains all residuals; without, each moves by a size of its own (a model that is wrong).
    """

    name: str
    residuals: tuple[int, ...]
    size: float
    error: float = 0.3
    sign: int = 0
    per_h: float = 1e-4
    present: float = 1e-3
    common: bool = True


@dataclass(frozen=True)
class Model:
    """A plant.

    Attributes:
        slow: its slow errors, in the order of the columns of H.
        faults: its faults.
        noise: long-run covariance of the residuals' noise per sample, shape (m, m).
        period_s: time between two samples [s].
        samples: of a block: at least ten times the correlation time of the noise.
        jitter: standard deviation of each slow error from block to block, a share of its prior's.
        threshold: ratio from which on something is told (:mod:`gateway_fdi.evidence.alarm`).
        confirm: blocks for which the same is found before it is told: a fault begins within a block, and generators
            show it as their gains say only when they have settled.
        onsets: that are kept.
    """

    slow: tuple[Slow, ...]
    faults: tuple[Fault, ...]
    noise: NDArray[np.float64]
    period_s: float
    samples: int
    jitter: float = 0.0
    threshold: float = inf
    confirm: int = 3
    onsets: int = ONSETS

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
            "edges": len(self.faults) + 1, "onsets": self.onsets,
            "room": max((len(fault.residuals) for fault in self.faults), default=1) + 1,
        }  # fmt: skip

    def _check(self) -> None:
        m = len(self.noise)
        wrong = Gathered()
        with wrong:
            if (
                self.noise.shape != (m, m)
                or not np.isfinite(self.noise).all()
                or np.linalg.eigvalsh(self.noise)[0] <= 0
            ):
                raise InputError("a covariance, shape (m, m), positive definite", key="noise")
        for one in self.slow:
            with wrong:
                if not (isfinite(one.prior) and one.prior > 0.0 and isfinite(one.walk) and one.walk >= 0.0):
                    raise InputError("a prior above 0, and a walk of at least 0", key="slow", value=one.name)
        for fault in self.faults:
            with wrong:
                if not fault.residuals or not set(fault.residuals) <= set(range(m)):
                    raise InputError(
                        f"it moves residuals of 0 to {m - 1}, one at least", key="faults", value=fault.name
                    )
                if not (isfinite(fault.size) and fault.size > 0.0 and isfinite(fault.error) and fault.error >= 0.0):
                    raise InputError("a size above 0, and an error of at least 0", key="faults", value=fault.name)
                if not 0.0 < fault.per_h < inf or not 0.0 < fault.present < 1.0:
                    raise InputError("a rate above 0, and a probability", key="faults", value=fault.name)
        for key, least in (("samples", 1), ("confirm", 1), ("onsets", 3)):
            with wrong:
                if getattr(self, key) < least:
                    raise InputError(f"at least {least}", key=key, value=str(getattr(self, key)))
        for key in ("period_s", "jitter"):
            with wrong:
                value = getattr(self, key)
                if not isfinite(value) or value < 0.0 or (key == "period_s" and value == 0.0):
                    raise InputError("a number above 0 (jitter: or 0)", key=key, value=f"{value:g}")
        wrong.check()

    def records(self) -> tuple[Any, Any]:
        """Return records of State and Const, before the first block.

        Raises:
            InputError, InputErrors: something of it is no model.
        """
        self._check()
        lengths = self.lengths

        class OwnState(State, lengths=lengths):
            pass

        class OwnConst(Const, lengths=lengths):
            pass

        s, c = zeros(1, OwnState)[0], zeros(1, OwnConst)[0]
        self.fill(s, c)
        return s, c

    def fill(self, s: Any, c: Any) -> None:
        """Fill records of State and Const, or of classes derived from them, that have room for it."""
        m, p = len(self.noise), len(self.slow)
        c.residuals, c.slow, c.faults, c.samples = m, p, len(self.faults), self.samples
        c.block_s = block_s = self.samples * self.period_s
        c.weight[:m, :m] = np.linalg.inv(self.noise)
        for k, one in enumerate(self.slow):
            c.prior[k] = one.prior**-2
            c.walk[k] = 1.0 / (one.walk**2 * block_s) if one.walk else inf
            c.jitter[k] = (self.jitter * one.prior) ** -2 if self.jitter else inf
        c.row[: len(self.gains)] = [row for _, row in self.gains]
        c.first[0] = 0
        for k, fault in enumerate(self.faults):
            c.first[k + 1] = c.first[k] + len(fault.residuals)
            c.common[k], c.error[k], c.sign[k] = fault.common, fault.error, fault.sign
            c.scale[k] = [fault.size / FINER**n for n in range(SCALES)]
            c.rate[k], c.present[k] = log(fault.per_h * block_s / 3600.0), log(fault.present)
        own = [k for k, fault in enumerate(self.faults) if not fault.common]
        c.transient = own[0] if own else -1
        c.threshold, c.confirm = self.threshold, self.confirm
        s.onsets, s.onset[0] = 1, 0
        s.listed[:] = s.named[:] = -1
        s.since_a[0, range(p), range(p)] = s.born_a[0, range(p), range(p)] = c.prior[:p]
