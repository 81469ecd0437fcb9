"""Security events of who is on the bus: messages that come too often or from two senders, identifiers nobody knows."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any

import numpy as np

from gateway.bus.frames import ID_MASK
from gateway.engine.checks.kinds import KINDS
from gateway.engine.checks.unknown_ids import MOST
from gateway.engine.core import Engine
from gateway.engine.events import Event
from gateway.runtime.security import Security

#: Faults of a message's check that are events, too: frames that its sender does not send.
_KINDS = {name for kind in KINDS for name in kind.foreign}


class SecurityEvents:
    """Tells what the engine sees of other senders.

    Args:
        engine: sees them.
        names: of the buses.
        checks: names of the messages' checks, the first part of their faults' ids.
        security: takes the events.
    """

    def __init__(self, engine: Engine, names: Sequence[str], checks: Collection[str], security: Security) -> None:
        self._engine, self._names, self._security = engine, names, security
        self._told: dict[int, int] = {}
        self._kinds = {
            k: (owner, kind)
            for k, slot in enumerate(engine.faults)
            for owner, _, kind in (slot.id.rpartition("."),)
            if owner in checks and kind in _KINDS
        }

    def on_failure(self, event: Event) -> None:
        """Take a fault that failed; it is an event if it is one of another sender."""
        found = self._kinds.get(event.fault)
        if found is not None:
            sensor, kind = found
            names = self._engine.faults[event.fault].fault.evidence
            context = dict(zip(names, event.evidence.tolist(), strict=False))
            self._security.note(event.t_ns, sensor, kind, context)

    def on_stranger(self, place: int, t_ns: int) -> None:
        """Take that an unknown identifier has come again: of the wall clock [ns]."""
        row = self._engine.tables.strangers[place]
        count = int(row["count"])
        bus, elsewhere, length = self._names[row["bus"]], int(row["elsewhere"]), int(row["length"])
        context: dict[str, Any] = {"frames": count}
        sensor = f"{bus}.others"
        if place < MOST:
            sensor = f"{bus}.{int(row['can_id']) & ID_MASK:X}"
            payload = int(row["word"]).to_bytes(8, "little")[:length].hex()
            context |= {"first_payload": payload, "length": length}
        if elsewhere:
            context["of_bus"] = self._names[elsewhere - 1]
        new = count - self._told.get(place, 0)
        self._told[place] = count
        self._security.note(t_ns, sensor, "wrong_bus" if elsewhere else "unknown", context, new)

    def finish(self, t_ns: int) -> None:
        """Tell the counts that were not told yet: at the end, of the wall clock [ns]."""
        for place in np.flatnonzero(self._engine.tables.strangers["count"]).tolist():
            if int(self._engine.tables.strangers["count"][place]) > self._told.get(place, 0):
                self.on_stranger(place, t_ns)
