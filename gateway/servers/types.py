"""Types of servers on a bus that other packages bring, for tables ``[[server]]`` of a configuration."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, NamedTuple, TypeVar

from gateway.common.plugins import Registry, accept_instance
from gateway.faults.memory import FaultMemory
from gateway.servers.authority import Authority
from gateway.servers.bus_server import BusServer
from gateway.servers.identifiers import Identifiers
from gateway_fdi.common.tomlfile import StrictModel

P = TypeVar("P", bound=StrictModel)
#: Version of this contract.
API = 1


class Place(NamedTuple):
    """Place of a server in a gateway.

    Attributes:
        name: of the server, in the configuration.
        bus: index of its bus.
        memory: to read DTCs from.
        identifiers: data that testers read.
        authority: says who may intervene, and does it.
    """

    name: str
    bus: int
    memory: FaultMemory
    identifiers: Identifiers
    authority: Authority


@dataclass(frozen=True, kw_only=True)
class ServerType(Generic[P]):
    """A type of server.

    Attributes:
        params: its keys.
        made: the server, of its keys and its place; it is made again when the configuration is reloaded.
        identifiers: of its frames, by its keys, with :data:`gateway.bus.frames.EXTENDED`: they belong to its bus.
        api: :data:`API` as it was when the type was written.
    """

    params: type[P]
    made: Callable[[P, Place], BusServer]
    identifiers: Callable[[P], tuple[int, ...]]
    api: int = API


#: All types.
SERVERS: Registry[ServerType[StrictModel]] = Registry("gateway.servers", accept_instance(ServerType, API))


class Server(NamedTuple):
    """A configured server: its type and keys, its name, and the index of its bus."""

    type: ServerType[StrictModel]
    params: StrictModel
    name: str
    bus: int

    def made(self, memory: FaultMemory, identifiers: Identifiers, authority: Authority) -> BusServer:
        """Return the server."""
        return self.type.made(self.params, Place(self.name, self.bus, memory, identifiers, authority))

    @property
    def identifiers(self) -> tuple[int, ...]:
        """Identifiers that belong to its bus."""
        return self.type.identifiers(self.params)
