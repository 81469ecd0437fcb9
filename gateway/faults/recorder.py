"""Frames around a failure: those before and after it, kept with the fault.

Driven by the engine's time, so that a replay keeps the same frames as the live run; they have the stamps of the wall
clock, and frames that tell where that was set. Bounded three ways: frames of one recording, recordings of one fault,
and how soon after one the same fault may have another.
"""

from __future__ import annotations

import zlib
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from gateway.bus.candump import format_frame
from gateway.bus.frames import RAW, Frames, chosen, copied, empty, joined
from gateway.bus.timeline import spans
from gateway.common.times import NEVER
from gateway.faults.records import Recording
from gateway_fdi.common.tomlfile import StrictModel


class RecorderParams(StrictModel):
    """Settings of the recordings around a failure."""

    before_ms: float = Field(1000.0, ge=0, le=6e4, allow_inf_nan=False, description="time before it [ms]")
    after_ms: float = Field(500.0, ge=0, le=6e4, allow_inf_nan=False, description="time after it [ms]")
    most_frames: int = Field(
        4000,
        ge=1,
        le=200_000,
        description="frames of one recording; those nearest the failure stay",
    )
    most_per_fault: int = Field(3, ge=1, le=100, description="recordings kept of one fault")
    cooldown_s: float = Field(
        60.0,
        ge=0,
        le=1e6,
        allow_inf_nan=False,
        description="least time between two of one fault [s]",
    )


@dataclass
class _Trigger:
    fault: str
    t_ns: int
    due_ns: int
    wall_ns: int


@dataclass(frozen=True)
class _Chunk:
    """Frames one after the other; ``offset_ns`` is what the wall clock is ahead before the first."""

    latest_ns: int
    offset_ns: int
    frames: Frames


#: Frames of a chunk that is filled batch by batch: a batch of one frame costs no array of its own.
CHUNK = 512


