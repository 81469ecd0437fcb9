"""A diagnostic server on a bus: an ISO-TP address with UDS, OBD, or both."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from gateway.bus.frames import Frames
from gateway.faults.entries import DtcChange
from gateway.isotp.endpoint import IsoTpEndpoint
from gateway.servers.application import Application
from gateway.servers.bus_server import BusServer
from gateway.servers.obd.server import MODES


class DiagnosticServer(BusServer):
    """Hands requests from a transport to the application they are for, and its responses back.

    Args:
        transport: the address, with requests and responses under way.
        uds: answers what is no mode of OBD.
        obd: answers modes 01 to 0A; everything, where there is no UDS.
    """

    normal = False
    prompt = True

    def __init__(self, transport: IsoTpEndpoint, uds: Application | None, obd: Application | None) -> None:
        self._transport = transport
        self.uds = uds
        self._obd = obd
        self._applications = [each for each in (uds, obd) if each is not None]

    def succeed(self, old: BusServer, buses: Mapping[int, int]) -> None:
        """Keep requests and answers that are under way, if the addresses are the same."""
        if isinstance(old, DiagnosticServer):
            self._transport.succeed(old._transport, buses.get(old._transport.bus))

    def identifiers(self, bus: int) -> list[int] | None:
        """Return its request identifiers, if it is on this bus."""
        return self._transport.identifiers if bus == self._transport.bus else []

    def wanted(self, frames: Frames) -> NDArray[np.bool_]:
        """Return which frames carry its request identifiers."""
        return self._transport.wanted(frames)

    def on_frame(self, frame: np.void, t_ns: int) -> Frames:
        """Take a frame; answers the request that it completes."""
        request = self._transport.receive(frame, t_ns)
        if request is not None:
            self._transport.send(self._answer(*request))
        self._hold(t_ns)
        return self._transport.take_frames()

    def promise(self, frame: np.void, t_ns: int) -> Frames:
        """Return 0x78 for a request that is taken later."""
        self._transport.advance(t_ns)
        request = self._transport.peek(frame)
        application = None if not request else self._application_for(request)
        if request and application is not None:
            self._transport.send(application.pending(request))
        return self._transport.take_frames()

    def _hold(self, t_ns: int) -> None:
        busy = self._transport.busy
        for each in self._applications:
            each.hold(busy, t_ns)

    def _answer(self, request: bytes, functional: bool, t_ns: int) -> list[bytes]:
        application = self._application_for(request)
        return [] if application is None else application.answer(request, functional, t_ns)

    def _application_for(self, request: bytes) -> Application | None:
        if self._obd is not None and (request[0] in MODES or self.uds is None):
            return self._obd
        return self.uds

    def on_changes(self, changes: Sequence[DtcChange], t_ns: int) -> Frames:
        """Send the responses that were asked for on changes (0x86)."""
        made = [r for each in self._applications for r in each.on_changes(changes, t_ns)]
        self._transport.push(made, t_ns)
        if made:
            self._hold(t_ns)
        return self._transport.take_frames()

    def on_time(self, t_ns: int) -> Frames:
        """Run separation times and timeouts, and send responses that come later."""
        now = self._transport.advance(t_ns)
        self._transport.send([r for each in self._applications for r in each.pass_time(now)])
        self._hold(now)
        return self._transport.take_frames()

    @property
    def next_ns(self) -> int:
        """Time of the next timer of the transport or of an application."""
        return min([self._transport.next_ns, *(each.next_ns for each in self._applications)])

    def counters(self) -> dict[str, int]:
        """Return what the transport counted."""
        return self._transport.counters()
