"""Interventions of testers and other processes: kept, told, and in order with events that wait to be told.

A cleared fault must not be told as set after it. So all that waits is written and told before a clear.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from gateway.engine.core import Engine
from gateway.faults.clearing import AskedClear
from gateway.faults.interventions import Intervention
from gateway.faults.memory import FaultMemory
from gateway.runtime.controls import Controls
from gateway.runtime.disabled_monitors import DisabledMonitors
from gateway.runtime.event_json import clear_event, intervention_event
from gateway.runtime.monitoring_off_dtc import MonitoringOffDtc
from gateway.runtime.outbox import Outbox
from gateway.runtime.restart_dtc import RestartDtc
from gateway.runtime.verdicts import Verdicts
from gateway.servers.authority import Authority, Refusal, local_intervention


class Interventions:
    """Keeps and tells interventions, and does those of other processes.

    Args:
        engine: its clock.
        memory: the fault memory.
        outbox: tells.
        verdicts: take the events of what is committed before a clear.
        controls: start the debounce of cleared faults again.
        authority: judges whether another process may clear.
        standing: whether monitoring is off; it is reported again after a clear.
        own: other faults of the gateway itself, likewise.
    """

    def __init__(
        self,
        engine: Engine,
        memory: FaultMemory,
        outbox: Outbox,
        verdicts: Verdicts,
        controls: Controls,
        authority: Authority,
        standing: MonitoringOffDtc,
        own: Sequence[DisabledMonitors | RestartDtc],
    ) -> None:
        self._engine, self._memory, self._outbox, self._verdicts = engine, memory, outbox, verdicts
        self._controls, self._authority = controls, authority
        self._standing, self._own = standing, own
        self._entries: set[str] = set()  # before the clear that is done now

    def note(self, intervention: Intervention) -> None:
        """Keep an intervention; it is told when it is stored."""
        told = self._memory.ledger.note_intervention(intervention)
        if told is not None:
            self._outbox.note(intervention_event(told))

    def before_clear(self) -> None:
        """Write and tell all that waits: a fault that is cleared next must not be told as set after it."""
        self._outbox.release_early(self._engine.now_ns, self._verdicts.take)
        self._entries = {entry.fault for entry in self._memory.entries()}

    def after_clear(self, cleared: Iterable[str]) -> None:
        """Tell which entries went."""
        for each in self._own:
            each.again()
        cleared = list(cleared)
        self._standing.after_clear(cleared)
        gone = sorted(self._entries.intersection(cleared))
        t_ns = self._engine.wall_ns(self._engine.now_ns)
        self._outbox.report(clear_event(t_ns, gone))
        self._verdicts.look_again()

    def serve_requests(self) -> None:
        """Do what other processes asked the fault memory for (``gateway faults clear``)."""
        judged: list[tuple[AskedClear, Refusal]] = []

        def judge(asked: AskedClear) -> int:
            refusal = self._authority.local_refusal("clear")
            judged.append((asked, refusal))
            return Refusal.NONE if asked.force else refusal

        cleared = self._memory.serve_requests(self.before_clear, judge)
        for asked, refusal in judged:
            if not (cleared or (refusal and not asked.force)):
                continue  # it could not be written, or there was nothing
            request = b"\x14" + asked.group.to_bytes(3, "big")
            self._controls.note(
                local_intervention("clear", request, asked.by, refusal, force=asked.force, why=asked.why)
            )
        if cleared:
            self._controls.forget(cleared)
