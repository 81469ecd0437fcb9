"""A route from bus to bus: an ECU of another bus has identifiers on the tester's."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

import numpy as np

from gateway.bus.frames import Frames
from gateway.isotp.endpoint import IsoTpEndpoint
from gateway.servers.isotp_server import IsotpServer
from gateway.servers.lines import Lines
from gateway.servers.route import Route
from gateway.servers.uds.params import BusRouteParams
from gateway.servers.uds.server import UdsServer


class BusRoute(IsotpServer):
    """One. It judges a functional request before the gateway's own server takes it: it stands before that.

    Args:
        params: its settings.
        transport: the identifiers on the tester's bus.
        server: of the tester's session with the gateway.

    Attributes:
        params: the same.
        counts: what it counted.
        route: to the ECU, which is given when there are clients.
    """

    route: Route

    def __init__(self, params: BusRouteParams, transport: IsoTpEndpoint, server: UdsServer) -> None:
        super().__init__(transport)
        self.params, self._server = params, server
        self.counts: Counter[str] = Counter()
        self._wake: Callable[[], None] = lambda: None
        self._answers: list[bytes] = []

    def connect_routes(self, lines: Lines, wake: Callable[[], None]) -> None:
        """Take the line to its ECU."""
        self.route = Route(lines.line(self.params.ecu, self.params.requests_per_s), self.counts)
        self._wake = wake

    def go_on(self, old: IsotpServer) -> None:
        """Keep answers that wait, and what was counted."""
        if isinstance(old, BusRoute):
            self.counts.update(old.counts)
            self._answers = old._answers

    def on_frame(self, frame: np.void, t_ns: int) -> Frames:
        """Take a frame; passes the request on that it completes."""
        request = self._transport.receive(frame, t_ns)
        if request is not None:
            self._pass_on(*request)
        return self.on_time(t_ns)

    def pending(self, request: bytes) -> list[bytes]:
        """Return 0x78, as the gateway's own server would."""
        return self._server.pending(request)

    def _pass_on(self, request: bytes, functional: bool, t_ns: int) -> None:
        """Pass a request on, if it may."""

        def send_answer(answer: bytes) -> None:
            self._answers.append(answer)
            self._wake()

        by = self._transport.asked_by(functional=functional)
        self.route.pass_on(request, self._server, t_ns, send_answer, functional=functional, by=by)

    def on_time(self, t_ns: int) -> Frames:
        """Send answers that have come, and run separation times and timeouts."""
        self._transport.advance(t_ns)
        self._transport.send(self._answers)
        self._answers.clear()
        return self._transport.take_frames()

    @property
    def next_ns(self) -> int:
        """Time of the next timer; the past, where an answer waits."""
        return 0 if self._answers else self._transport.next_ns

    def counters(self) -> dict[str, int]:
        """Return what it counted."""
        return {**super().counters(), **self.counts}
