"""Requests to other ECUs: the contract of the package that asks; without one nothing is asked."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from gateway.bus.frames import Frames, empty
from gateway.bus.id_filter import IdFilter
from gateway.common.fence import Fence
from gateway.common.times import NEVER
from gateway.config.model import Config
from gateway.engine.core import Engine, Sink
from gateway.faults.memory import FaultMemory
from gateway.servers.bus_server import BusServer
from gateway.servers.lines import Line
from gateway.signals.reassembly import Woven
from gateway_fdi.errors import InputError

#: Name of the call that makes the object: of configuration, parts, control, may_ask, fence.
ASKING = "asking"


class Asking:
    """Asks nothing, and hears no answer; messages of several frames are put together.

    Args:
        woven: puts messages of several frames together; None: there are none.
        fence: counts exceptions that frames cause.

    Attributes:
        heard: what it listens to, on any bus.
        alter: changes frames with answers among them, as a fault of an ECU would; None: nobody does.
        next_ns: when :meth:`poll` has something to do.
    """

    def __init__(self, woven: Woven | None = None, fence: Fence | None = None) -> None:
        self._woven = woven
        self._wall = (fence or Fence()).wall("ecu")
        self.heard = IdFilter(frozenset(), frozenset()) if woven is None else woven.heard
        self.alter: Callable[[Frames], Frames] | None = None
        self.next_ns = NEVER

    def hear(self, frames: Frames) -> Frames:
        """Take frames in order of time; returns them with those of the answers and messages that they complete."""
        if self._woven is None:
            return frames
        return self._wall.keep(self._woven.hear, frames, of="messages of several frames", instead=frames)

    def poll(self, t_ns: int) -> Frames:
        """Let time pass; returns the frames to send."""
        return empty(0)

    def identifiers_on(self, bus: int) -> list[int] | None:
        """Return the identifiers (with EXTENDED) that it listens to on a bus; None: they are too many to list."""
        return []

    @property
    def askable(self) -> Sequence[str]:
        """Names of the ECUs that may be asked."""
        return ()

    def line(self, name: str, requests_per_s: float | None = None) -> Line:
        """Return the line to an ECU, for requests of testers.

        Raises:
            InputError: there is no such ECU.
        """
        raise InputError("no such ECU", value=name)

    def memory_server(self, config: Config, memory: FaultMemory, engine: Engine) -> BusServer | None:
        """Return what keeps the DTCs that answers tell, and tests them as faults of ours; None: none tell any.

        Args:
            config: the configuration.
            memory: keeps the DTCs.
            engine: debounces the faults that stand for some of them.
        """
        return None

    def connect(self, note: Callable[[dict[str, Any]], None], sink: Sink) -> None:
        """Take who tells events when they are stored, and who takes the engine's."""

    def succeed(self, old: Asking, buses: Mapping[int, int]) -> None:
        """Go on where that of the configuration before stops.

        Args:
            old: not to be used any more.
            buses: index of a bus there -> its index here.
        """
        if self._woven is not None and old._woven is not None:
            self._woven.succeed(old._woven, buses)

    def counters(self) -> dict[str, int]:
        """Return what was counted, by name."""
        return {} if self._woven is None else self._woven.counters()

    def states(self) -> list[dict[str, Any]]:
        """Return what is counted of each ECU, and which requests it refuses."""
        return []
