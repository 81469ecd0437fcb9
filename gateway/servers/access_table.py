"""The table of who reaches which ECUs by routes from bus to bus, for `gateway check`."""

from __future__ import annotations

from collections.abc import Iterator

from gateway.bus.frames import ID_MASK
from gateway.servers.access import SESSIONS, Need
from gateway.servers.uds.params import UdsParams

_SESSIONS = {number: name for name, number in SESSIONS.items()}


def bus_reach(own: UdsParams, bus: str, need: Need) -> Iterator[str]:
    """Yield who reaches what by one address of the UDS server, one line each; nothing, where it has no routes.

    Args:
        own: the address.
        bus: name of its bus.
        need: of what does more than read, by a route.
    """
    if own.route:
        yield f"all who can send on the bus {bus}, in the session at 0x{own.request:X}, reach:"
    for route in own.route:
        request, response, target, _ = route.place
        byte = "" if target is None else f" {target:02X}"
        functional = route.transport(own).functional
        all_of = "" if functional is None else f", with all by 0x{functional:X}"
        ids = f"0x{request & ID_MASK:X}{byte}, 0x{response & ID_MASK:X}{all_of}"
        yield f"  {ids}  {passing(route.ecu, need)}"


def passing(ecu: str, need: Need) -> str:
    """Return what a route to an ECU lets pass, for people."""
    return f"{ecu}: 10 01, 19, 22, 3E, OBD but 04, 08; {_more(need)}"


def routes_around(need: Need) -> Iterator[str]:
    """Yield the way by which routes are easier than they look, if there is one."""
    if need.allowed and not need.is_locked:
        when = " while its conditions are met" if need.when else ""
        yield f"access.route: every tester may write and clear by each route{when}: no security, no role"


def _more(need: Need) -> str:
    if not need.allowed:
        return "nothing else"
    parts = [f"in the {' or '.join(_SESSIONS[each] for each in sorted(need.sessions))} session"]
    parts += [f"security level {need.security}"] if need.security else []
    parts += [f"role {' or '.join(sorted(need.roles))}"] if need.roles else []
    for one in need.when:
        low, high = ("" if each is None else f"{each:g}" for each in (one.min, one.max))
        parts.append(f"{one.signal} in {low}..{high}")
    return "all else: " + ", ".join(parts)
