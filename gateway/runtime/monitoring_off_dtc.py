"""The standing DTC that says that monitoring is switched off, for as long as it is.

It is reported between two batches, not in the middle of a request. No test result counts while monitoring is off; this
one is the exception, so results are let through for as long as it takes.
"""

from __future__ import annotations

from collections.abc import Iterable

from gateway.engine.checks.own_health import MONITORING_OFF, OWNER
from gateway.engine.core import Engine, Sink
from gateway.runtime.controls import Controls


class MonitoringOffDtc:
    """Reports whether monitoring is off.

    Args:
        engine: debounces the fault.
        controls: say whether it is off.
        told: whether nothing is to be reported at the start, as where no file has what was before.
    """

    def __init__(self, engine: Engine, controls: Controls, *, told: bool) -> None:
        self._engine, self._controls = engine, controls
        places = {slot.id: k for k, slot in enumerate(engine.faults)}
        self._id = f"{OWNER}.{MONITORING_OFF.name}"
        self._place = places.get(self._id)
        self._told: bool | None = False if told else None

    def succeed(self, old: MonitoringOffDtc) -> None:
        """Go on where that of an earlier configuration stops: its report may be true no longer."""
        if old._told:
            self._told = None

    def after_clear(self, cleared: Iterable[str]) -> None:
        """Report it once more, if it was cleared and is there still."""
        if self._told and self._id in cleared:
            self._told = None

    @property
    def settled(self) -> bool:
        """Whether what was reported is so."""
        return self._place is None or self._told is (not self._controls.monitoring)

    def settle(self, sink: Sink) -> None:
        """Report what is news."""
        if self._place is None or self.settled:
            return
        off = self._told = not self._controls.monitoring
        results, input_stage = not self._controls.results, not self._controls.receive
        self._engine.hold_results(False)
        self._engine.report(self._place, off, float(off), 0.0, (float(results), float(input_stage)), sink)
        self._engine.hold_results(off)
