"""Test results of other processes: who may report which faults, how often, and the end of a process.

A result goes through the fault's gate and debounce as a monitor's does (``engine/loop.py`` ``take_reports``), at the
time that the engine has when it comes. Sockets are the affair of :mod:`gateway_serve.report_socket`; a replay has none,
so that these faults are not tested there.
"""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from typing import Any

from gateway.common.times import NEVER
from gateway.engine.checks.own_health import OWNER, REPORTER_LOST
from gateway.engine.core import Engine, Sink
from gateway.faults.external_faults import ReporterParams, ReportParams, key_of
from gateway.host.process import user
from gateway.report.words import MOST_BYTES, REFUSALS, RESULTS
from gateway.runtime.controls import Controls
from gateway.runtime.reports import Reports
from gateway_fdi.common.log import get_logger
from gateway_fdi.errors import nearest

log = get_logger(__name__)

#: How often it is looked whether a report is overdue, and whether the gateway's own fault has to be told again [ns].
LOOK_NS = 50_000_000
#: Users without a right that are named in the log.
MOST_STRANGERS = 16
#: Faults among which the nearest to an unknown one is looked for: frames wait meanwhile.
MOST_COMPARED = 64


class _RefusedError(Exception):
    """A report is not taken: a word of REFUSALS, and more words for people."""

    def __init__(self, reason: str, why: str = "") -> None:
        self.reason, self.why = reason, why or REFUSALS[reason]
        super().__init__(self.why)


@dataclass
class _Sender:
    """One connection: its process, and the faults that it was the last one to report."""

    uid: int
    groups: frozenset[int]
    pid: int
    owns: set[str] = field(default_factory=set)


@dataclass
class _Reporter:
    """One table of the configuration, and the reports that have come for it."""

    params: ReporterParams
    uids: set[int]
    gids: set[int]
    left: float
    filled_s: float = -math.inf
    full: bool = True  # whether its bound has not been met since it was last full
    counts: Counter[str] = field(default_factory=Counter)
    due_ns: int = NEVER
    lost: set[str] = field(default_factory=set)

    def admits(self, sender: _Sender, own: int) -> bool:
        return sender.uid in (0, own) or sender.uid in self.uids or bool(sender.groups & self.gids)

    def takes_one_more(self, now_s: float) -> bool:
        """Return whether a report is within the bound now, and count it."""
        most = max(self.params.events_per_s, 1.0)
        passed_s = max(now_s - self.filled_s, 0.0)
        self.left, self.filled_s = min(self.left + passed_s * self.params.events_per_s, most), now_s
        if self.left < 1.0:
            return False
        self.full = self.full or self.left >= most
        self.left -= 1.0
        return True


