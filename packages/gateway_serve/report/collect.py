"""Data of a report, collected while frames go through a gateway."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from gateway.bus.frames import Frames, empty
from gateway.bus.traffic import Traffic
from gateway.engine.buckets import Bucket, Buckets, merge
from gateway.runtime.app import Gateway

#: Finest column [ns], and how many there are at most: beyond, two become one.
STEP_NS, MOST_COLUMNS = 50_000_000, 800
#: Times around a failure with fine columns [ns]: before, and after.
BEFORE_NS, AFTER_NS = 3_000_000_000, 2_000_000_000
#: Failures with fine columns, and events that are kept.
MOST_WINDOWS, MOST_EVENTS = 16, 5000


class Window:
    """Fine columns around one failure."""

    def __init__(self, fault: str, t_ns: int, columns: dict[int, np.void]) -> None:
        self.fault, self.t_ns, self.columns = fault, t_ns, columns


class Collector:
    """A gateway that is fed as another one, and says afterwards what happened.

    Args:
        gateway: not started yet.

    Attributes:
        events: of the JSON contract, the first ones; ``left_out``: how many more there were.
        width_ns: of the columns.
        columns: number of a column -> buckets of all faults.
        windows: fine columns around failures.
        loads: number of a column -> bits and frames of each bus, shape (buses, 3): nominal, data, frames.
        total: buckets of the whole run.
        first_ns: zero of the times that people see: the start of the run, which is a log's first frame.
        last_ns: of the frames, by the wall clock.
    """

    def __init__(self, gateway: Gateway) -> None:
        self._gateway = gateway
        self.without_own = gateway.without_own
        self.events: list[dict[str, Any]] = []
        self.left_out = 0
        self.width_ns = STEP_NS
        self.columns: dict[int, Buckets] = {}
        self.loads: dict[int, Any] = {}
        self.windows: list[Window] = []
        self.total: Buckets = np.zeros(len(gateway.engine.faults), Bucket.dtype)
        self.first_ns = self.last_ns = 0
        self._traffic = Traffic(len(gateway.config.bus))
        self._bits = self._counted()
        self._fine: dict[int, Buckets] = {}  # number of a fine column -> buckets
        self._index = {definition.id: k for k, definition in enumerate(gateway.catalogue)}
        self._open: list[Window] = []
        self._failing: set[str] = set()
        gateway.listen(self._on_event)

    def start(self, t_ns: int) -> None:
        """Start an operation cycle."""
        self.first_ns = self.last_ns = t_ns
        self._gateway.start(t_ns)

    def feed(self, frames: Frames) -> Frames:
        """Feed frames, column by column."""
        sent = [empty(0)]
        for piece in _pieces(frames):
            self._traffic.write(piece)
            sent.append(self._gateway.feed(piece))
            self._take(int(piece["t_ns"][-1]))
        return np.concatenate(sent)

    def advance(self, t_ns: int) -> Frames:
        """Let time pass."""
        sent = self._gateway.advance(t_ns)
        self._take(t_ns)
        return sent

    def stop(self, t_ns: int, *, complete: bool = True) -> None:
        """End, and with it the operation cycle if that is complete."""
        self._gateway.stop(t_ns, complete=complete)
        self._take(t_ns)
        while self._open:
            self._close(self._open[0])

    def _counted(self) -> Any:
        loads = self._traffic.loads
        return np.stack([np.asarray(loads[name]) for name in ("nominal_bits", "data_bits", "frames")], axis=1).copy()

    def _take(self, t_ns: int) -> None:
        wall_ns = self._gateway.engine.wall_ns(t_ns)
        self.last_ns = max(self.last_ns, wall_ns)
        bits = self._counted()
        place = wall_ns // self.width_ns
        self.loads[place] = self.loads.get(place, 0) + bits - self._bits
        self._bits = bits
        buckets = self._gateway.engine.take_buckets()
        told = np.flatnonzero(buckets["count"])
        if not len(told):
            return
        merge(self.total, buckets)
        for fine in np.unique(buckets["last_ns"][told] // STEP_NS):
            part = buckets.copy()
            part["count"][(part["last_ns"] // STEP_NS) != fine] = 0
            _add(self._fine, int(fine), part)
            _add(self.columns, int(fine) * STEP_NS // self.width_ns, part)
        while len(self.columns) > MOST_COLUMNS:
            self._widen()
        self._forget(wall_ns)

    def _widen(self) -> None:
        """Make one column of two."""
        self.width_ns *= 2
        columns, loads = self.columns, self.loads
        self.columns, self.loads = {}, {}
        for place in sorted(columns):
            _add(self.columns, place // 2, columns[place])
        for place in sorted(loads):
            self.loads[place // 2] = self.loads.get(place // 2, 0) + loads[place]

    def _forget(self, wall_ns: int) -> None:
        for window in [w for w in self._open if wall_ns > w.t_ns + AFTER_NS]:
            self._close(window)
        keep = min([wall_ns, *(w.t_ns for w in self._open)]) - BEFORE_NS - STEP_NS
        for place in [place for place in self._fine if place * STEP_NS < keep]:
            del self._fine[place]

    def _close(self, window: Window) -> None:
        self._open.remove(window)
        fault = self._index[window.fault]
        first, last = (window.t_ns - BEFORE_NS) // STEP_NS, (window.t_ns + AFTER_NS) // STEP_NS
        for place, buckets in self._fine.items():
            if first <= place <= last and buckets[fault]["numbers"] > 0 and buckets[fault]["count"] > 0:
                window.columns[place] = buckets[fault].copy()

    def _fails(self, event: dict[str, Any]) -> bool:
        """Return whether an event is of a fault that has come, and not of one that is only confirmed later."""
        if event["event"] != "dtc":
            return False
        failing = event["fault"] in self._failing
        (self._failing.add if event["status"] & 1 else self._failing.discard)(event["fault"])
        return bool(event["status"] & 1) and not failing

    def _on_event(self, event: dict[str, Any]) -> None:
        if self._fails(event) and len(self.windows) < MOST_WINDOWS:
            window = Window(event["fault"], event["t_ns"], {})
            self.windows.append(window)
            self._open.append(window)
        if len(self.events) < MOST_EVENTS:
            self.events.append(event)
        else:
            self.left_out += 1


def _add(columns: dict[int, Buckets], place: int, buckets: Buckets) -> None:
    if place in columns:
        merge(columns[place], buckets)
    else:
        columns[place] = buckets.copy()


def _pieces(frames: Frames) -> Iterator[Frames]:
    """Yield the frames of one fine column after the other."""
    if not len(frames):
        return
    cuts = np.flatnonzero(np.diff(frames["t_ns"] // STEP_NS)) + 1
    begin = 0
    for end in [*cuts.tolist(), len(frames)]:
        yield frames[begin:end]
        begin = end
