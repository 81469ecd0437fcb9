"""Monitors that misbehave: told, and a code of the gateway's own while there are any that are switched off.

A step that fails is the loop's affair, which steps that monitor no more; a step that did not return was ended by the
watchdog (:mod:`gateway.live.watchdog`), with the process, and is in a file when the next one starts.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from gateway.bus.conditions import name_digest, overtime_frame
from gateway.bus.frames import Frames, empty, joined
from gateway.engine.checks.own_health import OWNER, SWITCHED_OFF
from gateway.engine.core import Engine, Sink
from gateway.engine.events import MISCOUNTED, NO_FAULT, NO_NUMBER, TOO_MANY, TOO_SOON, Event
from gateway.engine.instances import MonitorInstance
from gateway.faults.hung_monitors import HungMonitors
from gateway.monitors.contract import COUNTS_ITSELF, MAX_RESULTS, WAKES_ITSELF, Failure
from gateway_fdi.common.log import get_logger

log = get_logger(__name__)

#: Why a monitor is off whose step did not return, or took too long in the run that was recorded, as the handlers have
#: it; no status of a kernel.
HUNG, LATE = 4095, 4094

_REASONS = {MISCOUNTED: COUNTS_ITSELF}
#: Slips that the loop puts right -> what is said of them, once a monitor.
_PUT_RIGHT = {
    NO_NUMBER: "it reports a value or a threshold that is no number (NaN): that fault is not tested then",
    NO_FAULT: "it reports a number that is none of its faults: that result is dropped",
    TOO_MANY: f"it reports more than {MAX_RESULTS} results in one step: those beyond are lost",
    TOO_SOON: WAKES_ITSELF,
}


class DisabledMonitors:
    """Tells which monitors are off, and which ones slip."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        ids = {slot.id: k for k, slot in enumerate(engine.faults)}
        self._place = ids.get(f"{OWNER}.{SWITCHED_OFF.name}")
        self._reported = -1  # how many were off at the last report; -1: none since the last clear
        self._named = np.zeros(len(engine.monitors), np.uint8)  # slips that have been told
        self.in_python = any(one.monitor.capability(Failure) is not None for one in engine.monitors)
        self.marked = False  # whether a recording tells of steps that took too long
        self._overtimes: list[Frames] = []

    def again(self) -> None:
        """Report again: the reports have been cleared."""
        self._reported = -1

    def keep_off(self, hung: HungMonitors | None) -> list[dict[str, Any]]:
        """Leave off monitors that did not return from a step before; returns the events that tell it.

        Args:
            hung: left by the last process; None: nothing. Of another kernel it says nothing.
        """
        told = []
        for k, instance in enumerate(self._engine.monitors):
            reason = None if hung is None else hung.reason(instance.name, instance.monitor.digest)
            if reason is not None and not self._engine.tables.handlers[k]["off"]:
                self._engine.switch_off(k, HUNG)
                told.append(self._event(k, self._engine.wall_ns(self._engine.now_ns), reason))
        return told

    def on_event(self, event: Event, bus: str) -> dict[str, Any]:
        """Log that a monitor was switched off, and return the event of the JSON contract that tells it."""
        place = event.fault
        why = int(self._engine.tables.handlers[place]["off"])
        failure = self._engine.monitors[place].monitor.failure
        state = self._engine.state_of(place)[0]
        reason = _REASONS.get(why) or failure(state, why)
        python = self._engine.monitors[place].monitor.capability(Failure)
        if python is not None and python.late(state):
            self._overtimes.append(overtime_frame(event.t_ns, self._engine.monitors[place].name))
        return self._event(place, event.t_ns, f"its step failed: {reason}", bus)

    def take_overtimes(self) -> Frames:
        """Return frames for recordings, of monitors whose step took too long since the last call."""
        found, self._overtimes = joined([empty(0), *self._overtimes]), []
        return found

    def stop(self, frame: np.void) -> list[dict[str, Any]]:
        """Step a monitor no more whose step took too long in a recorded run; returns the events that tell it.

        Args:
            frame: of the recording; one of a monitor that is not there says nothing.
        """
        digest, told = bytes(frame["data"][1:8]), []
        for k, instance in enumerate(self._engine.monitors):
            if name_digest(instance.name) == digest and not self._engine.tables.handlers[k]["off"]:
                self._engine.switch_off(k, LATE)
                reason = "its step took too long in the run that was recorded"
                told.append(self._event(k, self._engine.wall_ns(int(frame["t_ns"])), reason))
        return told

    def _event(self, place: int, t_ns: int, reason: str, bus: str = "") -> dict[str, Any]:
        instance = self._engine.monitors[place]
        told = {**_who(instance), "reason": reason}
        log.error("a monitor is switched off; its faults are not tested, all others go on", **told)
        return {"event": "monitor_off", "t_ns": t_ns, "bus": bus, **told}

    def report(self, sink: Sink) -> None:
        """Report the gateway's own fault, and name slips, if that is news."""
        count = 0
        if self._engine.monitors:
            self._name_slips()
            count = int(np.count_nonzero(self._engine.tables.handlers["off"]))
        if self._place is None or count == self._reported:
            return
        self._reported = count
        self._engine.report(self._place, count > 0, float(count), 0.0, (count,), sink)

    def _name_slips(self) -> None:
        """Log what the loop has put right, a line for each monitor from outside and kind of slip."""
        slips = self._engine.tables.handlers["slips"]
        for k in np.flatnonzero(slips & ~self._named):
            new, instance = int(slips[k] & ~self._named[k]), self._engine.monitors[k]
            self._named[k] |= new
            for slip, text in _PUT_RIGHT.items():
                if new & slip and instance.monitor.outside:
                    log.warning("a monitor slips; it goes on", **_who(instance), reason=text)


def _who(instance: MonitorInstance) -> dict[str, str]:
    """Return which monitor it is, for people."""
    return {"monitor": instance.name, "type": instance.monitor.type, "file": str(instance.monitor.file)}
