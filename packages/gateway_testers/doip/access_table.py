"""The table of who reaches what by DoIP, and ways by which it is easier than it looks: for `gateway check`."""

from __future__ import annotations

import ipaddress
from collections.abc import Iterator

from gateway.servers.access import Need
from gateway.servers.access_table import passing
from gateway_testers.doip.params import DoipParams, DoipTesterParams


def reach(params: DoipParams, need: Need) -> Iterator[str]:
    """Yield the table of who reaches what, one line each.

    Args:
        params: of the DoIP server.
        need: of what does more than read, by a route.
    """
    for text in params.bind:
        ports = [] if params.tls is not None and params.tls.required else [f"TCP {params.port}"]
        ports += [] if params.tls is None else [f"TLS {params.tls.port}"]
        yield f"{_from_where(text)}: {text}, {', '.join(ports)} (UDP {params.port}: identification, status)"
    for entry in params.tester:
        by = f" with the certificate {entry.certificate!r}" if entry.certificate else ""
        yield f"testers {_addresses(entry)}{by} reach:"
        yield f"  0x{params.address:04X}  the gateway: as by UDS on a bus ([access])"
        for route in params.route:
            yield f"  0x{route.address:04X}  {passing(route.ecu, need)}"
        yield f"  0x{params.functional:04X}  all of them"


def ways_around(params: DoipParams) -> Iterator[str]:
    """Yield the ways by which something is easier than it looks, one line each."""
    outside = [text for text in params.bind if not ipaddress.ip_address(text).is_loopback]
    if outside and (params.tls is None or not params.tls.required):
        there = ", ".join(outside)
        yield f"output.doip.bind: all who reach {there} may come without TLS, and a source address proves nothing"
    if outside and params.tls is not None and not all(entry.certificate for entry in params.tester):
        yield "output.doip.tester: some need no certificate, so that TLS hides what they say, and not who they are"


def _from_where(text: str) -> str:
    address = ipaddress.ip_address(text)
    return "this machine" if address.is_loopback else "any network" if address.is_unspecified else "its network"


def _addresses(entry: DoipTesterParams) -> str:
    return f"0x{entry.address:04X}" + ("" if entry.last is None else f" to 0x{entry.last:04X}")
