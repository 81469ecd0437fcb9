"""Measures by signals how the vehicle is used: distance, engine running time, and the ratios' denominator.

It looks at fixed times, multiples of a tenth of a second of the engine's clock, so that a replay counts as the live run
did, even with other batches: :meth:`UsageMeter.pieces` cuts batches at these times.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from gateway.bus.frames import Frames
from gateway.faults.memory import FaultMemory
from gateway.faults.usage import UsageParams
from gateway.runtime.controls import Controls

#: Time between two looks [ns of the engine's clock].
LOOK_NS = 100_000_000
_LOOK_S = LOOK_NS / 1e9
#: Distance between two looks that is believed: an odometer that goes on by more was changed, or its frame is wrong [m].
MOST_M = 1000.0


class UsageMeter:
    """Adds up how the vehicle is used, and keeps it with the fault memory.

    Args:
        params: which signals tell it; None: none does, and nothing is to be called.
        memory: the fault memory.
        controls: gives signals, and judges conditions.
        stale_ns: a signal that is older tells nothing any more.
    """

    def __init__(self, params: UsageParams | None, memory: FaultMemory, controls: Controls, stale_ns: int) -> None:
        self._params, self._memory, self._controls = params, memory, controls
        self._quiet_ns = stale_ns + LOOK_NS
        self._next_ns = 0
        self._heard_ns = -2 * self._quiet_ns  # nothing yet: the first frame, whenever it comes, ends a silence
        self._odometer_km = math.nan
        self._cycle: int | None = None
        self._met_s: list[float] = []

    @property
    def measures(self) -> bool:
        """Whether there is anything to measure."""
        return self._params is not None

    @property
    def next_ns(self) -> int:
        """Time of the next look [ns]."""
        return self._next_ns

    def hear(self, t_ns: int) -> None:
        """Note that frames came until a time, none after the next look."""
        self._heard_ns = t_ns

    def pieces(self, frames: Frames) -> Iterator[tuple[Frames, int | None]]:
        """Cut a batch at the times of the looks; gives each piece with the time of the look after it, None: none."""
        times = np.maximum.accumulate(frames["t_ns"]) if len(frames) else frames["t_ns"]
        begun = 0
        while begun < len(frames):
            self._skip_silence(int(times[begun]))
            ended = int(np.searchsorted(times, self._next_ns, side="right"))
            if ended > begun:
                self._heard_ns = int(times[ended - 1])
            look = ended < len(frames)
            yield frames[begun:ended], self._next_ns if look else None
            begun = ended
            if look:
                self._next_ns += LOOK_NS

    def times(self, until_ns: int) -> Iterator[int]:
        """Give the times of the looks until a time, without frames."""
        self._skip_silence(until_ns)
        while self._next_ns <= until_ns:
            yield self._next_ns
            self._next_ns += LOOK_NS
            self._skip_silence(until_ns)

    def _skip_silence(self, until_ns: int) -> None:
        """Leave out looks of a silence: when the last signals are too old, nothing is added any more."""
        if self._next_ns > self._heard_ns + self._quiet_ns:
            self._next_ns = max(self._next_ns, -(-until_ns // LOOK_NS) * LOOK_NS)

    def look(self) -> None:
        """Add what was driven in the tenth of a second before now."""
        params = self._params
        assert params is not None, "nothing is measured"
        running = bool(params.running) and self._controls.meets(params.running)
        metres = self._metres(params)
        if running or metres:
            lit = self._memory.is_mil_on_now()
            self._memory.usage.add(metres, _LOOK_S if running else 0.0, lit=lit)
        if params.denominator:
            self._judge(params)

    def _metres(self, params: UsageParams) -> float:
        """Return the distance driven since the last look."""
        if params.speed is not None:
            speed = self._controls.fresh_value(params.speed)
            return speed / 3.6 * _LOOK_S if speed > 0 else 0.0
        if params.odometer is None:
            return 0.0
        now_km = self._controls.fresh_value(params.odometer)
        if math.isnan(now_km):
            return 0.0
        driven = (now_km - self._odometer_km) * 1000.0
        self._odometer_km = now_km
        return driven if 0 < driven <= MOST_M else 0.0

    def _judge(self, params: UsageParams) -> None:
        """Count for how long each condition of the general denominator was met in this operation cycle."""
        number = self._memory.cycle_number(params.cycle)
        if number != self._cycle:
            self._cycle, self._met_s = number, [0.0] * len(params.denominator)
        met = True
        for k, condition in enumerate(params.denominator):
            now = self._controls.meets((condition,))
            if now:
                self._met_s[k] += _LOOK_S
            elif condition.at_a_stretch and self._met_s[k] < condition.seconds:
                self._met_s[k] = 0.0
            # Sums of tenths are not exact; a condition without a time is met when it was seen once.
            met = met and self._met_s[k] >= max(condition.seconds, _LOOK_S) - _LOOK_S / 2
        if met:
            self._memory.performance.conditions_met()

    def stop(self) -> None:
        """Have all written that was counted."""
        self._memory.usage.flush()

    def succeed(self, old: UsageMeter) -> None:
        """Go on where another one stops; conditions are judged again if they are others."""
        self._next_ns, self._heard_ns = old._next_ns, old._heard_ns
        if self._params is not None and self._params == old._params:
            self._odometer_km, self._cycle, self._met_s = old._odometer_km, old._cycle, old._met_s
