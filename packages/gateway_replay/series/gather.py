"""Gathers series beside a gateway that is fed a log: a reader of what each step leaves, one frame or timer at a time.

A row is written where something has changed: value, limit or result of a fault's test; a quantity of a monitor that
has stepped; a signal. Between two rows a series keeps the first one's value. Debounce is not in it: a fault's
result is what its test said last.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from gateway.bus.frames import Frames, joined
from gateway.faults.status import Status
from gateway.monitors.contract import FAILED, PASSED, Quantities
from gateway.runtime.app import Gateway
from gateway_replay.replay import FrameConsumer
from gateway_replay.series.rows import DTC, FAULT, GROUP, QUANTITY, RESULTS, SIGNAL, Rows, Series, Sink

_NOT_TESTED, _PASSED, _FAILED, _SET, _HEALED = (
    RESULTS.index(x) for x in ("not tested", "passed", "failed", "set", "healed")
)


class _Watch:
    """Numbers of one kind, and their last values."""

    def __init__(
        self, first: int, count: int, read: Callable[[], NDArray[np.float64]], limits: Sequence[float]
    ) -> None:
        self.first, self.read = first, read
        self.limits = np.asarray(limits, np.float64)
        self.last = np.full(count, math.nan)

    def changed(self) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Return the places that are not what they were, and all values."""
        now = self.read()
        differ = (now != self.last) & ~(np.isnan(now) & np.isnan(self.last))
        self.last = now
        return np.flatnonzero(differ), now


class Fed(FrameConsumer, Protocol):
    """The gateway, or what feeds it and lets its time pass."""

    def advance(self, t_ns: int) -> Frames:
        """Let time pass; returns the frames to send."""


