"""Diagnoses in the fault memory: each entry gets its cause, and symptoms may be held.

An entry's part in its group of faults: it names the cause (of all that its test sees, it sees a component of the proven
cause best), it is a symptom, or nothing is proven. One entry leads: it stands for the cause, so that there is one DTC
for it that a tester finds confirmed, whether or not a fault names the component.

With ``symptoms = "hold"`` the confirmation of a fault waits until the diagnosis has spoken: :data:`LONGEST_NS` at most.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from gateway.common.times import NEVER
from gateway.engine.checks.communication import CheckInstance
from gateway.engine.core import Engine
from gateway.engine.depends.derive import Dependences
from gateway.engine.events import Events
from gateway.faults.explanation import CAUSE, HELD, MOST_RANKED, OPEN, SYMPTOM, WAITING, Cause, Ranked
from gateway.faults.memory import FaultMemory
from gateway.faults.records import Record
from gateway.faults.status import Status
from gateway.runtime.diagnosis import Diagnosis, NoteChanges
from gateway_causes.causes import PACE_NS, Causes

#: Longest time that a confirmation waits for the diagnosis [ns].
LONGEST_NS = 30_000_000_000
#: Time that a proven cause stands while some of its faults have healed, and no other has come: the rest of them, which
#: heal more slowly, say less of it than all did [ns].
HEALING_NS = 30_000_000_000
#: Causes that are less probable are not kept.
_LEAST = 0.01


@dataclass(frozen=True)
class _Group:
    """Faults that failed together, as of the latest diagnosis: their ids, the proven cause, and all ranked."""

    failed: frozenset[str]
    proven: Mapping[str, Any] | None
    ranked: tuple[Ranked, ...]


@dataclass(frozen=True)
class _Standing:
    """A proven cause: the group that it was proven for, and until when it stands, once some have healed [ns]."""

    failed: frozenset[str]
    until_ns: int = NEVER


class Explainer(Diagnosis):
    """Has causes found, and takes diagnoses into the fault memory.

    Args:
        engine: has the verdicts.
        memory: has the entries.
        known: components that each fault's test depends on.
        checks: of messages, with their timeouts.
        hold: whether symptoms are held.
        note: takes events to be told.

    Attributes:
        held, released: how many symptoms were held, and how many of these were confirmed later.
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
        self._engine, self._memory, self._depends = engine, memory, known.seen
        self._causes = causes = Causes(engine, known, checks)
        self._note = note
        self._note_changes: NoteChanges = lambda changes: None
        self._index = {slot.id: k for k, slot in enumerate(engine.faults)}
        self._groups: dict[str, _Group] = {}
        self._standing: dict[str, _Standing] = {}
        self._since: dict[str, int] = {}  # of what waits, by the engine's time
        self._news, self._due = True, NEVER  # whether causes are to be kept again, and when in any case
        self.held = self.released = 0
        if hold:
            memory.wait_for_causes(causes.tested)
        self._hold = causes.awaited = hold
        causes.tell, causes.after_look = self._take_diagnosis, self._look

    def connect(self, note_changes: NoteChanges) -> None:
        """Take who keeps changes of status bytes."""
        self._note_changes = note_changes

    def succeed(self, old: Diagnosis) -> None:
        """Go on where that of an earlier configuration stops."""
        if not isinstance(old, Explainer):
            return
        self._causes.succeed(old._causes)
        # The next diagnosis looks at entries that were explained by faults that no longer exist.
        known = self._depends.keys()
        self._groups = {fault: group for fault, group in old._groups.items() if group.failed <= known}
        self._standing, self._since = old._standing, old._since
        self.held, self.released = old.held, old.released

    def begin(self, t_ns: int) -> None:
        """Confirm what no diagnosis can speak of: it waited when its process ended, or was held by other rules.

        Args:
            t_ns: now, of the engine's time.
        """
        known = self._causes.tested if self._hold else frozenset[str]()
        overdue = [
            record.id
            for record in self._memory.unsettled()
            if record.id not in known or (record.hold == WAITING and record.id not in self._since)
        ]
        self._confirm(overdue, t_ns)

    def take(self, events: Events) -> None:
        """Take events of the engine."""
        self._causes.take(events)

    def look_soon(self) -> None:
        """Look again: verdicts have been taken back, of which no event tells."""
        self._causes.look_soon()

    def failed(self, fault: str, t_ns: int) -> None:
        """Note when a fault failed, by the engine's time: waiting entries are not judged by an earlier diagnosis."""
        self._news = True
        if self._hold:
            self._since[fault] = t_ns

    def _take_diagnosis(self, event: dict[str, Any]) -> None:
        """Take a diagnosis, and tell it; :meth:`_look` follows."""
        self._news = True
        self._groups = {}
        for told in event["groups"]:
            group = _group(told)
            self._groups |= dict.fromkeys(group.failed, group)
        self._note(event)

    def _look(self, t_ns: int) -> int:
        """Bring the memory up to date; returns when to look again.

        Args:
            t_ns: now, of the engine's time.
        """
        if self._news or t_ns >= self._due:
            self._explain_all(t_ns)
        return min(self._due, self._settle(t_ns)) if self._hold else self._due

    def finish(self, t_ns: int) -> None:
        """Look once more, and confirm what waits still: the process ends."""
        if self._causes.pending:
            self._causes.look(t_ns)
        self._confirm([record.id for record in self._memory.unsettled() if record.hold == WAITING], t_ns)

    def look_at_entries(self) -> None:
        """Have an entry looked at that was made without a failure now: there was no room for it before."""
        if self._hold or self._groups:
            self._news = True
            self._engine.pause_ns = min(self._engine.pause_ns, self._engine.now_ns + PACE_NS)

    def counters(self) -> dict[str, int]:
        """Return how many symptoms were held, and released."""
        return {"symptoms_held": self.held, "symptoms_released": self.released} if self.held else {}

    # Causes

    def _explain_all(self, t_ns: int) -> None:
        self._news, self._due = False, NEVER
        leads: dict[frozenset[str], str] = {}
        for fault, group in self._groups.items():
            if group.failed not in leads:
                leads[group.failed] = self._lead(group)
            self._due = min(self._due, self._explain(fault, group, leads[group.failed], t_ns))
        self._standing = {fault: s for fault, s in self._standing.items() if fault in self._groups}

    def _explain(self, fault: str, group: _Group, lead: str, t_ns: int) -> int:
        """Keep what explains an entry; returns when to look at it again, as it may not stand for ever."""
        record = self._memory.record(fault)
        if not record.occurrence:
            return NEVER
        cause = self._cause(fault, group, lead, self._engine.wall_ns(t_ns))
        standing = self._standing.get(fault)
        if cause.proven:
            self._standing[fault] = _Standing(group.failed)
        elif standing is not None and record.cause is not None and group.failed < standing.failed:
            until_ns = min(standing.until_ns, t_ns + HEALING_NS)
            if t_ns < until_ns:
                self._standing[fault] = replace(standing, until_ns=until_ns)
                return until_ns
            del self._standing[fault]
        elif standing is not None:
            del self._standing[fault]
        if not cause.same(record.cause):
            self._memory.explain(fault, cause)
        return NEVER

    def _cause(self, fault: str, group: _Group, lead: str, t_ns: int) -> Cause:
        if group.proven is None or fault not in group.proven["explains"]:
            return Cause(OPEN, group.ranked, "", "", t_ns)
        components = tuple(group.proven["components"])
        role = CAUSE if self._names(fault, components) else SYMPTOM
        ranked = sorted(group.ranked, key=lambda one: one.components != components)
        return Cause(role, tuple(ranked), lead, str(self._memory.definition(lead).dtc), t_ns)

    def _names(self, fault: str, components: Iterable[str]) -> bool:
        return self._depends[fault][0].component.told in components

    def _lead(self, group: _Group) -> str:
        """Return the fault that stands for a proven cause; "": there is none.

        One that names it, else the one that led before, else the one that sees it best and failed first.
        """
        if group.proven is None:
            return ""
        components = set(group.proven["components"])
        explained = [fault for fault in group.proven["explains"] if self._memory.record(fault).occurrence]

        def key(fault: str) -> tuple[bool, bool, float, int, str]:
            record = self._memory.record(fault)
            led = record.cause is not None and record.cause.lead == fault and components == set(record.cause.components)
            power = max((one.power for one in self._depends[fault] if one.component.told in components), default=0.0)
            return (not self._names(fault, components), not led, -power, record.last_ns or 0, fault)

        return min(explained, key=key, default="")

    # Holding

    def _settle(self, t_ns: int) -> int:
        """Hold or confirm what waits, and release what is held no more; returns when to look again."""
        due = NEVER
        symptoms: list[Record] = []
        freed: list[str] = []
        for record in self._memory.unsettled():
            since = self._since.setdefault(record.id, t_ns - 1)
            if record.id in self._groups and self._is_symptom(record):
                symptoms.append(record)
            elif record.hold == HELD and record.id not in self._groups:
                continue  # it does not fail now, or is not tested: nothing speaks against the cause
            elif since >= t_ns:
                due = min(due, since + PACE_NS)
            elif record.id in self._causes.waiting and t_ns < since + LONGEST_NS:
                due = min(due, since + LONGEST_NS)
            else:
                freed.append(record.id)
        self._confirm(freed, t_ns)
        # Where the lead is not confirmed (it takes more cycles, or was cleared), the cause would stay hidden.
        led = {record.id for record in symptoms if self._is_confirmed(record)}
        self._confirm([record.id for record in symptoms if record.id not in led], t_ns)
        self._tell_held([record for record in symptoms if record.id in led and record.hold == WAITING], t_ns)
        return due

    def _is_confirmed(self, symptom: Record) -> bool:
        """Return whether the entry is confirmed that stands for a symptom's cause."""
        cause = symptom.cause
        return cause is not None and bool(self._memory.record(cause.lead).status & Status.CONFIRMED_DTC)

    def _is_symptom(self, record: Record) -> bool:
        """Return whether an entry is held: a symptom, unless a lamp would stay dark that its lead does not ask for."""
        cause = record.cause
        if cause is None or cause.role != SYMPTOM or cause.lead == record.id:
            return False
        mine, lead = self._memory.definition(record.id), self._memory.definition(cause.lead)
        return not mine.indicator or (lead.indicator and lead.lamp == mine.lamp)

    def _tell_held(self, held: Sequence[Record], t_ns: int) -> None:
        by_lead: dict[str, list[Record]] = {}
        for record in held:
            self._memory.hold(record.id)
            by_lead.setdefault(record.cause.lead if record.cause else "", []).append(record)
        self.held += len(held)
        wall_ns = self._engine.wall_ns(t_ns)
        for lead, records in by_lead.items():
            self._note(symptoms_event(wall_ns, "held", [record.id for record in records], records[0].cause, lead))

    def _confirm(self, faults: Sequence[str], t_ns: int) -> None:
        wall_ns = self._engine.wall_ns(t_ns)
        released = [fault for fault in faults if self._memory.record(fault).hold == HELD]
        self.released += len(released)
        if released:
            self._note(symptoms_event(wall_ns, "released", released, None, ""))
        for fault in faults:
            self._since.pop(fault, None)
            index = self._index.get(fault)
            fdc = 0 if index is None else self._engine.fault_detection_counter(index)
            self._note_changes(self._memory.confirm(fault, fdc, wall_ns))


def _group(told: Mapping[str, Any]) -> _Group:
    """Return a group of the event ``diagnosis``."""
    ranked = [Ranked(tuple(one["components"]), one["probability"]) for one in told["causes"]]
    kept = [one for k, one in enumerate(ranked) if one.probability >= _LEAST or not k]
    proven = None
    if told["cause"] is not None:
        proven = next(one for one in told["causes"] if one["components"] == told["cause"])
    return _Group(frozenset(told["failed"]), proven, tuple(kept[:MOST_RANKED]))


def symptoms_event(t_ns: int, state: str, faults: Sequence[str], cause: Cause | None, lead: str) -> dict[str, Any]:
    """Tell that symptoms are held by a proven cause, or that this cause is withdrawn.

    Args:
        t_ns: when, of the wall clock.
        state: "held" or "released".
        faults: their ids.
        cause: that holds them.
        lead: id of the fault that stands for it.
    """
    return {
        "event": "symptoms",
        "t_ns": t_ns,
        "state": state,
        "faults": list(faults),
        "cause": [] if cause is None else list(cause.components),
        "lead": lead,
    }
