"""``gateway check``: is a configuration right?"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from gateway.bus.frames import ID_MASK
from gateway.cli.present import find_config, print_json
from gateway.config.load import load_config
from gateway.config.model import Config
from gateway.config.monitor_types import monitor_of
from gateway.host.process import open_to_others
from gateway.monitors.contract import Monitor
from gateway.runtime.app import Gateway
from gateway.servers.access import ROUTE
from gateway.servers.access_review import ways_around
from gateway.servers.access_table import bus_reach, routes_around
from gateway_commands.configuration_schema import schema
from gateway_commands.doctor import no_socketcan
from gateway_commands.self_test import refuse_failing
from gateway_commands.validation import mistakes
from gateway_fdi.errors import InputError, InputErrors, each_of

#: Columns that are left for a name after the codes given out for it, of 80.
_MOST_OF_NAME = 65
#: Lines about faults and codes that are printed without being asked for; kinds of faults of one monitor.
MOST_LISTED, MOST_KINDS = 50, 4


def check(config_path: Path | None, *, schema_wanted: bool, json: bool, listed: bool = False) -> int:
    """Check a configuration; returns the exit code. Above :data:`MOST_LISTED` lines it counts, unless all is listed."""
    if schema_wanted:
        print_json(schema(), indent=2)
        return 0
    path = find_config(config_path)
    try:
        config = load_config(path)
        gateway = Gateway(config, None, file=path)
        for instance in gateway.engine.monitors:
            if instance.monitor.outside:
                refuse_failing(instance.monitor, instance.params)
        types = [(entry.name, *monitor_of(entry)) for entry in config.monitor]
        warnings = [f"{name}: {text}" for name, monitor, params in types for text in monitor.warnings(params)]
        told = {name: list(found) for name, monitor, params in types if (found := monitor.notes(params))}
    except (InputError, InputErrors) as error:
        errors = mistakes(path) or each_of(error)
        if not json:
            raise (errors[0] if len(errors) == 1 else InputErrors(errors)) from error
        print_json({"ok": False, "errors": [as_dict(each) for each in errors]})
        return 2
    faults = [{"fault": d.id, "dtc": str(d.dtc), "description": d.description} for d in gateway.catalogue]
    notes, codes = list(gateway.notes), dict(sorted(gateway.codes.items()))
    warnings += [*gateway.unread, *gateway.parts.forgeable]
    gateway.close()
    warnings += [
        f"{name}: {text}"
        for (name, monitor, _), entry in zip(types, config.monitor, strict=True)
        if entry.trusted
        for text in _trusted_in_vain(monitor)
    ]
    warnings += _ways_around(config)
    reached, around = _reached(config)
    warnings += around
    warnings += secrets_shown(config, path)
    warnings += _of_this_machine(config)
    if json:
        print_json(
            {
                "ok": True,
                "faults": faults,
                "codes": codes,
                "taken": notes,
                "told": told,
                "reached": reached,
                "warnings": warnings,
                "asked": list(asked_of(config)),
            }
        )
    else:
        print(f"{path}: good. {len(config.bus)} bus(es), {len(config.monitor)} monitor(s), {len(faults)} faults")
        for text in warnings:
            print(f"warning: {text}")
        is_short = not listed and len(faults) + len(codes) + len(notes) > MOST_LISTED
        for text in _counted(path, faults, codes, notes) if is_short else _listed(faults, codes, notes):
            print(text)
        for text in asked_of(config):
            print(text)
        for name, lines in (told | reached).items():
            print(f"{name}:", *lines, sep="\n  ")
    return 0


def _listed(faults: list[dict[str, str]], codes: dict[str, tuple[str, ...]], notes: list[str]) -> Iterator[str]:
    """Yield each fault, each code given out, and each thing that was taken, one line each."""
    for fault in faults:
        yield f"  {fault['dtc']}  {fault['fault']}: {fault['description']}"
    if codes:
        yield "codes given out (of messages: missing, and wrong):"
    for name, given in codes.items():
        yield f"  {' '.join(given):<11}  {_shortened(name)}"
    for text in notes:
        yield f"taken: {text}"


def _counted(
    path: Path, faults: list[dict[str, str]], codes: dict[str, tuple[str, ...]], notes: list[str]
) -> Iterator[str]:
    """Yield how many faults of each kind each bus and each monitor has, and how many codes were given out."""
    kinds: dict[str, Counter[str]] = defaultdict(Counter)
    for fault in faults:
        owner, _, kind = fault["fault"].partition(".")
        kinds[owner][kind.rpartition(".")[2]] += 1
    for owner, count in kinds.items():
        common = {kind: number for kind, number in count.most_common(MOST_KINDS) if number > 1}
        rest = count.total() - sum(common.values())
        parts = [f"{kind} {number}" for kind, number in common.items()]
        yield f"  {count.total():>5}  {_shortened(owner)}: {', '.join([*parts, *([f'others {rest}'] if rest else [])])}"
    of = [
        f"{number} {text}" for number, text in ((len(codes), "codes given out"), (len(notes), "things taken")) if number
    ]
    yield f"Each fault{', '.join(['', *of])}: gateway check {path} --all"


def _reached(config: Config) -> tuple[dict[str, list[str]], list[str]]:
    """Return who reaches what by DoIP and by routes from bus to bus, by title, and ways around the rules of both."""
    uds, need, sections = config.output.uds, config.needs[ROUTE], config.output.sections
    found = {f"by {one.title}": list(one.reach(params, need)) for name, (one, params) in sections.items()}
    addresses = [] if uds is None else uds.each_address
    by_bus = [line for each in addresses for line in bus_reach(each, config.bus[config.bus_index(each.bus)].name, need)]
    around = [line for one, params in sections.values() for line in one.ways_around(params)]
    routed = by_bus or any(one.routes(params) for one, params in sections.values())
    found["by routes from bus to bus"] = by_bus
    return {title: lines for title, lines in found.items() if lines}, around + list(
        routes_around(need) if routed else ()
    )


def asked_of(config: Config) -> Iterator[str]:
    """Yield which ECUs are asked for what, one line each."""
    for ecu in config.ecu:
        bus = config.bus[config.bus_index(ecu.bus)]
        silent = "; the bus is only listened to: nothing is asked" if bus.listen_only else ""
        reads = [f"{read.name} {read.rate}" for read in ecu.read]
        dtcs = [] if ecu.dtcs is None else [f"DTCs ({ecu.dtc_protocol}) every {ecu.dtcs.every_s:g} s"]
        place = ecu.place
        ids = f"0x{place.request & ID_MASK:X}, 0x{place.response & ID_MASK:X}"
        asked = ", ".join([*reads, *dtcs]) or "nothing; its answers to others are heard"
        yield f"asks {ecu.name} ({ids}) on {bus.name}: {asked}{silent}"


def as_dict(error: InputError) -> dict[str, Any]:
    """Return an error as JSON has it."""
    value = None if error.value is None else str(error.value)
    return {"file": error.file, "line": error.line, "key": error.key, "value": value, "message": error.message}


def _trusted_in_vain(monitor: Monitor[Any]) -> Iterator[str]:
    """Yield why ``trusted = true`` of a configuration has no effect on a monitor."""
    if not monitor.outside:
        yield "trusted = true has no effect: monitors of the gateway's own are trusted in any case"
    elif not monitor.trusted:
        yield f"trusted = true has no effect: its author does not say Monitor(..., trusted=True) in {monitor.file}"


def _shortened(name: str) -> str:
    """Return a name that fits into a line of 80 columns, its middle left out where it does not."""
    kept = (_MOST_OF_NAME - 3) // 2
    return name if len(name) <= _MOST_OF_NAME else f"{name[:kept]}...{name[-kept:]}"


def secrets_shown(config: Config, path: Path) -> list[str]:
    """Return whether anybody can read the secrets of security levels."""
    uds = config.output.uds
    if uds is None or not uds.security or not open_to_others(path, 0o044):
        return []
    return [f"output.uds.security: others on this machine can read these secrets: chmod 600 {path}"]


def _ways_around(config: Config) -> list[str]:
    """Return how an intervention is easier than it looks."""
    output = config.output
    there = {name: getattr(output, name, None) is not None for name in ("uds", "obd", "j1939")}
    said = list(ways_around(config.needs, config.security_levels, **there))
    if config.access.local_unlocked and any(need.is_locked for need in config.needs.values()):
        said.append("access.local_unlocked: every user who may open the status socket needs no key and no role")
    return said + ([] if output.uds is None else output.uds.weak_levels())


def _of_this_machine(config: Config) -> list[str]:
    """Return what would end or surprise a gateway here, though the configuration is right."""
    said = []
    lacking = no_socketcan()
    for k, bus in enumerate(config.bus):
        if lacking and bus.uri.startswith("socketcan:"):
            said.append(f"bus[{k}].uri = {bus.uri!r}: gateway run ends here: {lacking}")
    for j, reporter in enumerate(() if config.report is None else config.report.reporter):
        strangers = reporter.strangers()
        if strangers:
            said.append(f"report.reporter[{j}]: this machine has no {', no '.join(strangers)}")
    folders = [("memory.path", config.memory.path.parent)]
    if config.record is not None:
        folders.append(("record.folder", config.record.folder))
    said += [
        f"{key}: the folder {folder.resolve()} is not there; gateway run makes it"
        for key, folder in folders
        if not folder.exists()
    ]
    return said
