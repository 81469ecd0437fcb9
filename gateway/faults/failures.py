"""A qualified failure, and what was seen at it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import NamedTuple

from gateway.engine.events import Event
from gateway.faults import freeze_frames
from gateway.faults.catalogue import FaultDefinition
from gateway.faults.records import Record


class Observed(NamedTuple):
    """Values seen at a failure: the signals of its freeze frame, the inputs of its monitor."""

    frame: Mapping[str, float] = {}
    inputs: Mapping[str, float] = {}


#: Takes a fault, returns what is seen of it now.
Snapshot = Callable[[FaultDefinition], Observed]


def finite(values: Mapping[str, float]) -> dict[str, float | None]:
    """Return values for the store, which has None for what is not a number."""
    return {name: value if math.isfinite(value) else None for name, value in values.items()}


class Failure(NamedTuple):
    """A qualified failure, and what was seen at it."""

    t_ns: int
    evidence: dict[str, float | None]
    observe: Callable[[], Observed]


def failure_of(definition: FaultDefinition, event: Event, snapshot: Snapshot) -> Failure:
    """Return what an event (a qualified failure) tells; ``snapshot`` is called when it is wanted."""
    names = ("value", "threshold", *definition.evidence)
    values = (event.value, event.threshold, *event.evidence.tolist())
    evidence = finite(dict(zip(names, values, strict=False)))
    return Failure(event.t_ns, evidence, lambda: snapshot(definition))


def known(values: Mapping[str, float | None]) -> dict[str, float]:
    """Return stored values as numbers, NaN for None."""
    return {name: math.nan if value is None else value for name, value in values.items()}


def latest_signals(record: Record) -> dict[str, float]:
    """Return the signals of a record's latest freeze frame."""
    frames = record.freeze_frames
    at = freeze_frames.LATEST_FAILURE if freeze_frames.LATEST_FAILURE in frames else 1
    return known(frames[at].content) if at in frames else {}
