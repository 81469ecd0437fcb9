"""Inputs of the monitors: frames, and time.

Batches are cut where the usage meter looks. A tester may have switched reception off (ISO 14229-1, 0x28).
"""

from __future__ import annotations

import numpy as np

from gateway.bus.conditions import are_steps
from gateway.bus.frames import FRAME, OWN, Frames, chosen, joined
from gateway.common.times import NEVER
from gateway.engine.core import Engine, Sink
from gateway.runtime.controls import Controls
from gateway.runtime.usage_meter import UsageMeter
from gateway.signals.payloads import among


class InputStage:
    """Gives frames and time to the engine.

    Args:
        engine: steps the monitors.
        controls: say whether reception is on.
        meter: looks at fixed times.
        judged: mailbox slots of signals that conditions of access need, even while reception is off.
        sink: takes the engine's events.
    """

    def __init__(self, engine: Engine, controls: Controls, meter: UsageMeter, judged: list[int], sink: Sink) -> None:
        self._engine, self._controls, self._meter = engine, controls, meter
        self._judged, self._sink = judged, sink
        self._emitted = engine.emitted

    def without_own(self, frames: Frames) -> Frames:
        """Return a recording's frames without those that our monitors had sent: they send them again."""
        if not self._emitted:
            return frames
        own = frames["flags"] & OWN != 0
        if not own.any():
            return frames
        return chosen(frames, ~(own & np.isin(frames["can_id"], self._emitted)))

    def process(self, frames: Frames) -> Frames:
        """Take frames in order of time; returns what the monitors send."""
        if not self._meter.measures:
            return self._process_piece(frames)
        sent: list[Frames] = []
        for piece, look_ns in self._meter.pieces(frames):
            if look_ns is None:
                sent.append(self._process_piece(piece))
            elif self._controls.receive:  # frames and time until the look in one pass of the loop
                sent.append(self._engine.process(piece, self._sink, look_ns))
                self._meter.look()
            else:
                sent += [self._process_piece(piece), self._look(look_ns)]
        return joined(sent)

    def deliver(self) -> Frames:
        """Take the events that wait where a pump has left; returns what the monitors have sent."""
        return self._engine.deliver(self._sink)

    def resume(self, frames: Frames, start: int) -> Frames:
        """Go on with a batch that a pump has begun; returns what the monitors send."""
        return self._engine.resume(frames, start, self._sink)

    @property
    def before_ns(self) -> int | None:
        """Time from which on frames are to come by :meth:`process`; None: all are, reception is switched off."""
        if not self._controls.receive:
            return None
        return min(self._engine.pause_ns, self._meter.next_ns + 1 if self._meter.measures else NEVER)

    def hear(self, frames: Frames) -> None:
        """Note that a pump has fed frames."""
        if self._meter.measures:
            self._meter.hear(int(frames["t_ns"].max()))

    def _look(self, t_ns: int) -> Frames:
        """Let time pass until a look of the meter."""
        sent = self._engine.advance(t_ns, self._sink)
        self._meter.look()
        return sent

    def _process_piece(self, frames: Frames) -> Frames:
        if self._controls.receive or not len(frames):
            return self._engine.process(frames, self._sink)
        # A tester has switched reception off: of the frames only their time counts, and where the clock was set.
        # And signals for conditions of access: a gateway that is blinded because the vehicle stands must see that it
        # moves.
        needed = are_steps(frames) | among(frames, self._engine.plan, self._judged)
        sent = self._engine.process(chosen(frames, needed), self._sink)
        more = self._engine.advance(int(frames["t_ns"].max()), self._sink)
        return joined([sent, more])

    def advance(self, t_ns: int) -> Frames:
        """Let time pass without frames; returns what the monitors send."""
        looks = self._meter.times(t_ns) if self._meter.measures else ()
        sent = [self._look(look_ns) for look_ns in looks]
        return joined([*sent, self._engine.advance(t_ns, self._sink)])


def refuse_unless_frames(frames: object) -> None:
    """Refuse what is no batch of frames.

    Raises:
        TypeError: these are no frames; it says what they are.
    """
    if not isinstance(frames, np.ndarray) or frames.dtype != FRAME or frames.ndim != 1:
        kind = type(frames).__name__
        if isinstance(frames, np.ndarray):
            kind = f"array of {frames.dtype} and shape {frames.shape}"
        text = "frames are an array of gateway.bus.frames.FRAME, shape (n,), which put() and put_message() there fill"
        raise TypeError(f"{text}; this is: {kind}")
