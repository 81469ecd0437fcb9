"""The diagnosis of a gateway: causes of its faults, and what they make of entries of the fault memory."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from gateway.engine.checks.communication import CheckInstance
from gateway.engine.core import Engine
from gateway.engine.depends.derive import Dependences
from gateway.engine.events import Events
from gateway.faults.memory import FaultMemory
from gateway.runtime.diagnosis import Diagnosis, NoteChanges
from gateway_causes.causes import Causes
from gateway_causes.explainer import Explainer


class CauseDiagnosis(Diagnosis):
    """Keeps causes up to date, and has the memory know them.

    Args:
        engine: has the verdicts.
        memory: has the entries.
        known: components that each fault's test depends on.
        checks: of messages, with their timeouts.
        hold: whether symptoms are held.
        note: takes events to be told.
    """

    def __init__(
        self,
        engine: Engine,
        memory: FaultMemory,
        known: Dependences,
        checks: Sequence[CheckInstance],
        *,
        hold: bool,
        note: Callable[[dict[str, Any]], None],
    ) -> None:
        self._causes = Causes(engine, known, checks)
        self._explainer = Explainer(engine, memory, known.seen, self._causes, hold=hold, note=note)

    def connect(self, note_changes: NoteChanges) -> None:
        """Take who keeps changes of status bytes."""
        self._explainer.note_changes = note_changes

    def take(self, events: Events) -> None:
        """Take events of the engine."""
        self._causes.take(events)

    def failed(self, fault: str, t_ns: int) -> None:
        """Note when a fault failed [ns]."""
        self._explainer.failed(fault, t_ns)

    def look_soon(self) -> None:
        """Look again: verdicts have been taken back, of which no event tells."""
        self._causes.look_soon()

    def look_at_entries(self) -> None:
        """Have an entry looked at that was made without a failure now."""
        self._explainer.look_soon()

    def begin(self, t_ns: int) -> None:
        """Begin, or go on with another configuration [ns]."""
        self._explainer.begin(t_ns)

    def finish(self, t_ns: int) -> None:
        """Say what is to be said still: the process ends [ns]."""
        if self._causes.pending:
            self._causes.look(t_ns)
        self._explainer.finish(t_ns)

    def succeed(self, old: Diagnosis) -> None:
        """Go on where that of the configuration before stops."""
        if isinstance(old, CauseDiagnosis):
            self._causes.succeed(old._causes)
            self._explainer.succeed(old._explainer)

    def counters(self) -> dict[str, int]:
        """Return how many symptoms were held, and released."""
        held, released = self._explainer.held, self._explainer.released
        return {"symptoms_held": held, "symptoms_released": released} if held else {}
