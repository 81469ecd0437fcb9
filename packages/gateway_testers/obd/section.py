"""The table ``[output.obd]``."""

from __future__ import annotations

from collections.abc import Iterable

from gateway.servers.application import Application
from gateway.servers.section import IsotpSection, Surroundings
from gateway_testers.obd.params import ObdParams
from gateway_testers.obd.server import ObdServer


class Obd(IsotpSection[ObdParams]):
    """The modes of OBD (SAE J1979), and its identifiers on UDS (SAE J1979-2)."""

    params = ObdParams
    title = "OBD"
    description = "OBD server (SAE J1979) on ISO-TP"

    def shown(self, params: ObdParams) -> Iterable[tuple[str, str]]:
        """Return the signals of its PIDs."""
        return [(pid.signal, f"pid[{k}].signal") for k, pid in enumerate(params.pid)]

    def application(self, params: ObdParams, around: Surroundings) -> Application:
        """Return the server of the modes, which has data identifiers of UDS, too."""
        made = ObdServer(params, around.memory, around.authority.control, around.authority, around.bus_name)
        around.identifiers.fall_back(made.identifier)
        return made


SECTION = Obd()
