"""The state of a gateway as the pump of the live loop must know it, each time before it feeds the engine."""

from __future__ import annotations

from dataclasses import dataclass

from gateway.bus.id_filter import NOTHING, IdFilter
from gateway.common.times import NEVER

#: As ``foretells``: who sends the DTC frames of verdicts: Python; the pump, at once; the journal, when it has them.
NOBODY, AT_ONCE, JOURNAL = range(3)
#: As ``before_ns``: no frame is fed but by :meth:`gateway.runtime.app.Gateway.feed`.
EVERYTHING = -(1 << 63)


@dataclass(frozen=True)
class FastPathConditions:
    """A gateway, as a pump sees it. Times are of the engine [ns].

    Attributes:
        before_ns: frames from this time on are to come by :meth:`gateway.runtime.app.Gateway.feed`.
        due_ns: when a server, or a recording, is due, by the engine's time.
        prompt_ns: when a server is due, by the bus's own time.
        heard: frames that are to come by :meth:`gateway.runtime.app.Gateway.feed`.
        may_send: whether what monitors send goes to the bus.
        foretells: NOBODY, AT_ONCE or JOURNAL.
        idle: whether nothing but frames and time is waited for.
    """

    before_ns: int = EVERYTHING
    due_ns: int = NEVER
    prompt_ns: int = NEVER
    heard: IdFilter = NOTHING
    may_send: bool = False
    foretells: int = NOBODY
    idle: bool = True
