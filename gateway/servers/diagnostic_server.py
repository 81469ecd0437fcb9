"""A diagnostic server on a bus: an ISO-TP address with UDS, other applications such as OBD, or both."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gateway.bus.frames import Frames
from gateway.faults.entries import DtcChange
from gateway.isotp.endpoint import IsoTpEndpoint
from gateway.servers.application import Application
from gateway.servers.isotp_server import IsotpServer


class DiagnosticServer(IsotpServer):
    """Hands requests from a transport to the application they are for, and its responses back.

    Args:
        transport: the address, with requests and responses under way.
        uds: answers what no other application has for its own.
        others: answer the requests that are their own (OBD: modes 01 to 0A); without UDS the first one answers all.
    """

    def __init__(self, transport: IsoTpEndpoint, uds: Application | None, others: Sequence[Application] = ()) -> None:
        super().__init__(transport)
        self.uds = uds
        self._others = others
        self._applications = [*([] if uds is None else [uds]), *others]

    def on_frame(self, frame: np.void, t_ns: int) -> Frames:
        """Take a frame; answers the request that it completes."""
        request = self._transport.receive(frame, t_ns)
        if request is not None:
            self._transport.send(self._answer(*request))
        self._hold(t_ns)
        return self._transport.take_frames()

    def pending(self, request: bytes) -> list[bytes]:
        """Return 0x78 of the application that the request is for."""
        return self._application_for(request).pending(request)

    def _hold(self, t_ns: int) -> None:
        busy = self._transport.busy
        for each in self._applications:
            each.hold(busy, t_ns)

    def _answer(self, request: bytes, functional: bool, t_ns: int) -> list[bytes]:
        return self.answered(self._application_for(request), request, functional, t_ns)

    def _application_for(self, request: bytes) -> Application:
        own = (each for each in self._others if request[0] in each.services)
        return next(own, self.uds or self._others[0])

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
