"""Diagnostic addresses: UDS and OBD on one ISO-TP server where their identifiers are the same."""

from __future__ import annotations

from collections.abc import Sequence

from gateway.bus.frames import Frames
from gateway.errors import InputError
from gateway.faults.entries import DtcChange
from gateway.servers.base import NEVER
from gateway.servers.isotp import IsoTpParams, IsoTpServer
from gateway.servers.obd.server import MODES, ObdServer
from gateway.servers.uds.server import UdsServer


class DiagnosticServer(IsoTpServer):
    """One address with a UDS server, an OBD server, or both behind it.

    Args:
        params: addresses and transport.
        bus: index of the bus.
        uds: answers what is no mode of OBD.
        obd: answers modes 01 to 0A.
    """

    def __init__(
        self, params: IsoTpParams, bus: int, uds: UdsServer | None, obd: ObdServer | None
    ) -> None:
        self._uds = uds
        self._obd = obd
        super().__init__(
            params,
            bus,
            self._route,
            lambda t_ns: [] if uds is None else uds.pass_time(t_ns),
            lambda: NEVER if uds is None else uds.next_ns,
        )

    def _route(self, request: bytes, functional: bool, t_ns: int) -> list[bytes]:
        if self._obd is not None and (request[0] in MODES or self._uds is None):
            return self._obd.answer(request, functional, t_ns)
        return [] if self._uds is None else self._uds.answer(request, functional, t_ns)

    def on_changes(self, changes: Sequence[DtcChange], t_ns: int) -> Frames:
        """Send the responses that were asked for on changes (0x86)."""
        return self.push([] if self._uds is None else self._uds.on_changes(changes, t_ns), t_ns)


def share_address(one: IsoTpParams, other: IsoTpParams, *, same_bus: bool) -> bool:
    """Tell whether two servers have one address.

    Args:
        one: of the UDS server.
        other: of the OBD server.
        same_bus: whether they are on one bus.

    Raises:
        InputError: they share some of their identifiers, but not all.
    """
    names = ("request", "functional", "response")
    if same_bus and all(getattr(one, name) == getattr(other, name) for name in names):
        return True
    if same_bus and {one.request, one.response} & {other.request, other.response}:
        raise InputError(
            "output.uds and output.obd share some identifiers, but not all: give them the same"
            " request, functional and response, or different ones",
            key="output.obd",
        )
    return False
