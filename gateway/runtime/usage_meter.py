"""Measures by signals how the vehicle is used: distance, engine running time, and what the ratios' denominator asks."""

from __future__ import annotations

import math

from gateway.faults.memory import FaultMemory
from gateway.faults.mil import is_mil_on
from gateway.faults.usage import UsageParams
from gateway.runtime.controls import Controls

#: It looks so often [ns of the engine's time].
LOOK_NS = 100_000_000
#: Time between two looks that is believed: longer ones are silence, of which nobody knows what it was [s].
MOST_S = 1.0
#: Distance between two looks that is believed: an odometer that goes on by more was changed, or its frame is wrong [m].
MOST_M = 1000.0


class UsageMeter:
    """Adds up how the vehicle is used, and keeps it with the fault memory.

    Args:
        params: which signals tell it; None: nobody does.
        memory: the fault memory.
        controls: gives signals, and judges conditions.
    """

    def __init__(self, params: UsageParams | None, memory: FaultMemory, controls: Controls) -> None:
        self._params, self._memory, self._controls = params, memory, controls
        self._last_ns: int | None = None
        self._odometer_km = math.nan
        self._cycle: int | None = None
        self._met_s: list[float] = []

    def on_time(self, now_ns: int) -> None:
        """Look, if it is time.

        Args:
            now_ns: now, of the engine's clock.
        """
        if self._params is None or (self._last_ns is not None and 0 <= now_ns - self._last_ns < LOOK_NS):
            return
        passed_s = 0.0 if self._last_ns is None else max(now_ns - self._last_ns, 0) / 1e9
        self._last_ns = now_ns
        passed_s = passed_s if passed_s <= MOST_S else 0.0
        running = bool(self._params.running) and self._controls.meets(self._params.running)
        metres = self._metres(self._params, passed_s)
        if running or metres:
            self._memory.usage.add(metres, passed_s if running else 0.0, lit=is_mil_on(self._memory))
        if self._params.denominator:
            self._judge(self._params, passed_s)

    def _metres(self, params: UsageParams, passed_s: float) -> float:
        """Return the distance driven since the last look."""
        if params.speed is not None:
            speed = self._controls.fresh_value(params.speed)
            return speed / 3.6 * passed_s if speed > 0 else 0.0
        if params.odometer is None:
            return 0.0
        now_km = self._controls.fresh_value(params.odometer)
        if math.isnan(now_km):
            return 0.0
        driven = (now_km - self._odometer_km) * 1000.0
        self._odometer_km = now_km
        return driven if 0 < driven <= MOST_M else 0.0

    def _judge(self, params: UsageParams, passed_s: float) -> None:
        """Count for how long each condition of the general denominator was met in this operation cycle."""
        number = self._memory.cycle_number(params.cycle)
        if number != self._cycle:
            self._cycle, self._met_s = number, [-1.0] * len(params.denominator)
        for k, condition in enumerate(params.denominator):
            if self._controls.meets((condition,)):
                self._met_s[k] = max(self._met_s[k], 0.0) + (passed_s if self._met_s[k] >= 0 else 0.0)
            elif condition.at_a_stretch and self._met_s[k] < condition.seconds:
                self._met_s[k] = -1.0
        if all(met >= condition.seconds for met, condition in zip(self._met_s, params.denominator, strict=True)):
            self._memory.performance.conditions_met()

    def stop(self) -> None:
        """Have all written that was counted."""
        self._memory.usage.flush()

    def succeed(self, old: UsageMeter) -> None:
        """Go on where another one stops; what it judged is judged anew if the conditions are others."""
        self._last_ns, self._odometer_km = old._last_ns, old._odometer_km
        if self._params is not None and old._params is not None and self._params == old._params:
            self._cycle, self._met_s = old._cycle, old._met_s
