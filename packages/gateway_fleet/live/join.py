"""A car that takes part in a fleet: a process beside the daemon sends what its fault memory keeps for the fleet."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from gateway.faults.fleet import FleetParams
from gateway_fdi.common.log import get_logger
from gateway_fdi.errors import GatewayError
from gateway_fleet.live.deliver import Delivery, Way
from gateway_fleet.live.queue import Queue
from gateway_serve.link import Refused, StatusLink

log = get_logger(__name__)


class Car:
    """A car's part in a fleet.

    Args:
        params: the car.
        memory: its fault memory.
        socket: status socket of its daemon.
        listeners: each takes messages of the daemon, with their bytes.
    """

    def __init__(
        self,
        params: FleetParams,
        memory: Path,
        socket: Path,
        listeners: Sequence[Callable[[dict[str, Any], bytes], None]] = (),
    ) -> None:
        self.params, self._listeners = params, listeners
        self.queue = Queue(memory)
        self.connected = False
        self.link = StatusLink(socket, self._on_message, self._on_link)

    def _on_link(self, connected: bool, reason: str) -> None:
        if connected != self.connected:
            log.info("gateway reached" if connected else "gateway gone", reason=reason)
        self.connected = connected
        if not connected:
            self.queue.close()

    def _on_message(self, message: dict[str, Any], block: bytes) -> None:
        for listener in self._listeners:
            listener(message, block)

    @property
    def daemon(self) -> int:
        """Process of the daemon; 0: it is not known."""
        return self.link.peer if self.connected else 0

    async def take_away(self, numbers: Sequence[int]) -> None:
        """Have rows taken away that have arrived: by the daemon, or without one; else it is tried again later."""
        with suppress(Refused, GatewayError):
            if self.connected:
                await self.link.ask("arrived", numbers=list(numbers))
            else:
                self.queue.take_away(numbers)

    async def post(self, events: Sequence[dict[str, Any]]) -> bool:
        """Have the daemon keep events for the fleet; returns whether it does."""
        try:
            for event in events:
                await self.link.ask("post", events=[event])
        except Refused as error:
            log.warning("an event is not kept for the fleet", reason=str(error))
            return False
        return True

    def delivery(self, way: Way) -> Delivery:
        """Return what sends its events."""
        return Delivery(self.queue, self.params, way, self.take_away)
