"""Verdicts of the journal as events: nothing is known of what was seen at them."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from gateway.engine.events import NO_BUS, QUALIFIED_FAILED, Event
from gateway.faults.catalogue import FaultDefinition
from gateway.faults.failures import Observed
from gateway.faults.journal_file import LastVerdict
from gateway.monitors.contract import EVIDENCE, FAILED, PASSED


class Recovered(NamedTuple):
    """Verdicts that were told and not written: ids of the faults whose verdicts are known again, and how many are lost.

    One is lost if its fault is not known any more, or if there is no room for its entry any more.
    """

    faults: tuple[str, ...] = ()
    lost: int = 0


def event_of(verdict: LastVerdict) -> Event:
    """Return the event that a verdict was; its values, and its fault's place, are not known."""
    result = FAILED if verdict.kind == QUALIFIED_FAILED else PASSED
    nothing = np.full(EVIDENCE, np.nan)
    return Event(verdict.t_ns, -1, verdict.kind, result, verdict.fdc, NO_BUS, math.nan, math.nan, nothing)


def unseen(definition: FaultDefinition) -> Observed:
    """Return what is seen of a fault whose moment is gone: its signals, without values."""
    return Observed(dict.fromkeys(definition.freeze_frame, math.nan))
