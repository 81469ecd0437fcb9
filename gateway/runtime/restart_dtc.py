"""Restarts of the gateway after deaths: told, and a code of its own while they come again and again."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

from gateway.engine.checks.own_health import OWNER, RESTARTED
from gateway.engine.core import Engine, Sink
from gateway.faults.hung_monitors import hung_beside
from gateway.faults.memory import FaultMemory
from gateway.faults.restarts import REPEATED, Restart
from gateway_fdi.common.log import get_logger

log = get_logger(__name__)


class RestartDtc:
    """Tells of a restart.

    Args:
        engine: debounces the fault.
        memory: counts restarts.
        file: of the memory; None: there is none, nor a process before.
    """

    def __init__(self, engine: Engine, memory: FaultMemory, file: Path | None) -> None:
        self._engine, self._memory, self._file = engine, memory, file
        places = {slot.id: k for k, slot in enumerate(engine.faults)}
        self._place = places.get(f"{OWNER}.{RESTARTED.name}")
        self._reported: bool | None = False if file is None else None

    def succeed(self, old: RestartDtc) -> None:
        """Go on where that of an earlier configuration stops."""
        if (self._place is None) == (old._place is None):
            self._reported = old._reported

    def again(self) -> None:
        """Report again if there is something to report: the reports have been cleared."""
        self._reported = None if self._reported else self._reported

    def note(self, t_ns: int, boot: str = "") -> Restart | None:
        """Count this start (see :meth:`gateway.faults.restarts.Restarts.note`); returns what it found."""
        if self._file is None:
            return None
        return self._memory.restarts.note(t_ns, boot, hung_beside(self._file).monitors)

    def events(self) -> list[dict[str, Any]]:
        """Log what the start has found, and return the event that tells it; none after a stop."""
        found = self._memory.restarts.found
        if found is None:
            return []
        number = self._memory.cycle_number()
        fields = {**asdict(found), "file": str(self._file)}
        log.warning("the last process was not stopped: its operation cycle goes on", cycle=number, **fields)
        return [{"event": "restart", **fields, "wait_s": found.wait_s, "cycle": number}]

    def report(self, sink: Sink) -> None:
        """Report the gateway's own fault, if that is news."""
        restarts = self._memory.restarts
        failed = restarts.in_a_row >= REPEATED
        if self._place is None or failed == self._reported:
            return
        self._reported = failed
        self._engine.report(self._place, failed, float(restarts.in_a_row), REPEATED, (restarts.count,), sink)
