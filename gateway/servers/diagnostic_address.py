"""Whether UDS and another application have one address: then one server with both of them answers."""

from __future__ import annotations

from gateway.isotp.params import IsoTpParams
from gateway_fdi.errors import InputError


def share_address(one: IsoTpParams, other: IsoTpParams, name: str, *, same_bus: bool) -> bool:
    """Return whether two servers have one address.

    Args:
        one: of the UDS server.
        other: of the other application.
        name: of its table.
        same_bus: whether they are on one bus.

    Raises:
        InputError: they share some of their identifiers, but not all.
    """
    names = ("request", "functional", "response")
    if same_bus and all(getattr(one, name) == getattr(other, name) for name in names):
        return True
    if same_bus and {one.request, one.response} & {other.request, other.response}:
        raise InputError(
            f"output.uds and output.{name} share some identifiers, but not all: give them the same"
            " request, functional and response, or different ones",
            key=f"output.{name}",
        )
    return False
