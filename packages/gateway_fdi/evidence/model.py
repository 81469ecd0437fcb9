"""A plant as the evidence takes it: slow errors, faults, noise; records and their lengths."""

from __future__ import annotations

from collections.abc import Sequence
from math import inf
from typing import Annotated, Any

from gateway_fdi.jit import Record, f8, f8s, i8, i8s, means

#: Lengths of the records; a plant's own classes say others. "room": the gains of two faults + 1.
LENGTHS = {"residuals": 1, "slow": 1, "gains": 1, "columns": 2, "faults": 1, "edges": 2, "room": 2}


class Const(Record, lengths=LENGTHS):
    """Constants. A fault has a gain for each residual that it moves; columns are slow errors, then gains."""

    residuals: i8 = means("number of residuals")
    slow: i8 = means("number of slow errors")
    faults: i8 = means("number of faults")
    samples: i8 = means("samples of a block")
    weight: Annotated[f8s, "residuals"] = means("1 / long-run variance of each residual's noise per sample")
    jitter: f8 = means("1 / variance of a slow error's jitter from block to block")
    first: Annotated[i8s, "edges"] = means("first gain of each fault, and behind the last one their number")
    row: Annotated[i8s, "gains"] = means("residual of each gain")
    error: f8 = means("standard deviation of a gain, a share of it")


class State(Record, lengths=LENGTHS):
    """State."""

    a: Annotated[f8s, "columns", "columns"] = means("A of the block at hand")
    b: Annotated[f8s, "columns"] = means("b of the block at hand")
    taken: i8 = means("samples of the block at hand")
    there: Annotated[f8s, "residuals"] = means("scratch: weight of the residuals that are there")
    weighted: Annotated[f8s, "columns", "residuals"] = means("scratch: columns by weight")
    left: Annotated[f8s, "residuals"] = means("scratch: residuals by weight")
    work_a: Annotated[f8s, "columns", "columns"] = means("scratch")
    work_b: Annotated[f8s, "columns"] = means("scratch")
    one_a: Annotated[f8s, "room", "room"] = means("scratch")
    one_b: Annotated[f8s, "room"] = means("scratch")
    likelihood: Annotated[f8s, "faults"] = means("log likelihood ratio of a fault, sizes integrated out")
    found: Annotated[f8s, "faults"] = means("size of the fault")


def lengths(residuals: int, slow: int, moved: Sequence[Sequence[int]]) -> dict[str, int]:
    """Return the lengths of the arrays of a plant's records, by the names of :data:`LENGTHS`.

    Args:
        residuals: how many.
        slow: number of slow errors.
        moved: of each fault the residuals that it moves, by their numbers.
    """
    gains = sum(map(len, moved))
    return {
        "residuals": residuals, "slow": max(slow, 1), "gains": max(gains, 1), "columns": max(slow + gains, 1),
        "faults": max(len(moved), 1), "edges": len(moved) + 1, "room": 2 * max(map(len, moved), default=1) + 1,
    }  # fmt: skip


def prepare(c: Any, slow: int, moved: Sequence[Sequence[int]], *, samples: int, jitter: float, error: float) -> None:
    """Fill a record of Const but for the weights of its residuals.

    Args:
        c: of :class:`Const`, or of a class derived from it, that has room for it.
        slow: number of slow errors.
        moved: as :func:`lengths` takes it.
        samples: of a block: at least ten times the correlation time of the noise.
        jitter: standard deviation of each slow error from block to block.
        error: standard deviation of each gain, a share of the gain.
    """
    c.residuals, c.slow, c.faults, c.samples = len(c.weight), slow, len(moved), samples
    c.jitter, c.error = jitter**-2 if jitter else inf, error
    rows = [row for residuals in moved for row in residuals]
    c.row[: len(rows)] = rows
    for k, residuals in enumerate(moved):
        c.first[k + 1] = c.first[k] + len(residuals)
