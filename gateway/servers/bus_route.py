"""A route from bus to bus: an ECU of another bus has identifiers on the tester's."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from gateway.bus.frames import Frames
from gateway.isotp.endpoint import IsoTpEndpoint
from gateway.servers.bus_server import BusServer
from gateway.servers.route import Route
from gateway.servers.uds.params import BusRouteParams
from gateway.servers.uds.server import UdsServer


class BusRoute(BusServer):
    """One. It judges a functional request before the gateway's own server takes it: it stands before that.

    Args:
        params: its settings.
        transport: the identifiers on the tester's bus.
        server: of the tester's session with the gateway.

    Attributes:
        params: the same.
        counts: what it counted.
        route: to the ECU, which is given when there are clients.
        wake: has the servers look again at when it is due, which is given, too.
    """

    normal = False
    prompt = True
    route: Route

    def __init__(self, params: BusRouteParams, transport: IsoTpEndpoint, server: UdsServer) -> None:
        self.params, self._transport, self._server = params, transport, server
        self.counts: Counter[str] = Counter()
        self.wake: Callable[[], None] = lambda: None
        self._answers: list[bytes] = []

    def succeed(self, old: BusServer, buses: Mapping[int, int]) -> None:
        """Keep requests and answers that are under way, if the identifiers are the same."""
        if isinstance(old, BusRoute) and self._transport.succeed(old._transport, buses.get(old._transport.bus)):
            self.counts.update(old.counts)
            self._answers = old._answers

    def identifiers(self, bus: int) -> list[int] | None:
        """Return its request identifiers, if it is on this bus."""
        return self._transport.identifiers if bus == self._transport.bus else []

    def wanted(self, frames: Frames) -> NDArray[np.bool_]:
        """Return which frames carry its request identifiers."""
        return self._transport.wanted(frames)

    def on_frame(self, frame: np.void, t_ns: int) -> Frames:
        """Take a frame; passes the request on that it completes."""
        request = self._transport.receive(frame, t_ns)
        if request is not None:
            self._pass_on(*request)
        return self.on_time(t_ns)

    def promise(self, frame: np.void, t_ns: int) -> Frames:
        """Return 0x78 for a request that is taken later."""
        self._transport.advance(t_ns)
        request = self._transport.peek(frame)
        if request:
            self._transport.send(self._server.pending(request))
        return self._transport.take_frames()

    def _pass_on(self, request: bytes, functional: bool, t_ns: int) -> None:
        """Pass a request on, if it may."""

        def tell(answer: bytes) -> None:
            self._answers.append(answer)
            self.wake()

        by = self._transport.asked_by(functional=functional)
        self.route.pass_on(request, self._server, t_ns, tell, functional=functional, by=by)

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
        return {**self._transport.counters(), **self.counts}
