"""Whether UDS and OBD have one address: then one server with both of them answers."""

from __future__ import annotations

from gateway.isotp.params import IsoTpParams
from gateway_fdi.errors import InputError


def share_address(one: IsoTpParams, other: IsoTpParams, *, same_bus: bool) -> bool:
    """Return whether two servers have one address.

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
