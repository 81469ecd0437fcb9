"""The engine as Python sees it: frames go in, events come out, the mailbox can be read."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gateway.bus.frames import CYCLIC, FRAME, Frames, copied, empty, joined
from gateway.engine import loop
from gateway.engine.buckets import Buckets, take
from gateway.engine.checks.bus_health import ACTIVITIES, COUNTED, GONE, OFF, SILENT, SPOKEN, WHOLE
from gateway.engine.checks.communication import COMES, NOT_YET, PROVEN, SAMPLES
from gateway.engine.checks.kinds import RULE
from gateway.engine.checks.runs import count_all_runs
from gateway.engine.debounce import all_detection_counters, fault_detection_counter, fold, reset_all
from gateway.engine.events import Events
from gateway.engine.gate import LEFT
from gateway.engine.instances import FaultSlot
from gateway.engine.tables import NEVER, Tables
from gateway.engine.timers import note_all
from gateway.monitors.contract import FAILED, NOT_TESTED, PASSED
from gateway.signals.tables import DecodePlan, SignalRef
from gateway_fdi.jit import Bound, Same, bound, cells_of

_NO_FRAMES = empty(0)
_NO_CELLS = np.zeros((0, FRAME.itemsize // 8), np.uint64)

#: Takes the events of one pass, in order. The array is only valid during the call.
Sink = Callable[[Events], None]


class Engine:
    """The compiled tables with the loop over them; made by :func:`gateway.engine.build.build_engine`.

    Not thread-safe: one thread feeds it.

    Attributes:
        pause_ns: time at which frames before it have been handled, and none from it on, and ``on_pause`` is called with
            it; NEVER: there is none. The sink may set it, and ``on_pause``.
        on_pause: takes that time.
        on_reset: called when debounce counters are set to zero, of which no event tells.
    """

    def __init__(
        self,
        plan: DecodePlan,
        tables: Tables,
        faults: tuple[FaultSlot, ...],
        monitors: tuple[Any, ...],
        states: tuple[Any, ...],
        consts: tuple[Any, ...],
    ) -> None:
        self.plan = plan
        self.tables = tables
        self.faults = faults
        self.monitors = monitors
        self._states = states
        self._consts = consts  # the handlers hold its address
        # The clock's numbers by their place: a record and its field take ten times as long to reach, for each batch.
        clock: Any = tables.clock
        self._clock = memoryview(clock.view("<i8"))
        place = {name: field[1] // 8 for name, field in clock.dtype.fields.items()}
        self._now, self._offset, self._due = place["now_ns"], place["offset_ns"], place["deadline_ns"]
        self._started, self._events, self._urgent = place["started"], place["events"], place["urgent"]
        self._to_send, self._fed, self._taken = place["sent"], place["fed"], place["taken"]
        self._outbox = np.asarray(tables.outbox)
        self._ranks = self._outbox["rank"]
        self._run: Callable[..., int] = self._first_run
        self.pause_ns = NEVER
        self.on_pause: Callable[[int], None] = lambda t_ns: None
        self.on_reset: Callable[[], None] = lambda: None
        firsts = zip(tables.handlers["fault"].tolist(), tables.handlers["faults"].tolist(), strict=True)
        self._monitor_of = {first + j: k for k, (first, count) in enumerate(firsts) for j in range(count)}
        self._rules = {int(row["fault"][RULE]): k for k, row in enumerate(tables.checks) if row["fault"][RULE] >= 0}

    def state_of(self, monitor: int) -> Any:
        """Return the state records of a monitor, shape (1,)."""
        return self._states[monitor].view(np.recarray)

    def place_of(self, name: str) -> int:
        """Return the place of a monitor, the first of its parts: in the order of priority, not the configuration's."""
        return next(k for k, instance in enumerate(self.monitors) if instance.name == name)

    def warm(self) -> None:
        """Load the machine code of the loop and of the monitors now, rather than at the first frame."""
        for handler, instance in zip(self.tables.handlers, self.monitors, strict=True):
            handler["entry"] = instance.entry
        self._run = bound(loop.run, self.tables, rest=(_NO_FRAMES, Same(0, _NO_CELLS), 0, NEVER))

    def _first_run(self, *arguments: Any) -> int:
        self.warm()
        return self._run(*arguments)

    def switch_off(self, monitor: int, why: int) -> None:
        """Step a monitor no more, which has not been stepped yet.

        Args:
            monitor: its place.
            why: as :func:`gateway_fdi.jit.call_entry` tells it; not 0.
        """
        self.tables.handlers[monitor]["off"] = why

    @property
    def now_ns(self) -> int:
        """Time of the latest frame or :meth:`advance` [ns]."""
        return int(self._clock[self._now])

    @property
    def due_ns(self) -> int:
        """Time before which no timer falls due [ns]; before its clock has started: the past."""
        return int(self._clock[self._due]) if self._clock[self._started] else -1

    @property
    def offset_ns(self) -> int:
        """Time that the wall clock is ahead of the engine's, since it was set [ns]."""
        return int(self._clock[self._offset])

    def wall_ns(self, t_ns: int) -> int:
        """Return a time of the engine as people read it [ns]."""
        return t_ns + self.offset_ns

    def process(self, frames: Frames, sink: Sink, until_ns: int = NEVER) -> Frames:
        """Feed a batch of frames, in order; returns what the monitors send.

        Args:
            frames: shape (n,) of FRAME.
            sink: called with the events, each time before any later frame is handled.
            until_ns: time that passes then, as by :meth:`advance`; NEVER: it ends with the last frame.
        """
        start, count = 0, len(frames)
        if not count and until_ns == NEVER:
            return _NO_FRAMES
        if self.pause_ns < NEVER:
            return self._in_parts(frames, sink, until_ns)
        if not frames.flags.carray:
            frames = copied(frames)  # the loop is compiled for one kind of array
        sent = []
        while True:
            start = self._run(frames, start, until_ns)
            if self._clock[self._events]:
                self._drain(sink)
            if self._clock[self._to_send]:
                sent.append(self._sent())
            if start >= count and (until_ns == NEVER or self._clock[self._now] >= until_ns):
                return joined(sent) if sent else _NO_FRAMES
            if self.pause_ns < NEVER:  # asked for by the sink
                return joined([*sent, self._in_parts(frames[start:], sink, until_ns)])

    def deliver(self, sink: Sink) -> Frames:
        """Give the events that wait where a pump has left to ``sink``; returns what the monitors have sent."""
        self._drain(sink)
        return self._sent()

    def resume(self, frames: Frames, start: int, sink: Sink) -> Frames:
        """Go on with a batch that a pump has begun, after :meth:`tell`; returns what the monitors send.

        Args:
            frames: of FRAME, shape (n,).
            start: the first that was not handled.
            sink: called with further events (see :meth:`process`).
        """
        sent = []
        if self.pause_ns < NEVER:  # asked for by the sink
            sent.append(self._in_parts(frames[start:], sink, NEVER))
        elif start < len(frames) or self._ranks[self._clock[self._fed] : self._clock[self._to_send]].any():
            sent.append(self.process(frames[start:], sink, NEVER if start < len(frames) else self.now_ns))
        return joined(sent) if sent else _NO_FRAMES

    @property
    def cells(self) -> Bound | None:
        """The cells of its loop, for a pump; None: kernels are plain Python."""
        return cells_of(self._run)

    @property
    def clock_cells(self) -> NDArray[np.int64]:
        """The clock's numbers, as int64, and what a pump sees of them is at these :attr:`clock_places`."""
        return np.asarray(self.tables.clock).view("<i8").reshape(-1)

    @property
    def clock_places(self) -> dict[str, int]:
        """Places in :attr:`clock_cells`, by name."""
        names = ("now", "deadline", "urgent", "events", "sent", "fed", "taken")
        places = (self._now, self._due, self._urgent, self._events, self._to_send, self._fed, self._taken)
        return dict(zip(names, places, strict=True))

    def _in_parts(self, frames: Frames, sink: Sink, until_ns: int) -> Frames:
        """Feed a batch as :meth:`process` does, and call :attr:`on_pause` when it is time for it."""
        start, count, sent = 0, len(frames), []
        if not frames.flags.carray:
            frames = copied(frames)
        while True:
            pause = self.pause_ns
            stop = max(start, int(np.searchsorted(frames["t_ns"], pause)))
            paused = stop < count or (until_ns < NEVER and pause <= until_ns)
            target = pause if paused else until_ns
            start = self._run(frames[:stop], start, target)
            self._drain(sink)
            sent.append(self._sent())
            if self.pause_ns != pause or start < stop or (target < NEVER and self._clock[self._now] < target):
                continue
            if not paused:
                return joined(sent)
            self._pause()

    def _pause(self) -> None:
        pause, self.pause_ns = self.pause_ns, NEVER
        self.on_pause(pause)

    def advance(self, t_ns: int, sink: Sink) -> Frames:
        """Let time pass without a frame, so that timers can run; returns what the monitors send.

        Args:
            t_ns: the new time; frames that arrive later with an earlier stamp count as late.
            sink: called with the events.
        """
        sent = self.process(_NO_FRAMES, sink, t_ns)
        while self.pause_ns <= t_ns:
            self._pause()
        return sent

    @property
    def emitted(self) -> list[int]:
        """Identifiers (with EXTENDED) of the messages that monitors send."""
        return [int(can_id) for can_id in self.tables.emits["can_id"]]

    def report(
        self,
        fault: int,
        failed: bool,
        value: float,
        limit: float,
        evidence: Sequence[float],
        sink: Sink,
        *,
        at_once: bool = False,
    ) -> bool:
        """Take a test result that is none of a monitor's, at the time it is; returns whether it counts.

        Args:
            fault: index in :attr:`faults`.
            failed: the verdict.
            value: tested value.
            limit: compared with it, same unit.
            evidence: values by the names of the fault's evidence.
            sink: called with the events.
            at_once: whether it qualifies at once, without debounce.
        """
        clock = self.tables.clock[0]
        row = self.tables.reports[int(clock["reported"])]
        row["fault"], row["result"], row["at_once"] = fault, FAILED if failed else PASSED, at_once
        row["value"], row["limit"] = value, limit
        row["evidence"][:] = 0.0
        row["evidence"][: len(evidence)] = evidence
        self._take_report(sink)
        return int(self.tables.debounces[fault]["last"]) != NOT_TESTED

    def report_not_tested(self, fault: int, sink: Sink) -> None:
        """Take it that a test outside of monitors cannot run now; its counts are held.

        Args:
            fault: index in :attr:`faults`.
            sink: called with the events.
        """
        row = self.tables.reports[int(self.tables.clock[0]["reported"])]
        row["fault"], row["result"] = fault, NOT_TESTED
        self._take_report(sink)

    def _take_report(self, sink: Sink) -> None:
        self.tables.clock[0]["reported"] += 1
        self._run(_NO_FRAMES, 0, NEVER)
        self._drain(sink)

    def heed_passes(self, heeded: bool) -> None:
        """Leave the loop at each verdict (True), or not at first passes of faults that are not there (False)."""
        self.tables.clock[0]["heeds"] = heeded

    def _drain(self, sink: Sink) -> None:
        count = self._clock[self._events]
        if count:
            self._clock[self._events] = 0
            self._clock[self._urgent] = 0
            sink(self.tables.ring[:count])

    def _sent(self) -> Frames:
        """Take the frames that monitors have sent since the last call."""
        clock = self._clock
        first, last = clock[self._taken], clock[self._to_send]
        if first == last:
            return _NO_FRAMES
        frames = copied(self._outbox[first:last])
        frames["rank"] = CYCLIC
        clock[self._taken] = last
        if not self._ranks[clock[self._fed] : last].any():  # else the next pass has them to handle still
            clock[self._to_send] = clock[self._fed] = clock[self._taken] = 0
        return frames

    def value(self, slot: int) -> float:
        """Return the last value of a mailbox slot, NaN before the first."""
        return float(self.tables.mailbox[slot])

    def age_ns(self, slot: int) -> int | None:
        """Return how long ago the message of a mailbox slot was last accepted; None: never, or not any more."""
        arrived_ns = int(self.tables.vectors[self.plan.slot_message[slot]]["arrived_ns"])
        return None if arrived_ns < 0 else self.now_ns - arrived_ns

    def signal(self, reference: SignalRef) -> float:
        """Return the last value of a signal in its unit, NaN before the first."""
        return self.value(self.plan.slot(*reference))

    def fault_detection_counter(self, fault: int) -> int:
        """Return the debounce counter of a fault, -128..127."""
        return int(fault_detection_counter(self.tables.debounces[fault], self.now_ns))

    def fault_detection_counters(self) -> NDArray[np.int8]:
        """Return the debounce counters of all faults, shape (faults,)."""
        counters = np.zeros(len(self.faults), np.int8)
        all_detection_counters(self.tables.debounces, self.now_ns, counters)
        return counters

    def last_result(self, fault: int) -> tuple[float, float, bool] | None:
        """Return value, limit and whether it failed of a fault's latest test result; None: not since the last reset."""
        row = self.tables.debounces[fault]
        result = int(row["last"]) or int(row["verdict"])
        return None if result == NOT_TESTED else (float(row["value"]), float(row["limit"]), result == FAILED)

    def take_buckets(self) -> Buckets:
        """Return what the test results of each fault were since the last call, shape (faults,) of Bucket."""
        self.count_runs()
        return take(self.tables.buckets)

    def count_runs(self) -> None:
        """Bring the buckets up to date: runs of passes are counted with their messages (see engine.checks.runs)."""
        t = self.tables
        count_all_runs(t.checks, t.debounces, t.buckets)

    def reset_debounce(self, faults: Iterable[int] | None = None) -> None:
        """Set debounce counters to zero: all of them, or those of some faults."""
        self.count_runs()
        self.tables.checks["steady"] = 0
        wanted = range(len(self.faults)) if faults is None else list(faults)
        reset_all(self.tables.debounces, np.asarray(wanted, np.int64))
        self.on_reset()

    def set_active(self, fault: int, active: bool) -> None:
        """Say whether a fault is taken to be there before its test has said so (testFailed)."""
        self.tables.debounces[fault]["active"] = active
        self.tables.clock["gate_changes"] += 1

    def hold_results(self, held: bool) -> None:
        """Let no test result count (True), or let them count again."""
        self.tables.clock[0]["held"] = held

    def hear_again(self) -> None:
        """Start the supervision of all messages again: frames of theirs were not given to the engine."""
        checks, now_ns = self.tables.checks, self.now_ns
        watched = checks["timeout_ns"] > 0
        checks["seen"] = checks["filled"] = checks["synced"] = 0
        awaited = checks["coming"] == NOT_YET
        checks["deadline_ns"][watched] = now_ns + np.where(awaited, checks["wake_ns"], checks["timeout_ns"])[watched]
        checks["coming"][~awaited] = COMES
        checks["silent_ns"][watched] = checks["parked_ns"][watched] = 0
        self.tables.health["heard_ns"], self.tables.health["silence"] = now_ns, SPOKEN
        self.tables.health["until"][:, SILENT] = NEVER
        note_all(self.tables)

    def fold_statistics(self, fault: int) -> tuple[int, int]:
        """Return a fault's near misses and greatest detection counter since the last call."""
        return fold(self.tables.debounces[fault])

    def inputs_of(self, fault: int) -> dict[SignalRef, float]:
        """Return what the monitor of a fault sees: the mailbox of its signals."""
        monitor = self._monitor_of.get(fault)
        if monitor is None:
            return {}
        h, names = self.tables.handlers[monitor], self.plan.slot_names
        slots = self.tables.slots[int(h["first_slot"]) :][: int(h["slots"])]
        return {names[slot]: self.value(slot) for slot in slots if slot < len(names)}

    def end_cycles(self) -> None:
        """Take every operation cycle to be over."""
        self.tables.cycles[:] = 0
        self.tables.clock["gate_changes"] += 1
        self.tables.watches["lowest"] = np.inf

    def leave_open(self, cycles: Iterable[int]) -> None:
        """Take operation cycles to be left open by a process that is gone: their signals will say whether they go on.

        Until then no test result of theirs counts: the vehicle may stand since.
        """
        self.tables.cycles[list(cycles)] = LEFT

    def counters(self) -> dict[str, int]:
        """Return the loop's counters by name (frames, decoded, unknown, too_short, ...)."""
        clock = self.tables.clock[0]
        names = clock.dtype.names or ()
        hidden = {"now_ns", "offset_ns", "deadline_ns", "started", "stop", "held", "heeds", "urgent"}
        hidden |= {"events", "sent", "fed", "taken", "parts", "reported", "gate_changes", "stepping"}
        return {name: int(clock[name]) for name in names if name not in hidden}

    def misfits(self, fault: int) -> tuple[int, list[bytes]] | None:
        """Return which check has doubts about its rule, and payloads that do not fit it.

        Args:
            fault: index of the fault; None is returned if it is none of a rule.
        """
        checks = self.tables.checks
        index = self._rules.get(fault)
        if index is None:
            return None
        row = checks[index]
        kept = min(int(row["misfits"]), SAMPLES)
        return index, [row["samples"][k].tobytes()[: int(row["lengths"][k])] for k in range(kept)]

    def rule_of(self, row: int) -> int:
        """Return the fault of the rule of a message's checksum, by the message's row; -1: it has none."""
        checks = self.tables.checks
        return next((fault for fault, k in self._rules.items() if checks[k]["row"] == row), -1)

    def rules(self) -> dict[str, int]:
        """Return the digests of the checksums' rules, by the ids of the faults that doubt them."""
        checks = self.tables.checks
        return {self.faults[fault].id: int(checks[k]["rule"]) for fault, k in self._rules.items()}

    def proven(self) -> list[str]:
        """Return those of :meth:`rules` that are proven to be the senders'."""
        proofs = self.tables.checks["proof"]
        return [self.faults[fault].id for fault, k in self._rules.items() if proofs[k] == PROVEN]

    def take_as_proven(self, rule: str) -> None:
        """Take one of :meth:`rules` to be proven: it was, by an engine before."""
        for fault, k in self._rules.items():
            if self.faults[fault].id == rule:
                self.tables.checks[k]["proof"] = PROVEN

    def freshness(self) -> dict[str, int]:
        """Return the least freshness values that are new, of those of :meth:`rules` that are SecOC's."""
        checks = self.tables.checks
        return {
            self.faults[fault].id: int(checks[k]["fresh"])
            for fault, k in self._rules.items()
            if checks[k]["protection"]["fresh"]["bits"]
        }

    def take_freshness(self, rule: str, least: int) -> None:
        """Take no freshness value of one of :meth:`rules` to be new that is less: an engine before saw more."""
        for fault, k in self._rules.items():
            if self.faults[fault].id == rule and least > int(self.tables.checks[k]["fresh"]):
                self.tables.checks[k]["fresh"] = least

    def error_counters(self, bus: int) -> dict[str, int]:
        """Return the error frames of a bus by class, and the frames lost in its queues."""
        if bus >= len(self.tables.health) - 1:
            return {}
        row = self.tables.health[bus]
        counts = {name: int(count) for name, count in zip(COUNTED, row["counts"], strict=True)}
        return {**counts, "lost": int(row["lost"])}

    def activity(self, bus: int) -> str:
        """Return what a bus does as a whole, one of ACTIVITIES."""
        return ACTIVITIES[int(self.tables.health[bus]["activity"])]

    def bus_lives(self, bus: int) -> bool:
        """Return whether a bus is neither off nor lost, nor silent as a whole, as one that sleeps."""
        row = self.tables.health[bus]
        silent = int(row["silence"]) == WHOLE and int(row["quiet_ns"]) > 0
        return not int(row["bad"]) & (1 << OFF | 1 << GONE) and not silent

    def live_value(self, monitor: str, name: str) -> float:
        """Return a number of a monitor's readout now, NaN if there is none; of one in several parts the first's."""
        for instance, state in zip(self.monitors, self._states, strict=True):
            if instance.name == monitor:
                return float(state[0][name])
        return float("nan")

    def readout(self) -> dict[str, dict[str, float]]:
        """Return what each monitor shows to people: {monitor: {name: value}}."""
        shown: dict[str, dict[str, float]] = {}
        for k, (instance, state) in enumerate(zip(self.monitors, self._states, strict=True)):
            values = {name: np.asarray(state[0][name]).item() for name in instance.monitor.readout}
            before = shown.get(instance.name, {})  # another part of it
            handler = self.tables.handlers[k]
            if handler["sampled"] > 0:
                mine = self.tables.sampled["sampler"][handler["first_sampled"] :][: handler["sampled"]]
                samples = self.tables.samplers["samples"][np.unique(mine)]
                values["apart"], values["overtaken"] = int(samples["apart"].sum()), int(samples["overtaken"].sum())
            values["steps"] = int(self.tables.handlers[k]["steps"]) + before.get("steps", 0)
            values["not_tested"] = int(self.tables.handlers[k]["skipped"]) + before.get("not_tested", 0)
            shown[instance.name] = values
        return shown
