"""The server's state: the gateway that it shows, by the hub; locks and subscriptions of clients."""

from __future__ import annotations

from dataclasses import dataclass, field

from gateway.servers.local import SELF
from gateway_serve.hub import Hub
from gateway_serve.sovd.components import OWN, Component, known, slug
from gateway_serve.sovd.errors import SovdError, negative
from gateway_serve.sovd.holding import Locks
from gateway_serve.sovd.watching import Subscriptions


@dataclass
class State:
    """See the module.

    Attributes:
        hub: has what the gateway tells.
        locks: of clients.
        subscriptions: of clients.
    """

    hub: Hub
    locks: Locks = field(init=False)
    subscriptions: Subscriptions = field(default_factory=Subscriptions)

    def __post_init__(self) -> None:
        self.locks = Locks(self.ask, lambda: float(self.hub.hello["s3_s"]))

    # Entities

    def components(self) -> dict[str, Component]:
        """Return the gateway, the ECUs that it asks, and those whose messages it checks, by id."""
        hello = self.hub.hello
        sends = {fault["ecu"]: fault["bus"] for fault in hello["faults"] if fault["ecu"]}
        found = {OWN: Component(OWN, str(hello["name"] or OWN), "", SELF)}
        for ecu in hello["ecus"]:
            name = str(ecu["name"])
            one = Component(slug(name), name, ecu["bus"], name if ecu["asked"] else "", sends=name in sends)
            found.setdefault(one.id, one)
        for name, bus in sends.items():
            found.setdefault(slug(name), Component(slug(name), name, bus, "", sends=True))
        return found

    def component(self, path: dict[str, str]) -> Component:
        """Return the component of a request.

        Raises:
            SovdError: there is none.
        """
        found: Component = known(self.components(), path["component_id"], "component")
        return found

    def buses(self) -> dict[str, str]:
        """Return the names of the buses by id."""
        return {slug(bus["name"]): bus["name"] for bus in self.hub.hello["buses"]}

    def monitors(self) -> dict[str, str]:
        """Return the names of the monitors by id."""
        return {slug(fault["monitor"]): fault["monitor"] for fault in self.hub.hello["faults"]}

    # UDS

    async def ask(self, who: str, ecu: str, request: bytes) -> bytes:
        """Ask by UDS, as the tester of a client; returns the positive response.

        Args:
            who: the client, "": readers.
            ecu: name of the ECU.
            request: its bytes.

        Raises:
            SovdError: a negative response.
            Refused: the gateway does not run, or does not take it.
        """
        if not ecu:
            raise SovdError(409, "this component is only listened to")
        if ecu != SELF and not who:
            raise SovdError(403, "requests to other ECUs are frames on their bus: they need the token of a client")
        answer = await self.hub.link.ask("request", tester=f"sovd.{who or 'reader'}", ecu=ecu, uds=request.hex())
        found = [bytes.fromhex(each) for each in answer["uds"]]
        if found and found[-1][0] == 0x7F:
            raise negative(found[-1])
        return found[-1] if found else b""