class Gatherer:
    """A gateway that is fed a log, and the values that its monitors compute.

    Args:
        gateway: not started yet.
        sinks: take the rows.
        signals: name -> slot of the mailbox, of the signals that are wanted.
        fed: feeds the gateway, if something else wants to see its frames; None: nothing.

    Attributes:
        rows: that were handed on.
    """

    def __init__(
        self,
        gateway: Gateway,
        sinks: Sequence[Sink],
        signals: Mapping[str, int] | None = None,
        *,
        fed: Fed | None = None,
    ) -> None:
        self._fed: Fed = gateway if fed is None else fed
        self._engine, self._sinks = gateway.engine, tuple(sinks)
        self._series: list[Series] = []
        self._held = self.rows = 0
        self._t = np.zeros(GROUP, np.int64)
        self._which, self._result = np.zeros(GROUP, np.int32), np.zeros(GROUP, np.int8)
        self._value, self._limit = np.zeros(GROUP), np.zeros(GROUP)
        self._codes: dict[tuple[str, str], int] = {}
        self._steps = self._engine.tables.handlers["steps"].copy()
        self._faults()
        self._watches = [self._quantities(k) for k in range(len(self._engine.monitors))]
        self._signals = self._of_signals(signals or {})
        gateway.listen(self._on_event)
        self.stop, self.without_own = self._fed.stop, self._fed.without_own

    # Watched values ---------------------------------------------------------------------------------------------------

    def _faults(self) -> None:
        self._first_fault = len(self._series)
        for slot in self._engine.faults:
            monitor, _, name = slot.id.rpartition(".")
            self._series.append(Series(monitor, FAULT, name))
        rows = self._engine.tables.debounces
        self._debounces = [rows[name] for name in ("value", "limit", "last")]
        self._before = [column.copy() for column in self._debounces]

    def _quantities(self, k: int) -> _Watch | None:
        """Watch the state that a monitor shows, and the quantities that it computes."""
        instance, state = self._engine.monitors[k], self._engine.state_of(k)
        monitor = instance.monitor
        own = monitor.capability(Quantities)
        told = () if own is None else own.of(instance.params)
        names, first = monitor.readout, len(self._series)
        part = f"{instance.part}." if instance.part else ""
        self._series += [Series(instance.name, QUANTITY, part + q.name, q.unit) for q in told]
        self._series += [Series(instance.name, QUANTITY, part + name) for name in names]
        if len(self._series) == first:
            return None

        def read() -> NDArray[np.float64]:
            values = [] if own is None else list(own.values(state[0]))[: len(told)]
            return np.array([*values, *(float(state[0][name]) for name in names)], np.float64)

        return _Watch(first, len(told) + len(names), read, [*(q.limit for q in told), *[math.nan] * len(names)])

    def _of_signals(self, signals: Mapping[str, int]) -> _Watch:
        first, slots = len(self._series), np.array(list(signals.values()), np.int64)
        self._series += [Series("", SIGNAL, name) for name in signals]
        mailbox = self._engine.tables.mailbox
        return _Watch(first, len(slots), lambda: np.asarray(mailbox[slots]), [math.nan] * len(slots))

    # Inputs -----------------------------------------------------------------------------------------------------------

    def start(self, t_ns: int) -> None:
        """Start an operation cycle."""
        self._fed.start(t_ns)

    def feed(self, frames: Frames) -> Frames:
        """Take a batch of frames, one by one and each timer by itself; returns the frames to send."""
        sent: list[Frames] = []
        for k in range(len(frames)):
            sent += self._until(int(frames[k]["t_ns"]))
            sent.append(self._fed.feed(frames[k : k + 1]))
            self._look()
        return joined(sent)

    def advance(self, t_ns: int) -> Frames:
        """Let time pass, each timer by itself; returns the frames to send."""
        sent = [*self._until(t_ns), self._fed.advance(t_ns)]
        self._look()
        return joined(sent)

    def _until(self, t_ns: int) -> Iterator[Frames]:
        """Have each timer that is due by then take its turn."""
        clock = self._engine.tables.clock[0]
        due = int(clock["deadline_ns"])
        while clock["started"] and due <= t_ns:
            yield self._fed.advance(due)
            self._look()
            before, due = due, int(clock["deadline_ns"])
            if due <= before:
                break

    def close(self) -> None:
        """Hand on what is left."""
        self._flush()
        for sink in self._sinks:
            sink.close()

    def _look(self) -> None:
        """Note what has changed."""
        t_ns = self._engine.wall_ns(self._engine.now_ns)
        value, limit, last = self._debounces
        old_value, old_limit, old_last = self._before
        differ = (value != old_value) | (limit != old_limit) | (last != old_last)
        if differ.any():
            at = np.flatnonzero(differ)
            result = np.full(len(at), _NOT_TESTED, np.int8)
            result[last[at] == PASSED], result[last[at] == FAILED] = _PASSED, _FAILED
            self._put(t_ns, self._first_fault + at, value[at], limit[at], result)
            for old, now in zip(self._before, self._debounces, strict=True):
                old[at] = now[at]
        steps = self._engine.tables.handlers["steps"]
        for k in np.flatnonzero(steps != self._steps):
            self._note(t_ns, self._watches[k])
        self._steps[:] = steps
        self._note(t_ns, self._signals)

    def _note(self, t_ns: int, watch: _Watch | None) -> None:
        if watch is None:
            return
        at, now = watch.changed()
        if len(at):
            self._put(t_ns, watch.first + at, now[at], watch.limits[at], 0)

    def _on_event(self, event: Mapping[str, Any]) -> None:
        if event["event"] != "dtc":
            return
        monitor, _, name = event["fault"].rpartition(".")
        key = (event["fault"], event["dtc"])
        if key not in self._codes:
            self._codes[key] = len(self._series)
            self._series.append(Series(monitor, DTC, f"{event['dtc']} {name}"))
        failed = bool(event["status"] & Status.TEST_FAILED)
        at, value = np.array([self._codes[key]]), np.array([float(event["status"])])
        self._put(int(event["t_ns"]), at, value, np.array([math.nan]), _SET if failed else _HEALED)

    def _put(
        self, t_ns: int, which: NDArray[Any], value: NDArray[Any], limit: NDArray[Any], result: NDArray[np.int8] | int
    ) -> None:
        if self._held + len(which) > GROUP:
            self._flush()
        here = slice(self._held, self._held + len(which))
        self._t[here], self._which[here], self._result[here] = t_ns, which, result
        self._value[here], self._limit[here] = value, limit
        self._held += len(which)

    def _flush(self) -> None:
        if self._held:
            # An event is told after the results of its frame, with the time of them.
            k = np.argsort(self._t[: self._held], kind="stable")
            rows = Rows(self._t[k], self._which[k], self._value[k], self._limit[k], self._result[k])
            for sink in self._sinks:
                sink.write(rows, self._series)
        self.rows += self._held
        self._held = 0

    @property
    def count(self) -> int:
        """How many series there are."""
        return len(self._series)
