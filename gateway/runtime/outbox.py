"""Outputs of a gateway, in the one order that holds: committed first, told after, sent last.

A change of a DTC takes four steps, and no step is done before the one above it:

1. It is *noted*, when the fault memory of this process has it, with the event that will tell it.
2. It is *committed*: :mod:`gateway.runtime.persistence` has it written, and says how much may be told.
3. It is *told*: its event goes to the listeners, with ``stored``. This is false where the file cannot be written.
4. It is *sent*: the servers make frames of it (the DTC frame, DM1).

So a DTC that the next start does not find is never told, unless it is told as not stored. Where the configuration wants
all told first, steps 3 and 4 come before 2, with ``stored`` false, and an event tells when it is stored. The journal
(:mod:`gateway.faults.journal`) sends the DTC frame of a verdict before 1: the next start finds it there.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

from gateway.bus.frames import Frames
from gateway.engine.core import Engine, Sink
from gateway.faults.entries import DtcChange
from gateway.faults.memory import FaultMemory
from gateway.faults.resilient_store import ResilientStore
from gateway.runtime.contract import DETAIL, HERE, reported_to_fleet
from gateway.runtime.persistence import NOTHING, Noted, Persistence

#: Takes one event of the JSON contract.
Listener = Callable[[dict[str, Any]], None]


class Outbox:
    """Keeps what is to be told until it is stored, then tells and sends it.

    Args:
        memory: the fault memory.
        store: its file.
        engine: debounces the gateway's own faults.
        own: each reports faults of the gateway itself that are to be in the next commit.
        send: makes frames of changes that were told, at a time of the engine.
        first: whether changes are told and sent before they are stored.

    Attributes:
        upkeep: writes the fault memory.
        first: whether changes are told and sent before they are stored.
    """

    def __init__(
        self,
        memory: FaultMemory,
        store: ResilientStore,
        engine: Engine,
        own: Sequence[Callable[[Sink], None]],
        send: Callable[[Sequence[DtcChange], int], list[Frames]],
        *,
        first: bool = False,
    ) -> None:
        self._own, self._send, self.first, self._engine = own, send, first, engine
        self._fleet = memory.fleet
        self._ahead = NOTHING  # of what is noted, the first ones, that have been told before they are stored
        self._listeners: list[Listener] = []
        self._changes: list[DtcChange] = []  # not told yet, nor are these events
        self._untold: list[dict[str, Any]] = []
        self._early: list[Frames] = []  # to be sent before anything else
        self.upkeep = Persistence(memory, store, engine, self.report)

    def succeed(self, old: Outbox) -> None:
        """Go on where that of an earlier configuration stops: events that wait there are told here."""
        self.upkeep.succeed(old.upkeep)
        self._listeners = old._listeners
        self._changes, self._untold, self._ahead = old._changes, old._untold, old._ahead

    def listen(self, listener: Listener) -> None:
        """Add a listener; it is called with each event of the JSON contract, in order."""
        self._listeners.append(listener)

    @property
    def empty(self) -> bool:
        """Whether nothing is noted, and nothing is to be sent."""
        return not (self._changes or self._untold or self._early)

    @property
    def noted(self) -> Sequence[DtcChange]:
        """Changes that wait to be told."""
        return self._changes

    @property
    def is_heard(self) -> bool:
        """Whether there is anybody who listens."""
        return bool(self._listeners)

    def note(self, *events: dict[str, Any]) -> None:
        """Keep events to be told in their order, when all that happened before them is stored."""
        self._untold += events
        self._post(*events)

    def _post(self, *events: dict[str, Any]) -> None:
        """Have events wait for the fleet: they are written with what they tell."""
        if self._fleet.offered:
            for event in events:
                if (how := reported_to_fleet(event)) != HERE:
                    self._fleet.post(event, detail=how == DETAIL)

    def note_changes(self, changes: Iterable[DtcChange]) -> None:
        """Keep changes to be sent when they are stored; their events are noted by :meth:`note`."""
        self._changes += changes

    def report(self, event: dict[str, Any]) -> None:
        """Tell an event at once, for which nothing has to be stored."""
        self._post(event)
        self._hand(event)

    def _hand(self, event: dict[str, Any]) -> None:
        for listener in self._listeners:
            listener(event)

    def release(self, now: int, sink: Sink, *, asked: bool = False, final: bool = False) -> list[Frames]:
        """Commit what was noted, if it is time, tell it, and return the frames that send it (see :meth:`settle`)."""
        return self._send(self.settle(now, sink, asked=asked, final=final), now)

    def release_early(self, now: int, sink: Sink) -> None:
        """Commit and tell all that was noted; its frames are sent before any others (:meth:`take_early`)."""
        self._early += self.release(now, sink, final=True)

    def take_early(self) -> list[Frames]:
        """Return the frames that go before any others, once."""
        early, self._early = self._early, []
        return early

    def settle(self, now: int, sink: Sink, *, asked: bool = False, final: bool = False) -> list[DtcChange]:
        """Commit what was noted, if it is time, and tell it; returns the changes to send.

        Errors of the memory itself are told before the changes it could not store.

        Args:
            now: of the engine's clock.
            sink: takes the events of the gateway's own faults.
            asked: whether a tester asks for what there is now.
            final: whether all is committed in any case.
        """
        if not (final or self._changes or self._untold) and self.upkeep.idle:
            return []  # as for nearly every batch
        for report in self._own:
            report(sink)
        early = self._report_early() if self.first else []
        if early and not (asked or final):
            return early  # on their way, before anything is waited for
        waiting, self._changes = self._changes, []
        noted = Noted(len(waiting), len(self._untold))
        may = self.upkeep.settle(now, noted, sink, asked=asked, final=final)
        own, self._changes = self._changes, waiting[may.changes :]
        events = may.events
        if self.upkeep.beside and not final and self.upkeep.stored:
            self._changes += own  # of the memory's own faults: they are written next
            own = []
        elif may == noted:
            events = len(self._untold)
        told, self._untold = self._untold[:events], self._untold[events:]
        stored = self.upkeep.stored
        ahead, self._ahead = self._ahead, self._ahead - Noted(may.changes, events)
        for event in told[ahead.events :]:
            if event["event"] == "dtc":
                event["stored"] = stored
                self.upkeep.not_stored += not stored
            self._hand(event)
        known = [event["fault"] for event in told[: ahead.events] if event["event"] == "dtc"]
        self.upkeep.not_stored += 0 if stored else len(known)
        if known and stored:
            t_ns = self._engine.wall_ns(now)
            self._hand({"event": "stored", "t_ns": t_ns, "faults": list(dict.fromkeys(known))})
        return early + own + waiting[ahead.changes : may.changes]

    def _report_early(self) -> list[DtcChange]:
        """Tell what is noted as not stored; returns the changes to send."""
        for event in self._untold[self._ahead.events :]:
            if event["event"] == "dtc":
                event["stored"] = False
            self._hand(event)
        early = self._changes[self._ahead.changes :]
        self._ahead = Noted(len(self._changes), len(self._untold))
        return early
