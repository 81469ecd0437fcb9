"""Contract of what is on a bus beside the monitors: takes frames, durable changes, time; gives frames."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from gateway.bus.frames import Frames, empty
from gateway.common.fence import Fence, Wall
from gateway.common.times import NEVER
from gateway.faults.entries import DtcChange
from gateway.servers.application import Application
from gateway.servers.lines import Lines
from gateway.servers.uds.nrc import Nrc


class BusServer:
    """A server of the gateway on a bus: it answers testers, or only tells.

    It reads no clock: times come with the calls. A server leaves the parts of the contract that it does not need as
    they are here.
    """

    #: Whether it is normal communication, which a tester can switch off (ISO 14229-1, 0x28).
    normal = True
    #: Whether its time is that of the bus (answers, separation times) rather than that of the monitors.
    prompt = False
    #: Whether its frames go before all others when a bus does not take all at once.
    urgent = False
    #: Frames that it takes where :meth:`identifiers` are too many to list; see :class:`gateway.bus.id_filter.Heard`.
    masks: frozenset[tuple[int, int]] = frozenset()
    #: Name under which its exceptions are counted.
    door = "bus"
    #: Around the work for one tester; :class:`gateway.servers.bus_servers.BusServers` gives it that of the gateway.
    wall = Wall(Fence(), door)

    def __str__(self) -> str:
        """Return its name for people."""
        return f"all of {self.door}"

    def identifiers(self, bus: int) -> list[int] | None:
        """Return the identifiers (with EXTENDED) it listens to on a bus; None: those of :attr:`masks`."""
        return []

    def wanted(self, frames: Frames) -> NDArray[np.bool_] | None:
        """Return which frames of a batch are for it, shape (n,); None: none ever are."""
        return None

    def on_frame(self, frame: np.void, t_ns: int) -> Frames:
        """Take a frame that it wanted; returns frames to send."""
        return empty(0)

    def promise(self, frame: np.void, t_ns: int) -> Frames:
        """Return frames that have a tester wait, whose request in a wanted frame is taken later."""
        return empty(0)

    def on_changes(self, changes: Sequence[DtcChange], t_ns: int) -> Frames:
        """Take changes that are durable; returns frames to send."""
        return empty(0)

    def on_time(self, t_ns: int) -> Frames:
        """Let time pass; returns frames to send."""
        return empty(0)

    def succeed(self, old: BusServer, buses: Mapping[int, int]) -> None:
        """Go on where a server of the configuration before stops, if it is the same one.

        Args:
            old: one of its servers, of any kind; not to be used any more.
            buses: index of a bus there -> its index here.
        """

    def connect_routes(self, lines: Lines, wake: Callable[[], None]) -> None:
        """Take the lines to ECUs, if it has routes.

        Args:
            lines: to the ECUs.
            wake: has the servers look again at when it is due.
        """

    def restart(self) -> None:
        """Drop what is under way, after an exception of which no tester is known."""

    def answered(self, application: Application, request: bytes, functional: bool, t_ns: int) -> list[bytes]:
        """Return an application's responses to a request; where it fails, that it is rejected (0x10).

        Args:
            application: whose request it is.
            request: not empty.
            functional: whether it was meant for every server.
            t_ns: now.
        """
        failed = [bytes([0x7F, request[0], Nrc.GENERAL_REJECT])]
        return self.wall.keep(
            application.answer, request, functional, t_ns, of=f"request {request[:8].hex()}", instead=failed
        )

    def counters(self) -> dict[str, int]:
        """Return what it counted, by name."""
        return {}

    @property
    def next_ns(self) -> int:
        """Time at which :meth:`on_time` has something to do next."""
        return NEVER
