"""From a resolved configuration to the gateway's parts: engine, catalogue, servers. No name is looked up here."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from gateway.common.calls import call_of
from gateway.common.fence import Fence
from gateway.common.gc_pause import gc_paused
from gateway.config.answer_bus import AnswerBus
from gateway.config.model import Config
from gateway.config.resolve import Resolved, resolve
from gateway.engine.build import build_engine
from gateway.engine.checks import own_health
from gateway.engine.checks.communication import CheckInstance
from gateway.engine.core import Engine
from gateway.engine.depends.derive import dependences
from gateway.engine.depends.parts import Seen
from gateway.engine.depends.residuals import Read
from gateway.engine.depends.underlying_tests import Tests
from gateway.engine.events import NO_BUS
from gateway.engine.gate import Gate
from gateway.engine.instances import FaultSlot, MonitorInstance
from gateway.faults.catalogue import Catalogue, FaultDefinition, define
from gateway.faults.interventions import encode
from gateway.faults.memory import FaultMemory
from gateway.faults.settings import FaultOverride
from gateway.isotp.endpoint import IsoTpEndpoint
from gateway.isotp.params import IsoTpParams
from gateway.runtime.asking import ASKING, Asking
from gateway.servers.application import Application
from gateway.servers.authority import Authority
from gateway.servers.bus_route import BusRoute
from gateway.servers.bus_server import BusServer
from gateway.servers.bus_servers import BusServers
from gateway.servers.diagnostic_server import DiagnosticServer
from gateway.servers.dtc_frame import DtcFrameSender
from gateway.servers.identifiers import Identifiers
from gateway.servers.local import LONGEST_ANSWER, LocalServer
from gateway.servers.section import NO_BUS as WITHOUT_BUS
from gateway.servers.section import Surroundings
from gateway.servers.tester_control import TesterControl
from gateway.servers.uds.authentication import Authentication
from gateway.servers.uds.intervention_memory import NUMBERS
from gateway.servers.uds.params import UdsParams
from gateway.servers.uds.security import Security
from gateway.servers.uds.server import UdsServer
from gateway.servers.uds.testers import Testers
from gateway.signals.database import Database
from gateway.signals.reassembly import woven_of
from gateway_fdi.common.resources import shipped
from gateway_fdi.errors import InputError, InputErrors, named


@dataclass(frozen=True)
class Parts:
    """Parts of a gateway, before its fault memory is opened.

    Attributes:
        databases: of each bus.
        engine: compiled.
        catalogue: the faults, in the engine's order.
        frozen: fault id -> signals of its freeze frame, by the names they are stored under.
        slots: mailbox slots of all signals that a name outside the engine stands for.
        live: monitor and value of all names that stand for a live value.
        cycles: names of the operation cycles, in the engine's order.
        answers: buses of ECUs' answers.
        security: of the UDS server; its key functions have been found.
        authentication: of the UDS server; its roots have been read.
        opened: table of outputs -> what its section has read of files.
        checks: of messages, in the engine's order.
        notes: choices where the configuration leaves it to the databases.
        forgeable: conditions of access that frames of others meet, one line each.
        codes: base codes of DTCs given out, by message, signal or relation.
        depends: fault id -> what its test sees, the component that it sees best first.
        residuals: fault id -> what reads its signed residual, of those that have one.
        behind: tests that faults are made of.
    """

    databases: tuple[Database, ...]
    engine: Engine
    catalogue: Catalogue
    frozen: dict[str, tuple[str, ...]]
    slots: dict[str, int]
    live: Mapping[str, tuple[str, str]]
    cycles: tuple[str, ...]
    answers: tuple[AnswerBus, ...]
    security: Security
    authentication: Authentication
    opened: Mapping[str, Any]
    checks: tuple[CheckInstance, ...]
    notes: tuple[str, ...]
    forgeable: tuple[str, ...]
    codes: Mapping[str, tuple[str, ...]]
    depends: Mapping[str, tuple[Seen, ...]]
    residuals: Mapping[str, Read]
    behind: tuple[Tests, ...]


@gc_paused()
def prepare(config: Config, file: Path | None = None, *, extra: Collection[str] = ()) -> Parts:
    """Build what needs no fault memory; may be done in a thread beside a running gateway.

    Args:
        config: the configuration.
        file: where it was read, for errors.
        extra: names of signals that are to be decoded beside those that it needs.

    Raises:
        InputError, InputErrors: a database, message, signal or fault that is wrong.
    """
    try:
        return assemble(resolve(config, extra=extra))
    except InputError as error:
        raise error.within(file) from error
    except InputErrors as errors:
        raise InputErrors([error.within(file) for error in errors.errors]) from errors


def assemble(resolved: Resolved) -> Parts:
    """Build everything that needs no fault memory.

    Raises:
        InputError, InputErrors: a signal or fault that is wrong.
    """
    engine = _engine(resolved)
    _refuse_unknown(resolved.config, engine)
    catalogue = Catalogue([_definition(resolved, slot) for slot in engine.faults])
    asked, shown = resolved.freeze_frames, resolved.shown
    return Parts(
        resolved.databases,
        engine,
        catalogue,
        {
            definition.id: _unique([*asked.get(definition.id, ()), *(shown if definition.emission_related else ())])
            for definition in catalogue
        },
        {name: engine.plan.slot(*ref) for name, ref in resolved.signals.items()},
        resolved.live,
        tuple(resolved.cycles),
        resolved.answers,
        resolved.security,
        resolved.authentication,
        resolved.opened,
        resolved.checks,
        resolved.notes,
        resolved.forgeable,
        resolved.codes,
        *dependences(
            engine.faults,
            resolved.databases,
            resolved.monitors,
            resolved.checks,
            resolved.buses,
            resolved.config.diagnosis,
        ),
    )


def _engine(resolved: Resolved) -> Engine:
    config = resolved.config
    return build_engine(
        tuple(enumerate(resolved.databases)),
        resolved.monitors,
        resolved.checks,
        debounces=resolved.debounces,
        gates=resolved.gates,
        cycles=tuple(resolved.cycles.values()),
        extra=set(resolved.signals.values()),
        pgn=[index for index, bus in enumerate(config.bus) if bus.match == "pgn"],
        buses=resolved.buses,
        clock=config.clock,
        reported=[*_reported_faults(config), *_faults_of_ecus(config), *_own_faults(config, resolved.monitors)],
    )


def _refuse_unknown(config: Config, engine: Engine) -> None:
    known = {slot.id for slot in engine.faults}
    unknown = [fault for fault in config.fault if fault not in known]
    if unknown:
        raise InputErrors(
            [
                InputError(
                    named("no monitor reports this fault; known:", fault, known),
                    key=f'fault."{fault}"',
                )
                for fault in unknown
            ]
        )


def _own_faults(config: Config, monitors: Iterable[MonitorInstance]) -> list[FaultSlot]:
    """Return the faults of the gateway itself, on its first bus."""
    watched = {
        own_health.NOT_WRITTEN: config.memory.watched,
        own_health.DAMAGED: config.memory.watched,
        own_health.RESTARTED: config.memory.watched,
        own_health.MONITORING_OFF: config.access.watched,
        own_health.SWITCHED_OFF: any(instance.monitor.outside for instance in monitors),
        own_health.REPORTER_LOST: config.report is not None,
        own_health.EXCEPTIONS: config.has_doors,
    }
    return [FaultSlot(f"{own_health.OWNER}.{fault.name}", fault, 0) for fault in own_health.FAULTS if watched[fault]]


def _reported_faults(config: Config) -> list[FaultSlot]:
    """Return the faults that other processes test; they are of no bus."""
    reporters = () if config.report is None else config.report.reporter
    return [FaultSlot(f"{each.name}.{fault.name}", fault.fault, NO_BUS) for each in reporters for fault in each.fault]


def _faults_of_ecus(config: Config) -> list[FaultSlot]:
    """Return the faults that stand for DTCs of other ECUs; each is of the ECU's bus."""
    return [
        FaultSlot(f"{config.ecu[k].name}.{fault.name}", fault.fault, bus)
        for bus, ecus in config.answered.items()
        for k in ecus
        for fault in config.ecu[k].fault
    ]


