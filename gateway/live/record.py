"""Recording without monitoring: the live loop with nobody behind it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from gateway.bus.frames import Frames, empty
from gateway.outputs.base import NEVER


class Nobody:
    """Takes the frames that a gateway would take, and has nothing to say."""

    next_ns = NEVER

    def __init__(self) -> None:
        self.frames = 0

    def feed(self, frames: Frames) -> Frames:
        """Count frames."""
        self.frames += len(frames)
        return empty(0)

    def advance(self, t_ns: int) -> Frames:
        """Let time pass."""
        return empty(0)

    def poll(self, t_ns: int) -> Frames:
        """Let time pass."""
        return empty(0)

    def identifiers_on(self, bus: int) -> list[int] | None:
        """Listen to all."""
        return None

    def serve_requests(self) -> None:
        """Nobody asks."""

    def note_buses(self, states: Sequence[Mapping[str, Any]]) -> None:
        """Nobody looks."""
