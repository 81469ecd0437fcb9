"""Which components explain the faults that are there: looked at after a change of verdict, and when a wait is over.

A test says its qualified verdict; a test that passes did so last at the time of its latest result. Both
are as the engine has them at that time of the frames, so that a log gives what the live gateway gave.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Sequence
from typing import Any

import numpy as np

from gateway.common.times import NEVER
from gateway.engine.checks.bus_health import SILENT
from gateway.engine.checks.communication import CheckInstance
from gateway.engine.core import Engine
from gateway.engine.depends.derive import Dependences
from gateway.engine.depends.parts import Seen
from gateway.engine.events import QUALIFIED_FAILED, QUALIFIED_PASSED, Events
from gateway.engine.instances import FaultSlot
from gateway.monitors.contract import LastResult
from gateway_fdi.diagnosis.answer import Diagnosis, Group
from gateway_fdi.diagnosis.diagnoser import Diagnoser
from gateway_fdi.diagnosis.discriminating_tests import telling
from gateway_fdi.diagnosis.state import FAILED, NOT_TESTED, PASSED, Sized
from gateway_fdi.diagnosis.system import Link, Test

#: Probability that a verdict is wrong though all is well: it is debounced, and thresholds are set for hours. A check of
#: messages compares values without noise.
FALSE_ALARM, EXACT = 1e-6, 1e-8
#: Diagnoses from this probability on are news when their order changes.
_NEWS = 0.05
#: Time after which a test has seen a fault, where nothing says it [s].
DELAY_S = 5.0
#: Of a timeout, this number of times its time: silence may begin right after a frame, and it is debounced.
_TIMEOUTS = 2.0
#: Failures within this time are looked at together, so that the work stays bounded [ns].
PACE_NS = 100_000_000
#: A wait that is over without a result, and tests behind a fault, are looked at again after this time [ns], then twice
#: that, ...
_AGAIN_NS = 100_000_000
#: ... up to this number of times.
_MOST_LOOKS = 10
#: Number of settings of the wall clock that are remembered.
_MOST_OFFSETS = 8
#: Causes that an event tells of each group, and tests that would tell them apart; of causes, those too that have this
#: share of the last one's probability: which of several equals it is nobody can say.
_TOLD, _EQUAL = 5, 0.9
#: Components that concern nothing else: their own fault says all that they explain.
_ALONE = ("gateway", "reported")
#: First passes from this number on are taken all at once.
_MANY = 4


class Causes:
    """Keeps the diagnoses of an engine's faults up to date.

    Args:
        engine: has the verdicts.
        depends: components that each fault's test depends on.
        checks: of messages, with their timeouts.

    Attributes:
        tell: takes the event.
        tested: ids of the faults that are looked at.
        awaited: whether a look is waited for even if nothing fails any more.
        waiting: ids of those that fail, where a slower test can still speak.
        after_look: called at the end of each look with its time; returns when it is to be looked again.
    """

    def __init__(
        self,
        engine: Engine,
        depends: Dependences,
        checks: Sequence[CheckInstance],
    ) -> None:
        self._engine, self._read, self._behind = engine, depends.read, depends.behind
        self.tell: Callable[[dict[str, Any]], None] = lambda event: None
        seen = depends.seen
        used = {slot.id for slot in engine.faults if seen[slot.id][0].component.kind not in _ALONE}
        self.tested, self.waiting = frozenset(used), frozenset[str]()
        self.awaited = False
        self.after_look: Callable[[int], int] = lambda t_ns: NEVER
        self._tests = [k for k, slot in enumerate(engine.faults) if slot.id in used]
        slots = [engine.faults[k] for k in self._tests]
        delays = _delays(engine, checks)
        self._timeouts = {k for k, slot in enumerate(engine.faults) if slot.id.endswith(".timeout")}
        exact = {check.name for check in checks}
        inner = {name: (each, tests) for tests in self._behind for name, each in tests.seen.items()}
        whole = [*(seen[slot.id] for slot in slots), *(each for each, _ in inner.values())]
        components = {one.component.name: one.component for each in whole for one in each}
        self._diagnoser = Diagnoser(
            list(components.values()),
            [
                *(_test(slot, seen[slot.id], delays.get(slot.id), exact) for slot in slots),
                *(
                    Test(name, _links(each), tests.false_alarms.get(name, FALSE_ALARM), DELAY_S)
                    for name, (each, tests) in inner.items()
                ),
            ],
        )
        self._of = {name: tests for tests in self._behind for name in tests.seen}
        self._place = {k: place for place, k in enumerate(self._tests)}
        self._of_fault = np.full(len(engine.faults), -1, np.int64)
        self._of_fault[self._tests] = range(len(self._tests))
        self._index = np.array(self._tests, np.int64)
        silent = np.asarray(engine.tables.health["fault"])[:, SILENT].tolist()
        self._silent = {fault: bus for bus, fault in enumerate(silent) if fault >= 0}
        self._told: list[tuple[object, ...]] = []
        self._looks = self._failing = 0
        self._looked_ns = -NEVER
        self._heeded, self._skipped_ns = False, NEVER
        self._followed = False  # whether faults have failed whose tests go on to change, without an event
        self._reset = False  # whether tests have been reset since the last look, of which no event tells
        engine.on_pause, engine.on_reset = self.look, self._note_reset
        self._offsets: list[tuple[int, int]] = []  # of the wall clock, each since a time of the engine

    def take(self, events: Events) -> None:
        """Take events of the engine; they are judged a moment later, with those that come meanwhile."""
        offset_ns = self._note_offset()
        if self._take_first_passes(events, offset_ns):
            return
        for kind, fault, wall_ns in zip(*(events[name].tolist() for name in ("kind", "fault", "t_ns")), strict=True):
            if kind not in (QUALIFIED_FAILED, QUALIFIED_PASSED):
                continue
            failed, t_ns = kind == QUALIFIED_FAILED, wall_ns - offset_ns
            while (due := self._engine.pause_ns) < t_ns:  # of timers in a silence
                self.look(due)
            if not failed and self._is_unseen(fault, t_ns):
                self.look(t_ns)
            if fault in self._place:
                self._diagnoser.update(self._engine.faults[fault].id, FAILED if failed else PASSED, t_ns)
                self._failing += failed
            if self._failing or self._told:
                again_ns = self._skipped_ns if self._skipped_ns >= t_ns else NEVER
                self._engine.pause_ns = min(due, again_ns, t_ns + PACE_NS)
                self._looks, self._skipped_ns = 0, NEVER
            needed = failed or self._told or self.awaited or self._reset
            if self._failing and not (needed or self._diagnoser.state.fails):
                # It has passed again before anything was told; if it fails once more until then the look is due still.
                self._failing, self._skipped_ns, self._engine.pause_ns = 0, self._engine.pause_ns, NEVER
        self._heed()

    def _is_unseen(self, fault: int, t_ns: int) -> bool:
        """Return whether a message that comes again was not looked at while it was missing: its ECU starts again."""
        state, place = self._diagnoser.state, self._place.get(fault, -1)
        missed = fault in self._timeouts and place >= 0 and state.verdict[place] == FAILED
        return bool(missed and state.since[place] > self._looked_ns and t_ns - self._looked_ns >= PACE_NS)

    def _take_first_passes(self, events: Events, offset_ns: int) -> bool:
        """Take first passes where nothing has failed, all at once; returns False, and takes none, if there are others.

        Of a car with thousands of messages there are tens of thousands in its first seconds.
        """
        if len(events) < _MANY or self._failing or self._told or self.pending:
            return False
        kinds = events["kind"]
        if (kinds == QUALIFIED_FAILED).any():
            return False
        verdicts = events[kinds == QUALIFIED_PASSED]
        places = self._of_fault[verdicts["fault"]]
        known = places >= 0
        return self._diagnoser.pass_first(places[known], verdicts["t_ns"][known] - offset_ns)

    def _heed(self) -> None:
        """Have the engine leave its loop at first passes, too, while there is something that they may tell apart."""
        heeded = bool(self._failing or self._told)
        if heeded != self._heeded:
            self._heeded = heeded
            self._engine.heed_passes(heeded)

    def look(self, t_ns: int) -> None:
        """Look what explains the faults now, and tell it unless it is as it was.

        Args:
            t_ns: now, of the engine's time.
        """
        self._engine.pause_ns, self._looked_ns = NEVER, t_ns
        event = self._conclude(t_ns)
        if event is not None:
            self.tell(event)
        self._engine.pause_ns = min(self._engine.pause_ns, self.after_look(t_ns))
        self._heed()

    def _note_reset(self) -> None:
        """Have the next look, also one that was put off, see that tests have been reset."""
        self._reset = True
        if self._skipped_ns >= self._engine.now_ns:
            self._engine.pause_ns = min(self._engine.pause_ns, self._skipped_ns)
        self._skipped_ns = NEVER

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
        self._skipped_ns, self._reset = old._skipped_ns, True
        self._heed()

    def _conclude(self, t_ns: int) -> dict[str, Any] | None:
        self._renew(t_ns)
        groups = self._diagnoser.diagnose()
        self._failing = len(groups)
        self.waiting = frozenset(f for group in groups if group.waiting for f in self._faults(group.failed))
        self._plan_next(groups, t_ns)
        news = [self._gist(group) for group in groups]
        if news == self._told:
            return None
        self._told = news
        told = [self._group(group, t_ns) for group in groups]
        return {"event": "diagnosis", "t_ns": self._engine.wall_ns(t_ns), "groups": told}

    def _renew(self, t_ns: int) -> None:
        """Bring up to date what no event tells: tests that were reset, and until when tests passed."""
        engine, diagnoser, self._reset = self._engine, self._diagnoser, False
        engine.count_runs()
        known = diagnoser.state.verdict[: len(self._tests)]
        now = engine.tables.debounces["verdict"][self._index]
        for place in np.flatnonzero((now == 0) & (known != NOT_TESTED)).tolist():
            diagnoser.update(diagnoser.system.tests[place].name, NOT_TESTED, t_ns)
        self._look_behind(t_ns)
        beside = self._beside()
        counters = engine.fault_detection_counters() if beside else ()
        for place in beside:
            fault = self._tests[place]
            last = min(self._last_ns(fault), t_ns)
            name = diagnoser.system.tests[place].name
            if known[place] == PASSED and counters[fault] <= 0:
                diagnoser.update(name, PASSED, last)
            if name in self._read:
                self._renew_size(name, fault, int(known[place]))

    def _renew_size(self, name: str, fault: int, verdict: int) -> None:
        """Read the residual of a test; one whose results are others than its verdict says nothing new of sizes."""
        d = self._engine.tables.debounces[fault]
        if verdict != NOT_TESTED and int(d["last"]) == verdict:
            read = self._read[name]
            state = self._engine.state_of(read.monitor)[0]
            result = LastResult(d["evidence"].tolist(), float(d["value"]), float(d["limit"]), state)
            self._diagnoser.size(name, read(result))

    def _last_ns(self, fault: int) -> int:
        """Return when a fault's test said something last; a bus is not silent while it is heard [ns]."""
        if fault in self._silent:
            return int(self._engine.tables.health[self._silent[fault]]["heard_ns"])
        return self._engine_time(int(self._engine.tables.buckets[fault]["last_ns"]))

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
        return [place for place in found if place < len(self._tests)]

    def _look_behind(self, t_ns: int) -> None:
        """Bring up to date the tests that the faults are made of which have failed.

        A monitor that tells one of its faults says nothing of the others by that: its tests do. A test that has failed
        counts until all of the monitor's faults have healed: a second fault may cancel there what the first one does,
        and what fails then may look like a third one.
        """
        diagnoser, place = self._diagnoser, self._diagnoser.system.test_place
        verdict = diagnoser.state.verdict
        self._followed = False
        for tests in self._behind:
            failed = any(verdict[place[fault]] == FAILED for fault in tests.faults)
            self._followed |= failed
            for fault in tests.faults:
                qualified = int(self._engine.tables.debounces["verdict"][self._index[place[fault]]])
                if verdict[place[fault]] != FAILED and qualified == PASSED:
                    diagnoser.update(fault, NOT_TESTED if failed else PASSED, t_ns)
            levels = tests.levels(self._engine.state_of(tests.monitor)[0]) if failed else [math.nan] * len(tests.seen)
            for name, level in zip(tests.seen, levels, strict=True):
                if failed and verdict[place[name]] == FAILED and not level >= 1.0 and level != -math.inf:
                    continue
                now = NOT_TESTED if not level > -math.inf else FAILED if level >= 1.0 else PASSED
                diagnoser.update(name, now, t_ns)
                diagnoser.size(name, Sized(math.nan, math.nan, {}, 0.0, level) if now == FAILED else None)

    def _plan_next(self, groups: Sequence[Group], t_ns: int) -> None:
        untils = [wait.until_ns for group in groups for wait in group.waiting]
        later = [until for until in untils if until > t_ns]
        if later:
            due = min(later)
        elif (untils or self._followed) and self._looks < _MOST_LOOKS:
            due = t_ns + (_AGAIN_NS << self._looks)
            self._looks += 1
        else:
            return
        self._engine.pause_ns = due

    # Events -----------------------------------------------------------------------------------------------------------

    def _gist(self, group: Group) -> tuple[object, ...]:
        """Return the parts of a group that are worth an event when they change: failures and causes, in order."""
        system = self._diagnoser.system
        failed = tuple(self._faults(group.failed))
        ranked = [one for one in group.diagnoses if one.probability >= _NEWS]
        return (
            failed,
            group.cause is None,
            *(tuple(system.components[c].told for c in one.components) for one in ranked),
        )

    def _group(self, group: Group, t_ns: int) -> dict[str, Any]:
        system = self._diagnoser.system
        components = [c.told for c in system.components]
        cause = group.cause
        apart = telling(system, self._diagnoser.state, group)[:_TOLD]
        return {
            "failed": self._faults(group.failed),
            "cause": None if cause is None else [components[c] for c in cause.components],
            "causes": [
                {
                    "components": [components[c] for c in one.components],
                    "probability": round(one.probability, 4),
                    "explains": self._faults(one.explains),
                    "against": [
                        {"test": fault, "why": a.why, "factor": round(a.factor, 6)}
                        for a in one.against
                        for fault in (self._faults([a.test]) if a.test >= 0 else [None])
                    ],
                }
                for one in _listed(group)
            ],
            "waits_for": [
                {"test": fault, "for_s": max(round((w.until_ns - t_ns) * 1e-9, 3), 0.0)}
                for w in group.waiting
                for fault in self._faults([w.test])
                if w.test < len(self._tests)
            ],
            "apart_by": self._faults(apart),
        }

    def _faults(self, places: Iterable[int]) -> list[str]:
        """Return the faults of tests, by their ids; of one that faults are made of, those that have failed."""
        system, verdict = self._diagnoser.system, self._diagnoser.state.verdict
        found: dict[str, None] = {}
        for t in places:
            name = system.tests[t].name
            own = self._of[name].faults if name in self._of else (name,)
            found |= dict.fromkeys(o for o in own if o == name or verdict[system.test_place[o]] == FAILED)
        return list(found)


