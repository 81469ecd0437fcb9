"""The table ``[output.doip]``."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gateway.servers.access import Need
from gateway.servers.bus_server import BusServer
from gateway.servers.section import Section, Surroundings
from gateway.servers.uds.server import UdsServer
from gateway_testers.doip import access_table
from gateway_testers.doip.identity import GATEWAY, NODE, Identity
from gateway_testers.doip.params import ADDRESSES, DoipParams
from gateway_testers.doip.secure import tls_context
from gateway_testers.doip.server import DoipServer

if TYPE_CHECKING:
    from ssl import SSLContext


class Doip(Section[DoipParams]):
    """Diagnostics over IP (ISO 13400-2)."""

    params = DoipParams
    title = "DoIP"
    description = "diagnostics over IP (ISO 13400-2); its services: those of uds"
    needs: Mapping[str, str] = {"uds": "services, sessions and keys are its own"}

    def placed(self, params: DoipParams, folder: Path) -> DoipParams:
        """Return its keys with certificates relative to the configuration's folder."""
        if params.tls is None:
            return params
        files = {name: getattr(params.tls, name) for name in ("certificate", "key", "client_ca")}
        placed = {name: folder / file for name, file in files.items() if file is not None}
        return params.model_copy(update={"tls": params.tls.model_copy(update=placed)})

    def opened(self, params: DoipParams) -> SSLContext | None:
        """Return the context of TLS, of its certificates; None: it has none."""
        return None if params.tls is None else tls_context(params.tls)

    def signals(self, params: DoipParams) -> Iterable[tuple[str, str]]:
        """Return the signals of the power mode."""
        return [(one.signal, f"ready[{k}].signal") for k, one in enumerate(params.ready)]

    def routes(self, params: DoipParams) -> Mapping[str, str]:
        """Return the ECUs of its routes."""
        return {f"route[{k}]": each.ecu for k, each in enumerate(params.route)}

    def server(self, params: DoipParams, around: Surroundings) -> BusServer:
        """Return the DoIP entity."""
        uds, control = around.uds, around.authority.control
        assert uds is not None

        def new_tester(name: str, source: int) -> UdsServer:
            own = uds.model_copy(update={"bus": None, "request": source, "functional": source})
            return around.testers.server(own, name, longest=params.most_bytes - ADDRESSES)

        ready = (lambda: control.meets(params.ready)) if params.ready else None
        node = GATEWAY if params.route else NODE
        return DoipServer(params, new_tester, Identity(params, around.identifiers.read, ready, node), around.opened)

    def door(self, params: DoipParams, gateway: Any, clock: Any) -> Any:
        """Return its sockets."""
        from gateway_testers.doip.door import DoipDoor  # noqa: PLC0415 - it knows the gateway, which has this table

        return DoipDoor(params, gateway, clock)

    def reach(self, params: DoipParams, need: Need) -> Iterable[str]:
        """Return who reaches what."""
        return access_table.reach(params, need)

    def ways_around(self, params: DoipParams) -> Iterable[str]:
        """Return the ways by which something is easier than it looks."""
        return access_table.ways_around(params)


SECTION = Doip()
