"""Identifiers that belong to a bus beside those of its databases: of servers, ECUs that are asked, and J1939 itself."""

from __future__ import annotations

from gateway.bus.frames import EXTENDED
from gateway.config.model import Config
from gateway.engine.checks.bus_health import BusInstance
from gateway.j1939.frame import ACKNOWLEDGMENT, ADDRESS_CLAIMED, REQUEST, TP_CM, TP_DT
from gateway.servers.dtc_frame import message_of
from gateway_fdi.common.resources import shipped

#: Groups of J1939 that any node may send: transport, network management, and diagnostic messages DM1 to DM32.
_J1939 = (ACKNOWLEDGMENT, REQUEST, TP_CM, TP_DT, ADDRESS_CLAIMED, *range(0xFECA, 0xFEE0), 0xFEEB, 0xFEEC)


def bus_instances(config: Config) -> tuple[BusInstance, ...]:
    """Return the buses, with all that belongs to them."""
    return tuple(
        BusInstance(bus.name, bus.health, _known(config, k), _groups(config, k)) for k, bus in enumerate(config.buses)
    )


def _with_flag(can_id: int) -> int:
    return can_id | (EXTENDED if can_id > 0x7FF else 0)


def _known(config: Config, bus: int) -> tuple[int, ...]:
    found = {_with_flag(can_id) for can_id in config.buses[bus].health.known}
    uds, frame = config.output.uds, config.output.dtc_frame
    others = [params for _, params in config.output.applications.values()]
    for params in (*(() if uds is None else uds.each_address), *others):
        if config.bus_index(params.bus) == bus:
            ids = (params.request, params.response, params.functional)
            found |= {_with_flag(can_id) for can_id in ids if can_id is not None}
            for route in getattr(params, "route", ()):
                found |= {route.place.request, route.place.response}
    for k in config.answered.get(bus, ()):
        place = config.ecu[k].place
        found |= {place.request, place.response}
    for one, params in config.output.sections.values():
        if hasattr(params, "bus") and config.bus_index(params.bus) == bus:
            found |= set(one.identifiers(params))
    for server in config.servers:
        found |= set(server.identifiers) if server.bus == bus else set()
    if frame is not None and config.bus_index(frame.bus) == bus:
        found.add(_with_flag(int(message_of(shipped("dbc/gateway.dbc")).frame_id)))
    return tuple(sorted(found))


def _groups(config: Config, index: int) -> tuple[int, ...]:
    bus = config.buses[index]
    own = any(one == index for one, _ in config.j1939_addresses)
    if bus.match != "pgn" and not bus.dm1 and not own:
        return ()
    return tuple(EXTENDED | group << 8 for group in _J1939)
