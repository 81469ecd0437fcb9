"""Recording without monitoring: the live loop without a gateway."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from gateway.bus.conditions import are_steps, step_ns_of
from gateway.bus.frames import Frames, empty
from gateway.faults.journal import NO_JOURNAL
from gateway.runtime.event_json import clock_event
from gateway.runtime.fast_path_conditions import FastPathConditions


class Nobody:
    """Takes the frames that a gateway would take, and has nothing to say but that the clock was set."""

    engine = None

    def __init__(self, report: Callable[[dict[str, Any]], None] = lambda _: None) -> None:
        self._report = report
        self._offset_ns = 0
        self.frames = 0

    def feed(self, frames: Frames) -> Frames:
        """Count frames."""
        self.frames += len(frames)
        for frame in frames[np.flatnonzero(are_steps(frames))]:
            step_ns = step_ns_of(frame)
            self._offset_ns += step_ns
            self._report(clock_event(int(frame["t_ns"]) + self._offset_ns, step_ns / 1e9))
        return empty(0)

    def advance(self, t_ns: int) -> Frames:
        """Let time pass."""
        return empty(0)

    def poll(self, t_ns: int) -> Frames:
        """Let time pass."""
        return empty(0)

    def promise(self, frames: Frames, t_ns: int) -> Frames:
        """Promise nothing: no tester waits."""
        return empty(0)

    def finish(self, t_ns: int) -> Frames:
        """Put nothing down."""
        return empty(0)

    def quiet(self) -> FastPathConditions:
        """Want all frames: there is no engine that a pump could feed."""
        return FastPathConditions()

    def take_overtimes(self) -> Frames:
        """Return none: it steps no monitor."""
        return empty(0)

    def took(self, frames: Frames) -> None:
        """Be asked for nothing: no pump feeds it."""

    foreseen, journal = None, NO_JOURNAL

    def deliver(self, gone: Frames) -> Frames:
        """There is none."""
        return empty(0)

    def resume(self, frames: Frames, start: int) -> Frames:
        """Be asked for nothing: no pump feeds it."""
        return empty(0)

    def identifiers_on(self, bus: int) -> list[int] | None:
        """Listen to all."""
        return None

    def serve_requests(self) -> None:
        """Do nothing: there are no requests."""

    def note_buses(self, states: Sequence[Mapping[str, Any]]) -> None:
        """Do nothing: there are no readers."""
