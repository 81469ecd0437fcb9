"""The table ``[output.j1939]``."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from gateway.servers.bus_server import BusServer
from gateway.servers.section import Section, Surroundings
from gateway_testers.j1939.endpoint import J1939Endpoint
from gateway_testers.j1939.params import J1939Params
from gateway_testers.j1939.server import J1939Server


class J1939(Section[J1939Params]):
    """The diagnostic messages of SAE J1939-73."""

    params = J1939Params
    title = "J1939"
    description = "J1939 diagnostic messages (J1939-73)"

    def shown(self, params: J1939Params) -> Iterable[tuple[str, str]]:
        """Return the signals of the expanded freeze frame."""
        return [(entry.signal, f"freeze_frame[{k}].signal") for k, entry in enumerate(params.freeze_frame)]

    def allows(self, params: J1939Params) -> Mapping[str, tuple[str, bool]]:
        """Return whether DM3 and DM11 clear, where its own key says so."""
        return {} if params.allow_clear is None else {"j1939_clear": ("allow_clear", params.allow_clear)}

    def j1939_address(self, params: J1939Params) -> int | None:
        """Return the address that it claims."""
        return params.address

    def server(self, params: J1939Params, around: Surroundings) -> BusServer:
        """Return the server."""
        endpoint = J1939Endpoint(params.name, params.address, around.bus, commandable=params.commanded_address)
        control, authority = around.authority.control, around.authority
        return J1939Server(params, endpoint, around.memory, control, authority, around.bus_name)


SECTION = J1939()