def _listed(group: Group) -> list[Diagnosis]:
    """Return the likeliest diagnoses, and all that are as likely as the last of them."""
    least = _EQUAL * group.diagnoses[:_TOLD][-1].probability
    return [one for k, one in enumerate(group.diagnoses) if k < _TOLD or one.probability >= least > 0.0]


def _delays(engine: Engine, checks: Sequence[CheckInstance]) -> dict[str, float]:
    """Return how long tests take whose faults do not say it, by their ids [s]."""
    settle_ns = engine.tables.health["settle_ns"]
    delays = {
        f"{check.name}.timeout": _TIMEOUTS * check.params.timeout_ms * 1e-3 + float(settle_ns[check.bus]) * 1e-9
        for check in checks
        if check.params.timeout_ms is not None
    }
    # Whenever a timeout is reported, it is known that the bus is heard.
    return delays | {slot.id: 0.0 for slot in engine.faults if slot.id.endswith(".bus_silent")}


def _links(depends: Sequence[Seen]) -> tuple[Link, ...]:
    seen = {one.component.name for one in depends}
    return tuple(Link(one.component.name, one.power, via=one.via if one.via in seen else "") for one in depends)


def _test(slot: FaultSlot, depends: Sequence[Seen], delay_s: float | None, exact: Collection[str]) -> Test:
    debounce = slot.fault.debounce
    if delay_s is None:
        delay_s = DELAY_S if debounce.failed_ms is None else max(2.0 * debounce.failed_ms * 1e-3, 1.0)
        delay_s += slot.fault.window_s
    return Test(slot.id, _links(depends), EXACT if slot.id.rpartition(".")[0] in exact else FALSE_ALARM, delay_s)