def _definition(resolved: Resolved, slot: FaultSlot) -> FaultDefinition:
    """Return a fault's definition.

    Raises:
        InputError: its DTC is none; with the file of the monitor that has it.
    """
    causes = resolved.gates.get(slot.id, Gate()).roots
    try:
        return define(slot.id, slot.fault, _settings(resolved.config, slot), caused_by=causes)
    except InputError as error:
        name = slot.id.rpartition(".")[0]
        for monitor in (instance.monitor for instance in resolved.monitors if instance.name == name):
            key = f'monitor type "{monitor.type}".faults: {slot.fault.name}.dtc'
            raise InputError(error.message, file=monitor.file, key=key, value=error.value) from error
        raise


def _settings(config: Config, slot: FaultSlot) -> FaultOverride | None:
    """Return what the configuration sets of a fault; one of the gateway itself is none of the vehicle's."""
    settings = config.fault.get(slot.id)
    if slot.id != f"{own_health.OWNER}.{slot.fault.name}" or slot.fault not in own_health.FAULTS:
        return settings
    asked = {} if settings is None else settings.model_dump(exclude_unset=True)
    own = {"emission_related": False, "priority": own_health.PRIORITY}
    return FaultOverride.model_validate({**own, **asked})


def _unique(names: Iterable[str]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(names))