class ExternalReports(Reports):
    """Takes reports of other processes.

    Args:
        params: the table ``[report]``.
        engine: debounces the faults.
        controls: say whether results count.
        sink: takes the engine's events.
        report: takes events of the JSON contract.
    """

    def __init__(
        self,
        params: ReportParams,
        engine: Engine,
        controls: Controls,
        sink: Sink,
        report: Callable[[dict[str, Any]], None],
    ) -> None:
        self._engine, self._controls, self._sink, self._report = engine, controls, sink, report
        self._own = user()
        self._reporters: dict[str, _Reporter] = {}
        self._keys: dict[str, tuple[str, ...]] = {}  # fault -> names of its data
        self._senders: dict[int, _Sender] = {}
        self._count = 0
        self._told_lost = -1  # how many were lost at the last report; -1: of this configuration there was none
        self._look_ns = 0
        self._strangers: Counter[int] = Counter()
        self._unknown: Counter[str] = Counter()  # refused, of no reporter
        self._places = {slot.id: k for k, slot in enumerate(engine.faults)}
        self._place = self._places.get(f"{OWNER}.{REPORTER_LOST.name}")
        for each in params.reporter:
            burst = max(each.events_per_s, 1.0)
            self._reporters[each.name] = _Reporter(each, each.uids(), each.gids(), burst)
            self._keys |= {f"{each.name}.{f.name}": tuple(key_of(name) for name in f.data) for f in each.fault}

    def succeed(self, old: Reports) -> None:
        """Go on where those of another configuration stop: same connections, same counts."""
        if not isinstance(old, ExternalReports):
            return
        self._senders, self._count = old._senders, old._count
        self._strangers, self._unknown = old._strangers, old._unknown
        for sender in self._senders.values():
            sender.owns &= self._keys.keys()
        for name, mine in self._reporters.items():
            before = old._reporters.get(name)
            if before is None:
                continue
            mine.counts, mine.lost = before.counts, before.lost & self._keys.keys()
            mine.left, mine.filled_s = min(before.left, mine.left), before.filled_s
            if mine.params.alive_ms == before.params.alive_ms:
                mine.due_ns = before.due_ns

    @property
    def begun(self) -> bool:
        """Whether the engine's time has begun, so that a report has one."""
        return self._engine.due_ns >= 0

    def enter(self, uid: int, groups: Collection[int] = (), pid: int = 0) -> int | None:
        """Take a connection; returns its number, None if its user may report nothing.

        Args:
            uid: user at the other end.
            groups: all groups of that process.
            pid: its number, for people.
        """
        sender = _Sender(uid, frozenset(groups), pid)
        if not any(reporter.admits(sender, self._own) for reporter in self._reporters.values()):
            self._strangers[uid] += 1
            if self._strangers[uid] == 1 and len(self._strangers) <= MOST_STRANGERS:
                log.warning("a user without the right to report test results is turned away", uid=uid, pid=pid)
            return None
        self._count += 1
        self._senders[self._count] = sender
        return self._count

    def take(self, number: int, packet: bytes, now_s: float) -> dict[str, Any]:
        """Take one report; returns what is answered.

        Args:
            number: of the connection.
            packet: JSON, see docs/report.md.
            now_s: of a clock that is never set [s].
        """
        sender, counts = self._senders[number], self._unknown
        ticket: dict[str, Any] = {}
        try:
            asked = _parsed(packet)
            ticket = {"id": asked["id"]} if "id" in asked else {}
            if "goodbye" in asked:
                sender.owns.clear()
                return {"ok": True, **ticket}
            reporter = self._reporter_of(asked["fault"])
            counts = reporter.counts
            if not reporter.admits(sender, self._own):
                raise _RefusedError("not_allowed")
            self._note(reporter, asked["fault"], sender)
            self._bound(reporter, now_s)
            self._apply(asked["fault"], asked["result"], asked.get("data", {}))
        except _RefusedError as refused:
            counts[refused.reason] += 1
            return {"ok": False, **ticket, "refused": refused.reason, "why": refused.why}
        counts["accepted"] += 1
        return {"ok": True, **ticket}

    def _reporter_of(self, fault: str) -> _Reporter:
        if fault not in self._keys:
            close = nearest(fault, self._keys) if len(self._keys) <= MOST_COMPARED else ""
            raise _RefusedError("unknown_fault", REFUSALS["unknown_fault"] + close)
        return self._reporters[fault.partition(".")[0]]

    def _note(self, reporter: _Reporter, fault: str, sender: _Sender) -> None:
        """Note who reports a fault now, and that its reporter is there."""
        if fault not in sender.owns:
            for other in self._senders.values():
                other.owns.discard(fault)
            sender.owns.add(fault)
        alive_ms = reporter.params.alive_ms
        if alive_ms is not None:
            reporter.due_ns = self._engine.now_ns + round(alive_ms * 1e6)
        if fault in reporter.lost:
            back, reporter.lost = sorted(reporter.lost), set()
            self._say(reporter, "back", "it reports again", back)
            self._settle()

    def _bound(self, reporter: _Reporter, now_s: float) -> None:
        if reporter.takes_one_more(now_s):
            return
        if reporter.full:
            reporter.full = False
            self._say(reporter, "refused", f"more than {reporter.params.events_per_s:g} reports in a second", [])
        raise _RefusedError("rate")

    def _apply(self, fault: str, result: str, data: dict[str, Any]) -> None:
        keys = self._keys[fault]
        unknown = sorted(data.keys() - set(keys))
        if unknown:
            known = f"its data are {', '.join(keys)}" if keys else "it has no data"
            raise _RefusedError("data", f"{unknown[0]}: {known}{nearest(unknown[0], keys)}")
        numbers = {name: _number(name, value) for name, value in data.items()}
        values = [numbers.get(name, math.nan) for name in keys]
        place, (failed, at_once) = self._places[fault], RESULTS[result]
        if failed is None:
            self._engine.report_not_tested(place, self._sink)
        elif not self._engine.report(place, failed, float(failed), 1.0, values, self._sink, at_once=at_once):
            raise _RefusedError("not_enabled" if self._controls.monitoring else "monitoring_off")

    def leave(self, number: int) -> None:
        """Take it that a connection has ended; its faults without a goodbye are not tested any more."""
        sender = self._senders.pop(number)
        for reporter in self._reporters.values():
            mine = {fault for fault in sender.owns if fault.startswith(f"{reporter.params.name}.")}
            if mine:
                self._lose(reporter, mine, f"its connection ended without a goodbye (process {sender.pid})")

    def let_go(self, number: int) -> None:
        """Take it that we end a connection: its reports stay as they are."""
        del self._senders[number]

    @property
    def is_due(self) -> bool:
        """Whether it is time for :meth:`pass_time`."""
        return self._engine.now_ns >= self._look_ns

    def pass_time(self) -> None:
        """Look whether a report is overdue, and whether the gateway's own fault is as it should be."""
        now = self._engine.now_ns
        if not self.is_due:
            return
        self._look_ns = now + LOOK_NS
        for name, reporter in self._reporters.items():
            alive_ms = reporter.params.alive_ms
            if alive_ms is None or reporter.lost:
                continue
            if reporter.due_ns == NEVER:
                reporter.due_ns = now + round(alive_ms * 1e6)
            elif now > reporter.due_ns:
                all_of_it = {f"{name}.{fault.name}" for fault in reporter.params.fault}
                self._lose(reporter, all_of_it, f"no report for {alive_ms:g} ms")
        self._settle()

    def _lose(self, reporter: _Reporter, faults: set[str], reason: str) -> None:
        reporter.counts["lost"] += 1
        reporter.due_ns = NEVER
        reporter.lost |= faults
        for fault in sorted(faults):
            self._engine.report_not_tested(self._places[fault], self._sink)
        self._say(reporter, "lost", reason, sorted(faults))
        self._settle()

    def _say(self, reporter: _Reporter, state: str, reason: str, faults: list[str]) -> None:
        name = reporter.params.name
        (log.info if state == "back" else log.warning)(
            "reporter of test results", reporter=name, state=state, reason=reason, faults=faults
        )
        t_ns = self._engine.wall_ns(self._engine.now_ns)
        self._report(
            {"event": "reporter", "t_ns": t_ns, "reporter": name, "state": state, "reason": reason, "faults": faults}
        )

    def _settle(self) -> None:
        """Report the gateway's own fault, if that is news, or was cleared, or begins a new operation cycle."""
        lost = sum(bool(reporter.lost) for reporter in self._reporters.values())
        if self._place is None or not self._controls.monitoring:
            return
        if lost != self._told_lost or self._engine.last_result(self._place) is None:
            self._told_lost = lost
            self._engine.report(self._place, lost > 0, float(lost), 0.0, (lost,), self._sink)

    def states(self) -> list[dict[str, Any]]:
        """Return how the reporters do: counts by outcome, "" is of reports that belong to none."""
        told = [
            {"reporter": name, "lost": sorted(reporter.lost), "counts": dict(reporter.counts)}
            for name, reporter in self._reporters.items()
        ]
        unknown = {reason: count for reason, count in self._unknown.items() if count}
        unknown |= {"turned_away": self._strangers.total()} if self._strangers else {}
        return [*told, {"reporter": "", "lost": [], "counts": unknown}]

    def counters(self) -> dict[str, int]:
        """Return how many reports were accepted and refused, and how often a reporter was lost."""
        whole = sum((reporter.counts for reporter in self._reporters.values()), Counter()) + self._unknown
        return {
            "reports_accepted": whole["accepted"],
            "reports_refused": sum(whole[reason] for reason in REFUSALS),
            "reporters_lost": whole["lost"],
        }