class Recorder:
    """Keeps the latest frames, and cuts recordings out of them.

    Args:
        params: settings.
        channels: names of the buses, by index.
        lasting: whether its batches are not written to later; else it keeps copies.
    """

    def __init__(self, params: RecorderParams, channels: tuple[str, ...], *, lasting: bool = False) -> None:
        self._params = params
        self._lasting = lasting
        self._channels = channels
        self._before_ns = round(params.before_ms * 1e6)
        self._after_ns = round(params.after_ms * 1e6)
        self._chunks: deque[_Chunk] = deque()
        self._filling, self._filled, self._offset_ns = empty(CHUNK), 0, 0
        self._raw = self._filling.view(RAW)
        self._grown = False  # whether there is a chunk more since the last look for what may go
        self._kept = 0
        self._gone: deque[NDArray[np.int64]] = deque()  # stamps of frames given up in a flood
        self._triggers: list[_Trigger] = []
        self._last_ns: dict[str, int] = {}
        self.refused = 0

    def on_frames(self, frames: Frames, offset_ns: int = 0) -> None:
        """Take a batch before the engine gets it.

        Args:
            frames: of the engine's time.
            offset_ns: time that the wall clock is ahead of it before this batch [ns].
        """
        count = len(frames)
        if not count:
            return
        # Not at each batch: up to twice of what can be asked for is kept. A failure in this batch may ask for
        # what was before it, so that only what came before is given up.
        full = self._kept >= 2 * self._params.most_frames
        times = frames["t_ns"].copy() if count > CHUNK else frames["t_ns"]  # looked at twice, and far apart
        if full or self._grown:
            self._grown = False
            first = int(times.min())
            window = 2 * self._before_ns + self._after_ns
            if full or self._chunks[0].latest_ns < first - window:
                self._trim(first)
                self._grown = False  # after a long pause no chunk is left
        if self._filled + count > CHUNK:
            self._close()
        if count > CHUNK:
            self._keep(frames if self._lasting else copied(frames), offset_ns, int(times.max()))
        else:
            if not self._filled:
                self._offset_ns = offset_ns
            self._raw[self._filled : self._filled + count] = frames.view(RAW)
            self._filled += count
        self._kept += count

    def _keep(self, frames: Frames, offset_ns: int, latest_ns: int) -> None:
        self._chunks.append(_Chunk(latest_ns, offset_ns, frames))
        self._grown = True

    def _close(self) -> None:
        """Begin a new chunk."""
        if self._filled:
            filled = copied(self._filling[: self._filled])
            self._keep(filled, self._offset_ns, int(filled["t_ns"].max()))
            self._filled = 0

    def on_failure(self, fault: str, t_ns: int, *, wall_ns: int | None = None) -> None:
        """Note a failure; refused (and counted) while the fault's last one is too young.

        Args:
            fault: its id.
            t_ns: when, of the engine's time.
            wall_ns: when, for people; default: the same.
        """
        last = self._last_ns.get(fault)
        if last is not None and 0 <= t_ns - last < self._params.cooldown_s * 1e9:
            self.refused += 1
            return
        self._last_ns[fault] = t_ns
        told_ns = t_ns if wall_ns is None else wall_ns
        self._triggers.append(_Trigger(fault, t_ns, t_ns + self._after_ns, told_ns))

    def forget(self, faults: list[str]) -> None:
        """Give up what belongs to cleared faults; they may be recorded again at once."""
        self._triggers = [trigger for trigger in self._triggers if trigger.fault not in faults]
        for fault in faults:
            self._last_ns.pop(fault, None)

    @property
    def busy(self) -> bool:
        """Whether :meth:`on_time` has something to do."""
        return bool(self._triggers)

    @property
    def due_ns(self) -> int:
        """Time after which :meth:`on_time` has something to do; NEVER: there is nothing."""
        return min((trigger.due_ns for trigger in self._triggers), default=NEVER)

    def on_time(self, t_ns: int, *, final: bool = False) -> list[Recording]:
        """Return the recordings that are complete at a time; ``final``: also those that are not."""
        done = [trigger for trigger in self._triggers if final or trigger.due_ns < t_ns]
        made = [self._cut(trigger) for trigger in done]
        self._triggers = [trigger for trigger in self._triggers if trigger not in done]
        return made

    def _trim(self, t_ns: int) -> None:
        """Give up frames that no recording will ask for."""
        oldest = min([t_ns, *(trigger.t_ns for trigger in self._triggers)]) - self._before_ns
        self._close()
        chunks = self._chunks
        while chunks and chunks[0].latest_ns < oldest:
            self._kept -= len(chunks.popleft().frames)
        while self._gone and int(self._gone[0].max()) < oldest:
            self._gone.popleft()
        # A flood of frames must not fill the memory: frames that no recording could hold go.
        most = self._params.most_frames
        while not self._triggers and chunks and self._kept - len(chunks[0].frames) >= most:
            given_up = chunks.popleft().frames
            self._kept -= len(given_up)
            self._gone.append(given_up["t_ns"].copy())

    def _cut(self, trigger: _Trigger) -> Recording:
        self._close()
        first = trigger.t_ns - self._before_ns
        parts = []
        for chunk in self._chunks:
            for part, offset_ns in spans(chunk.frames, chunk.offset_ns):
                inside = (part["t_ns"] >= first) & (part["t_ns"] <= trigger.due_ns)
                if inside.any():
                    parts.append((chosen(part, inside), offset_ns))
        frames = joined([part for part, _ in parts])
        times = frames["t_ns"].copy()
        frames["t_ns"] += np.repeat([offset for _, offset in parts], [len(part) for part, _ in parts]).astype(np.int64)
        most = self._params.most_frames
        dropped = sum(int((stamps >= first).sum()) for stamps in self._gone)
        if len(frames) > most:
            dropped += len(frames) - most
            nearest = np.sort(np.argsort(np.abs(times - trigger.t_ns), kind="stable")[:most])
            frames = frames[nearest]
        text = "".join(f"{format_frame(frame, self._channel(frame))}\n" for frame in frames)
        return Recording(trigger.fault, trigger.wall_ns, len(frames), dropped, zlib.compress(text.encode()))

    def _channel(self, frame: np.void) -> str:
        bus = int(frame["bus"])
        return self._channels[bus] if bus < len(self._channels) else f"can{bus}"
