"""The diagnosis of causes: the contract of the package that finds them; without one there are faults, and no causes."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from gateway.engine.events import Events
from gateway.faults.entries import DtcChange

#: Name of the call that makes the object.
DIAGNOSIS = "diagnosis"
#: Takes changes of status bytes.
NoteChanges = Callable[[Sequence[DtcChange]], object]


class Diagnosis:
    """Finds no causes. Times are the engine's [ns]."""

    def connect(self, note_changes: NoteChanges) -> None:
        """Take who keeps changes of status bytes."""

    def take(self, events: Events) -> None:
        """Take events of the engine."""

    def failed(self, fault: str, t_ns: int) -> None:
        """Note when a fault failed."""

    def look_soon(self) -> None:
        """Look again: verdicts have been taken back, of which no event tells."""

    def look_at_entries(self) -> None:
        """Have an entry looked at that was made without a failure now: there was no room for it before."""

    def begin(self, t_ns: int) -> None:
        """Begin, or go on with another configuration."""

    def finish(self, t_ns: int) -> None:
        """Say what is to be said still: the process ends."""

    def succeed(self, old: Diagnosis) -> None:
        """Go on where that of the configuration before stops; ``old``: not to be used any more."""

    def counters(self) -> dict[str, int]:
        """Return what was counted, by name."""
        return {}