def _parsed(packet: bytes) -> dict[str, Any]:
    if len(packet) > MOST_BYTES:
        raise _RefusedError("malformed", f"a report has at most {MOST_BYTES} bytes")
    try:
        asked = json.loads(packet)
    except (ValueError, RecursionError):
        raise _RefusedError("malformed", "a report is one JSON object") from None
    if not isinstance(asked, dict):
        raise _RefusedError("malformed", "a report is one JSON object")
    unknown = sorted(asked.keys() - {"fault", "result", "data", "id", "goodbye"})
    if unknown:
        raise _RefusedError("malformed", f"a report has no key {unknown[0]}{nearest(unknown[0], ['fault', 'result'])}")
    if not isinstance(asked.get("id", 0), int | str):
        raise _RefusedError("malformed", "id: a number or a text")
    if "goodbye" in asked:
        return asked
    if not isinstance(asked.get("fault"), str):
        raise _RefusedError("malformed", "fault: the id of a fault")
    if asked.get("result") not in [*RESULTS]:
        raise _RefusedError("malformed", f"result: one of {', '.join(RESULTS)}")
    if not isinstance(asked.get("data", {}), dict):
        raise _RefusedError("malformed", "data: numbers by their names")
    return asked


def _number(name: str, value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise _RefusedError("data", f"{name}: a number")
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise _RefusedError("data", f"{name}: a finite number")
    return number