def identifiers_of(config: Config, parts: Parts, memory: FaultMemory, control: TesterControl) -> Identifiers:
    """Return the table of data identifiers, with those of the freeze frames' signals."""
    named = {did.name for did in config.did}
    frozen = {name for names in parts.frozen.values() for name in names} - named
    made = Identifiers(config.did, frozen, control.value, memory.identifiers, memory.write_identifier)
    if config.access.trace_did is not None:
        made.serve(config.access.trace_did, "interventions", lambda: encode(memory.interventions(), NUMBERS))
    return made


def _bus_name(config: Config, name: str | None) -> str:
    return config.bus[config.bus_index(name)].name


def _local_server(config: Config, testers: Testers) -> LocalServer:
    """Build the server of this machine's testers; without ``[output.uds]`` with its defaults: no key, no role."""
    uds = config.output.uds or UdsParams()

    def new_tester(name: str, source: int) -> UdsServer:
        own = uds.model_copy(update={"bus": None, "request": source, "functional": None})
        return testers.server(own, name, longest=LONGEST_ANSWER)

    return LocalServer(new_tester)


def connect_routes(servers: BusServers, asking: Asking) -> None:
    """Give the servers that have routes the lines to their ECUs."""
    for server in servers.all:
        server.connect_routes(asking, partial(servers.wake, server))


def _diagnostic_servers(config: Config, testers: Testers, others: Mapping[str, Application]) -> list[BusServer]:
    """Build what is on ISO-TP: UDS, with those that share its first address; each further address; others alone."""
    made: list[BusServer] = []

    def server(params: IsoTpParams, uds: UdsServer | None, others: Sequence[Application]) -> None:
        made.append(DiagnosticServer(IsoTpEndpoint(params, config.bus_index(params.bus)), uds, others))

    sharing = [name for name in others if config.address_is_shared(name)]
    for k, params in enumerate(() if config.output.uds is None else config.output.uds.each_address):
        uds = testers.server(params, _bus_name(config, params.bus))
        for route in params.route:
            place = route.place
            address = None if place.target is None or place.tester is None else (place.target, place.tester)
            endpoint = IsoTpEndpoint(route.transport(params), config.bus_index(params.bus), address)
            made.append(BusRoute(route, endpoint, uds))
        server(params, uds, [] if k else [others[name] for name in sharing])
    for name, (_, own) in config.output.applications.items():
        if name not in sharing:
            server(own, None, [others[name]])
    return made


def _place_of(config: Config, params: Any) -> tuple[int, str]:
    """Return index and name of the bus of a section."""
    if not hasattr(params, "bus"):
        return WITHOUT_BUS, ""
    bus = config.bus_index(params.bus)
    return bus, config.bus[bus].name


def servers_of(
    config: Config,
    parts: Parts,
    memory: FaultMemory,
    authority: Authority,
    identifiers: Identifiers,
) -> list[BusServer]:
    """Build what is on the buses on the gateway's behalf."""
    made: list[BusServer] = []
    asked, control = config.output, authority.control
    if asked.dtc_frame is not None:
        made.append(
            DtcFrameSender(
                asked.dtc_frame,
                shipped("dbc/gateway.dbc"),
                config.bus_index(asked.dtc_frame.bus),
                memory,
                control.fault_detection_counter,
            )
        )
    trace = config.access.trace_did
    testers = Testers(memory, identifiers, authority, parts.security, parts.authentication, trace)
    uds, found = config.output.uds, config.output.sections
    around = {
        name: Surroundings(*_place_of(config, own), memory, identifiers, authority, testers, uds, parts.opened[name])
        for name, (_, own) in found.items()
    }
    applications = {
        name: one.application(params, around[name]) for name, (one, params) in config.output.applications.items()
    }
    made += _diagnostic_servers(config, testers, applications)
    others = (one.server(params, around[name]) for name, (one, params) in found.items())
    made += [server for server in others if server is not None]
    made += [server.made(memory, identifiers, authority) for server in config.servers]
    return [*made, _local_server(config, testers)]


def asking_of(
    config: Config, parts: Parts, control: TesterControl, may_ask: Callable[[int], bool], fence: Fence
) -> Asking:
    """Build the clients of other ECUs, by the package that has them.

    Args:
        config: the configuration.
        parts: of it.
        control: judges conditions.
        may_ask: whether a bus may be asked now, by its index.
        fence: counts exceptions that answers cause.
    """
    if not config.answered:
        return Asking(woven_of(parts.engine.plan), fence)
    made: Asking = call_of(ASKING)(config, parts, control, may_ask, fence)
    return made
