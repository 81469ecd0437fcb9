"""Which components explain the faults that are there: looked at behind a change of verdict, and when a wait is over.

What a test says is its qualified verdict; when a test that passes did so last is the time of its latest result. Both
are as the engine has them at that time of the frames, so that a log gives what the live gateway gave.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from gateway.common.times import NEVER
from gateway.engine.checks.communication import CheckInstance
from gateway.engine.core import Engine
from gateway.engine.depends.parts import Seen
from gateway.engine.events import QUALIFIED_FAILED, QUALIFIED_PASSED, Events
from gateway.engine.instances import FaultSlot
from gateway.fdi.diagnosis.answer import Group
from gateway.fdi.diagnosis.apart import telling
from gateway.fdi.diagnosis.diagnoser import Diagnoser
from gateway.fdi.diagnosis.state import FAILED, NOT_TESTED, PASSED
from gateway.fdi.diagnosis.system import Link, Test

#: Probability that a verdict is wrong though all is well: it is debounced, and thresholds are set for hours.
FALSE_ALARM = 1e-6
#: Diagnoses from this probability on are news when their order changes.
_NEWS = 0.05
#: Time after which a test has seen a fault, where nothing says it [s].
DELAY_S = 5.0
#: Of a timeout, so many times its time: silence may begin right behind a frame, and it is debounced.
_TIMEOUTS = 2.0
#: What fails within so long is looked at together; there is no more work than that, whatever happens [ns].
PACE_NS = 100_000_000
#: A wait that is over without a result is looked at again after so long [ns], then twice that, ...
_AGAIN_NS = 100_000_000
#: ... so often.
_MOST_LOOKS = 10
#: So many settings of the wall clock are remembered.
_MOST_OFFSETS = 8
#: Causes that an event tells of each group, and tests that would tell them apart.
_TOLD = 5
#: Components that nothing else has to do with: what they explain, their own fault says.
_ALONE = ("gateway", "reported")


class Causes:
    """Keeps the diagnoses of an engine's faults up to date.

    Args:
        engine: has the verdicts.
        depends: fault id -> what its test sees.
        checks: of messages, with their timeouts.

    Attributes:
        tell: takes the event.
        tested: ids of the faults that are looked at.
        waiting: ids of those that fail, where a slower test can still speak.
        after_look: called at the end of each look with its time; returns when it is to be looked again.
    """

    def __init__(
        self,
        engine: Engine,
        depends: Mapping[str, tuple[Seen, ...]],
        checks: Sequence[CheckInstance],
    ) -> None:
        self._engine = engine
        self.tell: Callable[[dict[str, Any]], None] = lambda event: None
        used = {slot.id for slot in engine.faults if depends[slot.id][0].component.kind not in _ALONE}
        self.tested, self.waiting = frozenset(used), frozenset[str]()
        self.after_look: Callable[[int], int] = lambda t_ns: NEVER
        self._tests = [k for k, slot in enumerate(engine.faults) if slot.id in used]
        slots = [engine.faults[k] for k in self._tests]
        delays = _delays(engine, checks)
        components = {seen.component.name: seen.component for slot in slots for seen in depends[slot.id]}
        self._diagnoser = Diagnoser(
            list(components.values()),
            [_test(slot, depends[slot.id], delays.get(slot.id)) for slot in slots],
        )
        self._place = {k: place for place, k in enumerate(self._tests)}
        self._index = np.array(self._tests, np.int64)
        self._told: list[tuple[object, ...]] = []
        self._looks = self._failing = 0
        engine.on_pause = self.look
        self._offsets: list[tuple[int, int]] = []  # of the wall clock, each since a time of the engine

    def take(self, events: Events) -> None:
        """Take events of the engine; what they mean is looked at a moment later, with those that come meanwhile."""
        kinds, offset_ns = events["kind"], self._note_offset()
        for event in events[(kinds == QUALIFIED_FAILED) | (kinds == QUALIFIED_PASSED)]:
            fault, failed = int(event["fault"]), event["kind"] == QUALIFIED_FAILED
            t_ns = int(event["t_ns"]) - offset_ns
            while (due := self._engine.pause_ns) < t_ns:  # of timers in a silence
                self.look(due)
            if fault in self._place:
                self._diagnoser.update(self._engine.faults[fault].id, FAILED if failed else PASSED, t_ns)
                self._failing += failed
            if self._failing or self._told:
                self._engine.pause_ns = min(due, t_ns + PACE_NS)
                self._looks = 0

    def look(self, t_ns: int) -> None:
        """Look what explains the faults now, and tell it unless it is as it was.

        Args:
            t_ns: now, of the engine's time.
        """
        self._engine.pause_ns = NEVER
        event = self._conclude(t_ns)
        if event is not None:
            self.tell(event)
        self._engine.pause_ns = min(self._engine.pause_ns, self.after_look(t_ns))

    def look_soon(self) -> None:
        """Look at the causes a moment later, if there are any."""
        if self._told:
            self._engine.pause_ns = min(self._engine.pause_ns, self._engine.now_ns + PACE_NS)

    @property
    def pending(self) -> bool:
        """Whether there may be more to say."""
        return self._engine.pause_ns < NEVER

    def succeed(self, old: Causes) -> None:
        """Go on where those of an earlier configuration stop, with the tests that both have."""
        self._diagnoser.succeed(old._diagnoser)
        self._told, self._looks, self._failing = old._told, old._looks, old._failing
        self._engine.pause_ns, self._offsets = old._engine.pause_ns, old._offsets

    def _conclude(self, t_ns: int) -> dict[str, Any] | None:
        self._renew(t_ns)
        groups = self._diagnoser.diagnose()
        self._failing = len(groups)
        names = self._diagnoser.system.tests
        self.waiting = frozenset(names[t].name for group in groups if group.waiting for t in group.failed)
        self._plan_next(groups, t_ns)
        news = [self._gist(group) for group in groups]
        if news == self._told:
            return None
        self._told = news
        told = [self._group(group, t_ns) for group in groups]
        return {"event": "diagnosis", "t_ns": self._engine.wall_ns(t_ns), "groups": told}

    def _renew(self, t_ns: int) -> None:
        """Bring up to date what no event tells: tests that were reset, and until when tests passed."""
        engine, diagnoser = self._engine, self._diagnoser
        engine.tell_runs()
        known = diagnoser.state.verdict
        now = engine.tables.debounces["verdict"][self._index]
        for place in np.flatnonzero((now == 0) & (known != NOT_TESTED)).tolist():
            diagnoser.update(diagnoser.system.tests[place].name, NOT_TESTED, t_ns)
        for place in self._beside():
            fault = self._tests[place]
            last = min(self._engine_time(int(engine.tables.buckets[fault]["last_ns"])), t_ns)
            if known[place] == PASSED and engine.fault_detection_counter(fault) <= 0:
                diagnoser.update(diagnoser.system.tests[place].name, PASSED, last)

    def _note_offset(self) -> int:
        """Note what the wall clock is ahead of the engine's time, since when; returns it [ns]."""
        offset_ns = self._engine.offset_ns
        if not self._offsets:
            self._offsets.append((-NEVER, offset_ns))
        elif offset_ns != self._offsets[-1][1]:
            self._offsets.append((self._engine.now_ns, offset_ns))
            del self._offsets[:-_MOST_OFFSETS]
        return offset_ns

    def _engine_time(self, wall_ns: int) -> int:
        """Return the engine's time of a stamp of the wall clock, which may have been set since."""
        for since_ns, offset_ns in reversed(self._offsets):
            if since_ns <= wall_ns - offset_ns <= self._engine.now_ns:
                return wall_ns - offset_ns
        return -NEVER

    def _beside(self) -> list[int]:
        """Return the tests that see a component which a failed test blames."""
        system, failed = self._diagnoser.system, np.flatnonzero(self._diagnoser.state.verdict == FAILED)
        blamed = np.isin(system.link_component, system.link_component[np.isin(system.link_test, failed)])
        found: list[int] = np.unique(system.link_test[blamed]).tolist()
        return found

    def _plan_next(self, groups: Sequence[Group], t_ns: int) -> None:
        untils = [wait.until_ns for group in groups for wait in group.waiting]
        later = [until for until in untils if until > t_ns]
        if later:
            due = min(later)
        elif untils and self._looks < _MOST_LOOKS:
            due = t_ns + (_AGAIN_NS << self._looks)
            self._looks += 1
        else:
            return
        self._engine.pause_ns = due

    # What is told ----------------------------------------------------------------------------------------------------

    def _gist(self, group: Group) -> tuple[object, ...]:
        """Return what of a group is worth an event when it changes: what fails, by what, in which order."""
        system = self._diagnoser.system
        failed = tuple(system.tests[t].name for t in group.failed)
        ranked = [one for one in group.diagnoses if one.probability >= _NEWS]
        return (
            failed,
            group.cause is None,
            *(tuple(system.components[c].name for c in one.components) for one in ranked),
        )

    def _group(self, group: Group, t_ns: int) -> dict[str, Any]:
        system = self._diagnoser.system
        tests, components = [t.name for t in system.tests], [c.name for c in system.components]
        cause = group.cause
        apart = telling(system, self._diagnoser.state, group)[:_TOLD]
        return {
            "failed": [tests[t] for t in group.failed],
            "cause": None if cause is None else [components[c] for c in cause.components],
            "causes": [
                {
                    "components": [components[c] for c in one.components],
                    "probability": round(one.probability, 4),
                    "explains": [tests[t] for t in one.explains],
                    "against": [
                        {"test": tests[a.test] if a.test >= 0 else None, "why": a.why, "factor": round(a.factor, 6)}
                        for a in one.against
                    ],
                }
                for one in group.diagnoses[:_TOLD]
            ],
            "waits_for": [
                {"test": tests[w.test], "for_s": max(round((w.until_ns - t_ns) * 1e-9, 3), 0.0)} for w in group.waiting
            ],
            "apart_by": [tests[one.test] for one in apart],
        }


def _delays(engine: Engine, checks: Sequence[CheckInstance]) -> dict[str, float]:
    """Return how long tests take whose faults do not say it, by their ids [s]."""
    delays = {
        f"{check.name}.timeout": _TIMEOUTS * check.params.timeout_ms * 1e-3
        for check in checks
        if check.params.timeout_ms is not None
    }
    # Whenever a timeout is told, it is known that the bus is heard.
    return delays | {slot.id: 0.0 for slot in engine.faults if slot.id.endswith(".bus_silent")}


def _test(slot: FaultSlot, depends: Sequence[Seen], delay_s: float | None) -> Test:
    debounce = slot.fault.debounce
    if delay_s is None:
        delay_s = DELAY_S if debounce.failed_ms is None else max(2.0 * debounce.failed_ms * 1e-3, 1.0)
    links = tuple(Link(one.component.name, one.power) for one in depends)
    return Test(slot.id, links, FALSE_ALARM, delay_s)
