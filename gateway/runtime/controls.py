"""Requests of testers to the gateway, by any protocol."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Protocol

from gateway.engine.core import Engine
from gateway.faults.interventions import Intervention
from gateway.faults.memory import FaultMemory
from gateway.faults.recorder import Recorder
from gateway.faults.settings import ConditionSettings
from gateway.faults.status import Status
from gateway.faults.store import Store
from gateway.servers.tester_control import LatestResult


class Watcher(Protocol):
    """Knows of what testers do."""

    def before_clear(self) -> None:
        """Do what must be done before a tester's clear."""

    def after_clear(self, cleared: Iterable[str]) -> None:
        """Do what must be done after any clear, of the faults with these ids."""

    def note(self, intervention: Intervention) -> None:
        """Keep and tell what a tester did."""


class Controls:
    """Does what testers ask, on engine, fault memory and recorder together.

    Args:
        engine: the engine.
        memory: the fault memory.
        store: its file.
        recorder: of frames around failures, if there is one.
        slots: mailbox slots of signals by name.
        stale_ns: a signal that is older meets no condition.
        live: monitor and value of names that stand for a live value.
    """

    def __init__(
        self,
        engine: Engine,
        memory: FaultMemory,
        store: Store,
        recorder: Recorder | None,
        slots: Mapping[str, int],
        stale_ns: int,
        *,
        live: Mapping[str, tuple[str, str]] = MappingProxyType({}),
    ) -> None:
        self._engine = engine
        self._memory = memory
        self._store = store
        self._recorder = recorder
        self._slots, self._live = slots, live
        self._stale_ns = stale_ns
        self._watcher: Watcher | None = None
        self._index = {definition.id: k for k, definition in enumerate(memory.catalogue)}
        # Which testers have it off; a tester's address stands for him.
        self._dtcs_off: set[str] = set()
        self._deaf: set[str] = set()
        self._mute: set[str] = set()

    def connect(self, watcher: Watcher) -> None:
        """Tell a watcher of changes; it needs this object itself, so it comes later."""
        self._watcher = watcher

    def fault_detection_counter(self, fault: str) -> int:
        """Return a fault's detection counter now, -128..127; 0 for one that is not monitored any more."""
        index = self._index.get(fault)
        return 0 if index is None else self._engine.fault_detection_counter(index)

    def fault_detection_counters(self) -> dict[str, int]:
        """Return the detection counters of all monitored faults now, -128..127."""
        return dict(zip(self._index, self._engine.fault_detection_counters().tolist(), strict=True))

    def wall_ns(self) -> int:
        """Return now, by the wall clock [ns]."""
        return self._engine.wall_ns(self._engine.now_ns)

    def test_result(self, fault: str) -> LatestResult | None:
        """Return a fault's latest test result; None: not tested since the clear, or since the operation cycle began."""
        index = self._index.get(fault)
        found = None if index is None else self._engine.last_result(index)
        return None if found is None else LatestResult(*found)

    def value(self, name: str) -> float:
        """Return a signal's value now in its unit, NaN before the first; or a live value of a monitor."""
        if name in self._live:
            return self._engine.live_value(*self._live[name])
        slot = self._slots.get(name)
        return math.nan if slot is None else self._engine.value(slot)

    def fresh_value(self, name: str) -> float:
        """Return a signal's value now in its unit, NaN before the first, and when it is too old."""
        age_ns = self._engine.age_ns(self._slots[name])
        return math.nan if age_ns is None or age_ns > self._stale_ns else self.value(name)

    def meets(self, conditions: Sequence[ConditionSettings]) -> bool:
        """Return whether signals are in their ranges now; one that is unknown or too old is not."""
        return all(self._is_met(condition) for condition in conditions)

    def met_so_far(self, condition: ConditionSettings) -> bool:
        """Return whether a signal is in its range by the last value that came, however old; before the first it is."""
        value = self.value(condition.signal)
        return math.isnan(value) or self._contains(condition, value)

    def _is_met(self, condition: ConditionSettings) -> bool:
        return self._contains(condition, self.fresh_value(condition.signal))

    @staticmethod
    def _contains(condition: ConditionSettings, value: float) -> bool:
        low = -math.inf if condition.min is None else condition.min
        high = math.inf if condition.max is None else condition.max
        return low <= value <= high

    def note(self, intervention: Intervention) -> None:
        """Keep and tell what a tester did, or was refused; its time is now."""
        if self._watcher is not None:
            self._watcher.note(replace(intervention, t_ns=self._engine.wall_ns(self._engine.now_ns)))

    def knows(self, group: int) -> bool:
        """Return whether there is such a DTC or group."""
        return self._memory.knows(group)

    def clear(self, group: int) -> bool:
        """Clear one DTC or a group, durable on return; False if there is no such DTC or group.

        Raises:
            StoreError: it could not be written; nothing was cleared.
        """
        if not self._memory.knows(group):
            return False
        if self._watcher is not None:
            self._watcher.before_clear()
        self.forget(self._memory.clear(group))
        return True

    def forget(self, cleared: Iterable[str]) -> None:
        """Start the debounce of cleared faults again."""
        names = list(cleared)
        for index in (self._index[name] for name in names if name in self._index):
            self._engine.reset_debounce([index])
            self._engine.set_active(index, False)
        if self._recorder is not None:
            self._recorder.forget(names)
        if self._watcher is not None:
            self._watcher.after_clear(names)

    @property
    def results(self) -> bool:
        """Whether test results count: no tester has switched them off (0x85)."""
        return not self._dtcs_off

    @property
    def monitoring(self) -> bool:
        """Whether test results count: neither they nor reception are switched off."""
        return not (self._dtcs_off or self._deaf)

    @property
    def off_by(self) -> list[str]:
        """Names of all that have switched something off, reception and sending included; in order."""
        return sorted(self._dtcs_off | self._deaf | self._mute)

    @property
    def receive(self) -> bool:
        """Whether normal messages are received."""
        return not self._deaf

    @property
    def send(self) -> bool:
        """Whether normal messages are sent."""
        return not self._mute

    def set_dtcs(self, on: bool, by: str = "") -> None:
        """Let test results count, or not; they do when no tester has it off."""
        _switch(self._dtcs_off, on, by)
        self._hold()

    def set_communication(self, *, receive: bool, send: bool, by: str = "") -> None:
        """Switch normal communication; it is on when no tester has it off. Without reception no result counts."""
        before = bool(self._deaf)
        _switch(self._deaf, receive, by)
        if before and not self._deaf:
            self._engine.hear_again()
        _switch(self._mute, send, by)
        self._hold()

    def _hold(self) -> None:
        self._engine.hold_results(not self.monitoring)

    def start_cycle(self, t_ns: int) -> None:
        """Start the operation cycle of the gateway itself, at a time of the engine."""
        self._memory.start_cycle(self._engine.wall_ns(t_ns))
        self._engine.reset_debounce()
        self._engine.end_cycles()
        self.go_on()

    def go_on(self) -> None:
        """Take over in the middle of an operation cycle: faults that fail in the memory are there."""
        for fault, index in self._index.items():
            failing = self._memory.status_now(fault) & Status.TEST_FAILED
            self._engine.set_active(index, bool(failing))

    def restart_cycle(self) -> None:
        """End the operation cycle and begin the next one, as at key off and on."""
        now = self._engine.now_ns
        self._memory.end_cycle(self._engine.wall_ns(now))
        self.start_cycle(now)

    def begin(self, cycle: str, t_ns: int, *, supplies: bool = False) -> bool:
        """Begin an operation cycle that signals define, at a time for people; its faults are tested again.

        One that a process left open which is gone, and whose end was not seen since, goes on instead; but not after a
        power cut, where the signal that begins it is that of the power.

        Args:
            cycle: its name.
            t_ns: now, of the wall clock.
            supplies: whether the gateway's power goes with that signal.

        Returns:
            whether a new one began.
        """
        cut = supplies and self._memory.restarts.after_power_cut
        if not cut and self._memory.cycles.go_on(cycle):
            return False
        self._memory.start_cycle(t_ns, cycle)
        mine = [d.id for d in self._memory.catalogue if d.cycle == cycle]
        self._engine.reset_debounce(self._index[fault] for fault in mine)
        return True

    def end(self, cycle: str, t_ns: int) -> None:
        """End an operation cycle that signals define, at a time for people."""
        self._memory.end_cycle(t_ns, cycle)

    def compact(self) -> None:
        """Check and compact the fault memory's file.

        Raises:
            GatewayError: it is damaged, or cannot be written.
        """
        self._memory.join()
        self._store.compact()


def _switch(off: set[str], on: bool, by: str) -> None:
    if on:
        off.discard(by)
    else:
        off.add(by)
