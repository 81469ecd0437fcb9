"""A diagnostic server on a bus: an ISO-TP address with UDS, OBD, or both."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gateway.bus.frames import Frames
from gateway.faults.entries import DtcChange
from gateway.isotp.endpoint import IsoTpEndpoint
from gateway.servers.application import Application
from gateway.servers.isotp_server import IsotpServer
from gateway.servers.obd.server import MODES


class DiagnosticServer(IsotpServer):
    """Hands requests from a transport to the application they are for, and its responses back.

    Args:
        transport: the address, with requests and responses under way.
        uds: answers what is no mode of OBD.
        obd: answers modes 01 to 0A; everything, where there is no UDS.
    """

    def __init__(self, transport: IsoTpEndpoint, uds: Application | None, obd: Application | None) -> None:
        super().__init__(transport)
        self.uds = uds
        self._obd = obd
        self._applications = [each for each in (uds, obd) if each is not None]

    def on_frame(self, frame: np.void, t_ns: int) -> Frames:
        """Take a frame; answers the request that it completes."""
        request = self._transport.receive(frame, t_ns)
        if request is not None:
            self._transport.send(self._answer(*request))
        self._hold(t_ns)
        return self._transport.take_frames()

    def pending(self, request: bytes) -> list[bytes]:
        """Return 0x78 of the application that the request is for."""
        application = self._application_for(request)
        return [] if application is None else application.pending(request)

    def _hold(self, t_ns: int) -> None:
        busy = self._transport.busy
        for each in self._applications:
            each.hold(busy, t_ns)

    def _answer(self, request: bytes, functional: bool, t_ns: int) -> list[bytes]:
        application = self._application_for(request)
        return [] if application is None else self.answered(application, request, functional, t_ns)

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
