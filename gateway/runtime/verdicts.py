"""The way of an engine's event into the fault memory, and of what came of it into the outbox."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gateway.config.model import Config
from gateway.engine.checks.kinds import RULE
from gateway.engine.events import (
    ACTIVITY,
    CLOCK_STEPPED,
    CYCLE_BEGAN,
    CYCLE_ENDED,
    LOSSY,
    MONITOR_OFF,
    NO_BUS,
    OTHER,
    QUALIFIED_FAILED,
    QUALIFIED_PASSED,
    RESULT_CHANGED,
    SHORT,
    SOURCE,
    STRANGER,
    Event,
    Events,
    each,
)
from gateway.faults.catalogue import FaultDefinition
from gateway.faults.entries import DtcChange
from gateway.faults.failures import Observed
from gateway.faults.memory import FaultMemory
from gateway.faults.recorder import Recorder
from gateway.faults.status import Status
from gateway.runtime.assemble import Parts
from gateway.runtime.controls import Controls
from gateway.runtime.diagnosis import Diagnosis
from gateway.runtime.disabled_monitors import DisabledMonitors
from gateway.runtime.event_json import (
    activity_event,
    clock_event,
    cycle_event,
    dtc_event,
    lossy_event,
    monitor_events,
    other_event,
    short_event,
    source_event,
)
from gateway.runtime.failing_rules import FailingRules
from gateway.runtime.outbox import Outbox
from gateway.runtime.security_events import SecurityEvents

_TEST_FAILED = int(Status.TEST_FAILED)


class Verdicts:
    """Takes the engine's events one by one.

    Args:
        config: has the buses' names.
        parts: engine, catalogue, cycles, and the signals of freeze frames.
        memory: takes verdicts.
        controls: give signals, and begin and end operation cycles.
        recorder: of frames around failures, if there is one.
        outbox: takes events to be told.
        off: monitors that are switched off.
        doubts: rules that no frame passes.
        causes: of the faults.
        on_failure: takes id and time, of the engine, of each fault that fails.
        strangers: tells of other senders.

    Attributes:
        count: events until now.
    """

    def __init__(
        self,
        config: Config,
        parts: Parts,
        memory: FaultMemory,
        controls: Controls,
        recorder: Recorder | None,
        outbox: Outbox,
        off: DisabledMonitors,
        doubts: FailingRules,
        diagnosis: Diagnosis,
        strangers: SecurityEvents,
    ) -> None:
        self._parts, self._engine, self._catalogue = parts, parts.engine, parts.catalogue
        self._buses = {NO_BUS: ""} | {k: bus.name for k, bus in enumerate(config.buses)}
        self._supply = {name: cycle.supplies for name, cycle in config.cycle.items()}
        self._memory, self._controls, self._recorder = memory, controls, recorder
        self._outbox, self._off, self._doubts = outbox, off, doubts
        self._diagnosis, self._strangers = diagnosis, strangers
        self._index = {definition.id: k for k, definition in enumerate(parts.catalogue)}
        self.count = 0

    def take(self, events: Events) -> None:
        """Take events of the engine, in order; it is the sink of :class:`gateway.engine.core.Engine`.

        Of changed results and passes there may be thousands at once, at a start: they are taken together.
        """
        self.count += len(events)
        kinds, faults, at = events["kind"], events["fault"], 0
        rare = np.flatnonzero((kinds != RESULT_CHANGED) & (kinds != QUALIFIED_PASSED)).tolist()
        for end in (*rare, len(events)):
            passed = faults[at:end][kinds[at:end] == QUALIFIED_PASSED].tolist()
            if end > at and self._memory.complete(passed):  # none of these faults is there
                if self._outbox.is_heard:
                    self._report(each(events[at:end]))
                at = end
            for event in each(events[at : end + 1]):
                self._take_one(event)
            at = end + 1
        self._diagnosis.take(events)

    def _report(self, events: Sequence[Event]) -> None:
        self._outbox.note(*monitor_events(events, self._catalogue, self._buses))

    def _take_one(self, event: Event) -> None:
        kind = event.kind
        if kind in (CYCLE_BEGAN, CYCLE_ENDED):
            self._on_cycle(event, began=kind == CYCLE_BEGAN)
            return
        if kind == CLOCK_STEPPED:
            self._on_step(event)
            return
        if kind == MONITOR_OFF:
            self._outbox.note(self._off.on_event(event, self._buses[event.bus]))
            return
        if kind == ACTIVITY:
            self._outbox.note(activity_event(event, self._buses[event.bus]))
            return
        if kind == LOSSY:
            self._outbox.note(lossy_event(event, self._buses[event.bus]))
            return
        if kind == OTHER:
            self._outbox.note(other_event(event, self._engine.plan, self._buses[event.bus]))
            if event.result == RULE:
                self._doubts.seek(self._engine.rule_of(event.fault), event.t_ns)
            return
        if kind == SHORT:
            self._outbox.note(short_event(event, self._engine.plan, self._buses[event.bus]))
            return
        if kind == SOURCE:
            self._outbox.note(source_event(event, self._engine.plan, self._buses[event.bus]))
            return
        if kind == STRANGER:
            self._strangers.on_stranger(event.fault, event.t_ns)
            return
        if kind == QUALIFIED_FAILED:
            self._strangers.on_failure(event)
            self._doubts.seek(event.fault, event.t_ns)
            self._diagnosis.failed(self._catalogue[event.fault].id, event.t_ns - self._engine.offset_ns)
        changes = self._memory.apply(event, self._observe)
        told = self.note_changes(changes)
        if kind not in (QUALIFIED_FAILED, QUALIFIED_PASSED) or not told:
            self._report([event])

    def look_again(self) -> None:
        """Have it looked at what explains the faults: verdicts have been taken back, of which no event tells."""
        self._diagnosis.look_soon()

    def note_changes(self, changes: Sequence[DtcChange]) -> bool:
        """Keep changes to be told when they are stored; returns whether there are any worth it."""
        told = [change for change in changes if change.concerns_fault]
        self._outbox.note_changes(told)
        for change in told:
            self._record(change)
            index = self._index.get(change.definition.id)  # None: it is monitored no more
            bus = NO_BUS if index is None else self._engine.faults[index].bus
            self._outbox.note(dtc_event(change, self._buses[bus]))
        return bool(told)

    def _record(self, change: DtcChange) -> None:
        if self._recorder is not None and int(change.new_status) & ~int(change.old_status) & _TEST_FAILED:
            t_ns = change.t_ns - self._engine.offset_ns
            self._recorder.on_failure(change.definition.id, t_ns, wall_ns=change.t_ns)

    def _on_cycle(self, event: Event, *, began: bool) -> None:
        name, t_ns = self._parts.cycles[event.fault], event.t_ns
        if began:
            supplies = self._supply[name]
            state = "began" if self._controls.begin(name, t_ns, supplies=supplies) else "goes on"
        else:
            self._controls.end(name, t_ns)
            state = "ended"
        bus, number = self._buses[event.bus], self._memory.cycle_number(name)
        self._outbox.note(cycle_event(t_ns, bus, name, state, number))

    def _on_step(self, event: Event) -> None:
        self._outbox.note(clock_event(event.t_ns, event.value))

    def _observe(self, definition: FaultDefinition) -> Observed:
        inputs = self._engine.inputs_of(self._index[definition.id])
        return Observed(
            {name: self._controls.value(name) for name in self._parts.frozen[definition.id]},
            {f"{ref.message}.{ref.signal}": value for ref, value in inputs.items()},
        )
