"""A server that has an ISO-TP address on a bus."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from gateway.bus.frames import Frames
from gateway.isotp.endpoint import IsoTpEndpoint
from gateway.servers.bus_server import BusServer


class IsotpServer(BusServer):
    """Has a transport, which puts its requests together and sends its answers.

    Args:
        transport: the address, with requests and responses under way.
    """

    normal = False
    prompt = True
    door = "uds"

    def __init__(self, transport: IsoTpEndpoint) -> None:
        self._transport = transport

    def succeed(self, old: BusServer, buses: Mapping[int, int]) -> None:
        """Keep requests and answers that are under way, if the addresses are the same."""
        if isinstance(old, type(self)) and self._transport.succeed(old._transport, buses.get(old._transport.bus)):
            self.go_on(old)

    def go_on(self, old: IsotpServer) -> None:
        """Keep the rest of what a server of the same kind and address had under way."""

    def restart(self) -> None:
        """Drop requests and answers that are under way."""
        self._transport.restart()

    def identifiers(self, bus: int) -> list[int] | None:
        """Return its request identifiers, if it is on this bus."""
        return self._transport.identifiers if bus == self._transport.bus else []

    def wanted(self, frames: Frames) -> NDArray[np.bool_]:
        """Return which frames carry its request identifiers."""
        return self._transport.wanted(frames)

    def promise(self, frame: np.void, t_ns: int) -> Frames:
        """Return 0x78 for a request that is taken later."""
        self._transport.advance(t_ns)
        request = self._transport.peek(frame)
        if request:
            self._transport.send(self.pending(request))
        return self._transport.take_frames()

    def pending(self, request: bytes) -> list[bytes]:
        """Return the answer that has the tester wait; none where this cannot be told."""
        return []

    def counters(self) -> dict[str, int]:
        """Return what the transport counted."""
        return self._transport.counters()
