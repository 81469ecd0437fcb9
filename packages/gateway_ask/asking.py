"""The clients of a gateway, built of its configuration."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from gateway.common.fence import Fence
from gateway.config.model import Config
from gateway.engine.core import Engine, Sink
from gateway.faults.memory import FaultMemory
from gateway.runtime.assemble import Parts
from gateway.servers.bus_server import BusServer
from gateway.servers.tester_control import TesterControl
from gateway.signals.reassembly import woven_of
from gateway_ask.clients.dm1 import Dm1Listener
from gateway_ask.clients.poller import Poller
from gateway_ask.clients.protocols import schedule_of
from gateway_ask.log_answers import ecus_of
from gateway_ask.vehicle import Vehicle


class Clients(Poller):
    """The clients of a gateway, and what keeps the DTCs that their answers tell."""

    _vehicle: Vehicle

    def memory_server(self, config: Config, memory: FaultMemory, engine: Engine) -> BusServer:
        """Return what keeps the DTCs that answers tell, and tests them as faults of ours."""
        self._vehicle = Vehicle(config, self, memory, engine)
        return self._vehicle

    def connect(self, note: Callable[[dict[str, Any]], None], sink: Sink) -> None:
        """Take who tells events when they are stored, and who takes the engine's."""
        self._vehicle.connect(note, sink)


def asking(
    config: Config, parts: Parts, control: TesterControl, may_ask: Callable[[int], bool], fence: Fence
) -> Clients:
    """Build the clients of other ECUs; arguments as of ``gateway.runtime.assemble.asking_of``."""
    made = ecus_of(config, parts.answers, lambda of: schedule_of(of, control.meets))
    rates = {bus: config.bus[bus].ask.requests_per_s for bus in config.answered if not config.bus[bus].listen_only}
    bus_of = {bus: len(config.bus) + at for at, bus in enumerate(config.answered)}
    return Clients(made, rates, may_ask, _dm1_of(config), bus_of, fence, woven_of(parts.engine.plan))


def _dm1_of(config: Config) -> Dm1Listener | None:
    """Build what hears DTCs that are broadcast; None: no bus wants it. An ECU is known by its address."""
    buses = [k for k, bus in enumerate(config.bus) if bus.dm1]
    names = {
        (bus, config.ecu[k].address or 0): config.ecu[k].name
        for bus, ecus in config.answered.items()
        for k in ecus
        if config.ecu[k].address is not None
    }
    ours = config.j1939_addresses
    return Dm1Listener(buses, names, {k: config.bus[k].name for k in buses}, ours) if buses else None
