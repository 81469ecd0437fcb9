"""Checks of one table of a configuration against another: names that are taken, and names that nothing has."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain, islice
from pathlib import Path

from gateway.bus.frames import ID_MASK
from gateway.config.model import Config
from gateway.config.monitor_types import monitor_of
from gateway.faults.settings import POWER
from gateway.isotp.params import IsoTpParams
from gateway.servers.access_review import wrong_rules
from gateway.servers.identifiers import check_unique
from gateway.servers.uds.params import BusRouteParams
from gateway_fdi.errors import InputError, InputErrors, each_of, nearest, under


def cross_check(config: Config) -> Iterator[InputError]:
    """Yield all that is wrong."""
    return chain(
        _names(config),
        _monitors(config),
        _reporters(config),
        _checks(config),
        _outputs(config),
        _servers_of_others(config),
        check_unique(config.did),
        _cycles(config),
        _access(config),
        _addresses(config),
        _needed_tables(config),
        _routes(config),
        _ecus(config),
        _faults_of_ecus(config),
        _only_listened_to(config),
    )


def _names(config: Config) -> Iterator[InputError]:
    named = {kind: [entry.name for entry in getattr(config, kind)] for kind in ("bus", "monitor", "ecu", "server")}
    for kind, found in named.items():
        for k, name in enumerate(found):
            if name in found[:k]:
                yield InputError("this name is taken", key=f"{kind}[{k}].name", value=name)


def _monitors(config: Config) -> Iterator[InputError]:
    for k, entry in enumerate(config.monitor):
        try:
            monitor_of(entry, f"monitor[{k}]")
        except InputErrors as errors:
            yield from errors.errors
        except InputError as error:
            yield error
        try:
            with under(f"monitor[{k}].bus", entry.bus):
                config.bus_index(entry.bus)
        except InputError as error:
            yield error


def _reporters(config: Config) -> Iterator[InputError]:
    """Names and DTCs of reporters and their faults are theirs alone."""
    if config.report is None:
        return
    taken = {"gateway": "the gateway itself"}
    taken |= {bus.name: "a bus" for bus in config.bus} | {entry.name: "a monitor" for entry in config.monitor}
    codes: dict[str, str] = {}
    for k, reporter in enumerate(config.report.reporter):
        key = f"report.reporter[{k}]"
        if reporter.name in taken:
            text = f"this name is taken by {taken[reporter.name]}"
            yield InputError(text, key=f"{key}.name", value=reporter.name)
        taken.setdefault(reporter.name, key)
        names: set[str] = set()
        for j, fault in enumerate(reporter.fault):
            if fault.name in names:
                yield InputError("this name is taken", key=f"{key}.fault[{j}].name", value=fault.name)
            names.add(fault.name)
            settings = config.fault.get(f"{reporter.name}.{fault.name}")
            dtc = (settings and settings.dtc) or fault.dtc
            owner = codes.setdefault(dtc, f"{key}.fault[{j}]")
            if owner != f"{key}.fault[{j}]":
                text = f"{owner} has this DTC; give one of them another"
                yield InputError(text, key=f"{key}.fault[{j}].dtc", value=dtc)
    if config.status is not None and config.status.socket == Path(config.report.socket):
        yield InputError("this is the status socket", key="report.socket", value=config.report.socket)


def _checks(config: Config) -> Iterator[InputError]:
    for k, bus in enumerate(config.bus):
        watched = [check.message for check in bus.check]
        for j, message in enumerate(watched):
            if message in watched[:j]:
                yield InputError(
                    "this message has its checks already",
                    key=f"bus[{k}].check[{j}].message",
                    value=message,
                )
    yield from _shared_codes(config)


def _shared_codes(config: Config) -> Iterator[InputError]:
    """Yield checks that have the DTCs of one before; the catalogue judges the settings of single faults."""
    first: dict[str, str] = {}
    messages: set[str] = set()
    for k, bus in enumerate(config.bus):
        for j, check in enumerate(bus.check):
            faults = f"{bus.name}.{check.message}."
            if faults in messages:
                continue
            messages.add(faults)
            if bus.codes == "own" or any(name.startswith(faults) for name in config.fault):
                continue
            key = f"bus[{k}].check[{j}]"
            asked = {"lost": check.timeout_ms is not None, "invalid": check.length}
            codes = [getattr(check, what) for what in asked if asked[what] and what not in check.model_fields_set]
            shared = [code for code in codes if code in first]
            for code in codes:
                first.setdefault(code, key)
            if shared:
                text = (
                    f"{first[shared[0]]} has the DTCs {' and '.join(shared)}, too: give lost and invalid, or "
                    'the bus codes = "own"'
                )
                yield InputError(text, key=key, value=check.message)


def _outputs(config: Config) -> Iterator[InputError]:
    for name, output in config.output.tables.items():
        if not hasattr(output, "bus"):
            continue
        try:
            with under(f"output.{name}.bus", output.bus):
                config.bus_index(output.bus)
        except InputError as error:
            yield error
    named = {bus.name for bus in config.bus}
    uds = config.output.uds
    for name, (_, other) in config.output.applications.items():
        servers = [entry for entry in (uds, other) if entry is not None]
        if all(entry.bus in named or (entry.bus is None and len(named) == 1) for entry in servers):
            try:
                config.address_is_shared(name)
            except InputError as error:
                yield error


def _servers_of_others(config: Config) -> Iterator[InputError]:
    try:
        _ = config.servers
    except (InputError, InputErrors) as error:
        yield from each_of(error)


def _needed_tables(config: Config) -> Iterator[InputError]:
    """Tables of outputs that others need are there."""
    for name, (one, _) in config.output.sections.items():
        for other, why in one.needs.items():
            if other not in config.output.tables:
                yield InputError(f"this needs the table [output.{other}]: {why}", key=f"output.{name}")


def _routes(config: Config) -> Iterator[InputError]:
    """Routes go to ECUs that there are, on other buses that may be asked, and have identifiers of their own."""
    named = {ecu.name: ecu for ecu in config.ecu}
    by_bus = dict(_bus_routes(config))
    routes = {key: route.ecu for key, (route, _) in by_bus.items()}
    for name, (one, params) in config.output.sections.items():
        routes |= {f"output.{name}.{key}": ecu for key, ecu in one.routes(params).items()}
    for key, ecu in routes.items():
        if ecu not in named:
            there = f"the ECUs are {', '.join(named) or 'none'}{nearest(ecu, named)}"
            yield InputError(there, key=f"{key}.ecu", value=ecu)
            continue
        bus = _index(config, named[ecu].bus)
        if bus is not None and config.bus[bus].listen_only:
            text = "its bus is only listened to, and takes no requests"
            yield InputError(text, key=f"{key}.ecu", value=ecu)
        if bus is not None and key in by_bus and bus == _index(config, by_bus[key][1]):
            text = "this ECU is on the testers' own bus, where they reach it without a route"
            yield InputError(text, key=f"{key}.ecu", value=ecu)
    yield from _identifiers_of_routes(config)


def _bus_routes(config: Config) -> Iterator[tuple[str, tuple[BusRouteParams, str | None]]]:
    """Yield each route from bus to bus by its key, and the bus of its testers."""
    for k, own in enumerate(() if config.output.uds is None else config.output.uds.each_address):
        for j, route in enumerate(own.route):
            yield f"output.uds{f'.further[{k - 1}]' if k else ''}.route[{j}]", (route, own.bus)


def _identifiers_of_routes(config: Config) -> Iterator[InputError]:
    """Yield routes with an identifier that another one has, an ECU of that bus, or the gateway itself."""
    taken: list[tuple[int | None, int, int | None, str]] = []
    for key, server in _servers(config):
        ids = (server.request, server.response, server.functional)
        taken += [
            (_index(config, server.bus), can_id | server.flags, None, key) for can_id in ids if can_id is not None
        ]
    for k, ecu in enumerate(config.ecu):
        bus, place = _index(config, ecu.bus), ecu.place
        taken += [(bus, place.request, place.target, f"ecu[{k}]"), (bus, place.response, place.tester, f"ecu[{k}]")]
    for key, (route, name) in _bus_routes(config):
        bus, place = _index(config, name), route.place
        keys = ("address", "address") if route.address is not None else ("request", "response")
        asked = ((keys[0], place.request, place.target), (keys[1], place.response, place.tester))
        for what, can_id, address in asked:
            owners = (
                owner
                for other, number, byte, owner in taken
                if (other, number) == (bus, can_id) and (byte == address or None in (byte, address))
            )
            for owner in islice(owners, 1):
                text = f"{owner} has this identifier on this bus"
                yield InputError(text, key=f"{key}.{what}", value=f"0x{can_id & ID_MASK:X}")
        taken += [(bus, can_id, address, key) for _, can_id, address in asked]


def _servers(config: Config) -> Iterator[tuple[str, IsoTpParams]]:
    """Yield each address of our diagnostic servers by its key."""
    uds = config.output.uds
    for name, (_, params) in config.output.applications.items():
        yield f"output.{name}", params
    for k, each in enumerate(() if uds is None else uds.each_address):
        yield f"output.uds.further[{k - 1}]" if k else "output.uds", each


def _addresses(config: Config) -> Iterator[InputError]:
    """Each address of a diagnostic server has identifiers of its own, on its bus."""
    uds = config.output.uds
    if uds is None or not uds.further:
        return
    others = [params for _, params in config.output.applications.values()]
    taken: dict[tuple[str | None, int], str] = {}
    first = config.bus[0].name if len(config.bus) == 1 else None
    for entry in (uds, *others):
        for number in (entry.request, entry.response, entry.functional):
            if number is not None:
                taken[entry.bus or first, number] = "the first address"
    named = {bus.name for bus in config.bus}
    for k, further in enumerate(uds.further):
        key = f"output.uds.further[{k}]"
        if further.bus not in named and not (further.bus is None and len(named) == 1):
            text = f"the buses are {', '.join(sorted(named))}"
            yield InputError(text, key=f"{key}.bus", value=further.bus or "(no bus named)")
            continue
        for name in ("request", "response", "functional"):
            number = getattr(further, name)
            if number is None:
                continue
            owner = taken.setdefault((further.bus or first, number), key)
            if owner != key:
                yield InputError(f"{owner} has this identifier", key=f"{key}.{name}", value=f"0x{number:X}")


def _access(config: Config) -> Iterator[InputError]:
    uds = config.output.uds
    for name in () if uds is None else uds.rules:
        if getattr(config.access, name) is not None:
            yield InputError(f"output.uds.{name} says this already; take one of them out", key=f"access.{name}")
    for name, (one, params) in config.output.sections.items():
        for what, (key, _) in one.allows(params).items():
            rule = getattr(config.access, what)
            if rule is not None and rule.allowed is not None:
                text = f"output.{name}.{key} says this already; take one of them out"
                yield InputError(text, key=f"access.{what}.allowed")
    for k, did in enumerate(config.did):
        if did.id == config.access.trace_did:
            text = "this identifier reads what testers did; give access.trace_did another number"
            yield InputError(text, key=f"did[{k}].id", value=f"0x{did.id:04X}")
    own = () if uds is None else uds.rules
    yield from wrong_rules(config.access_rules, config.security_levels, config.roles, own)


def _cycles(config: Config) -> Iterator[InputError]:
    if POWER in config.cycle:
        yield InputError("this cycle is always there: the gateway's run", key=f"cycle.{POWER}")
    cycles = {POWER, *config.cycle}
    known = ", ".join(sorted(cycles))
    if config.usage is not None and config.usage.cycle not in cycles:
        asked = config.usage.cycle
        yield InputError(f"the cycles are {known}{nearest(asked, cycles)}", key="usage.cycle", value=asked)
    for fault, settings in config.fault.items():
        for key in ("cycle", "aging_cycle"):
            cycle = getattr(settings, key)
            if cycle is not None and cycle not in cycles:
                yield InputError(f"the cycles are {known}", key=f'fault."{fault}".{key}', value=cycle)


def _index(config: Config, name: str | None) -> int | None:
    """Return the index of a bus that is configured; None: there is none of that name."""
    names = [bus.name for bus in config.bus]
    if name is None and len(names) == 1:
        return 0
    return names.index(name) if name in names else None


def _ecus(config: Config) -> Iterator[InputError]:
    """ECUs that are asked are on buses that there are, at addresses of their own, which are none of ours."""
    ours = {
        (_index(config, server.bus), can_id | server.flags): key
        for key, server in _servers(config)
        for can_id in (server.request, server.response)
    }
    taken: dict[tuple[object, ...], str] = {}
    for k, ecu in enumerate(config.ecu):
        key, place, bus = f"ecu[{k}]", ecu.place, _index(config, ecu.bus)
        if bus is None:
            known = ", ".join(each.name for each in config.bus)
            yield InputError(f"the buses are {known}", key=f"{key}.bus", value=ecu.bus or "(no bus named)")
            continue
        keys = ("address", "address") if ecu.address is not None else ("request", "response")
        for name, can_id in zip(keys, (place.request, place.response), strict=True):
            if (bus, can_id) in ours:
                text = f"this is the gateway itself: {ours[bus, can_id]} has this identifier"
                yield InputError(text, key=f"{key}.{name}", value=f"0x{can_id & 0x1FFFFFFF:X}")
        owner = taken.setdefault((bus, place.response, place.tester), key)
        if owner != key:
            text = f"{owner} answers with this identifier"
            yield InputError(text, key=f"{key}.{keys[1]}", value=f"0x{place.response & 0x1FFFFFFF:X}")


def _faults_of_ecus(config: Config) -> Iterator[InputError]:
    """Names of ECUs with faults, and of these faults, are theirs alone."""
    taken = {"gateway", *(bus.name for bus in config.bus), *(monitor.name for monitor in config.monitor)}
    taken |= set() if config.report is None else {reporter.name for reporter in config.report.reporter}
    for k, ecu in enumerate(config.ecu):
        if ecu.fault and ecu.name in taken:
            yield InputError("ids of its faults begin so, and this name is taken", key=f"ecu[{k}].name", value=ecu.name)
        names = [fault.name for fault in ecu.fault]
        for j, name in enumerate(names):
            if name in names[:j]:
                yield InputError("this name is taken", key=f"ecu[{k}].fault[{j}].name", value=name)


def _only_listened_to(config: Config) -> Iterator[InputError]:
    """Nothing of the configuration sends on a bus that is only listened to."""
    output = config.output
    senders = [(f"output.{name}", params) for name, params in output.tables.items() if hasattr(params, "bus")]
    senders += [] if output.uds is None else [(f"output.uds.further[{k}]", e) for k, e in enumerate(output.uds.further)]
    senders += [(f"monitor[{k}]", entry) for k, entry in enumerate(config.monitor) if entry.send]
    senders += [(f"server[{k}]", entry) for k, entry in enumerate(config.server)]
    for key, sender in senders:
        bus = None if sender is None else _index(config, sender.bus)
        if bus is not None and config.bus[bus].listen_only:
            text = "this sends on a bus that is only listened to; take it out, or listen_only of the bus"
            yield InputError(text, key=key, value=config.bus[bus].name)
