"""From a configuration to the gateway's parts: databases, engine, catalogue, ways out."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import Any

from cantools.database.can import Message

from gateway.common.resources import shipped
from gateway.config.model import Config, MonitorConfig, monitor_of
from gateway.engine.build import BusInstance, CheckInstance, MonitorInstance, build_engine
from gateway.engine.checks import memory_health
from gateway.engine.core import Engine, FaultSlot
from gateway.engine.gate import Condition, CycleWatch, Gate
from gateway.errors import InputError, InputErrors
from gateway.faults.catalogue import Catalogue, debounce_of, define
from gateway.faults.memory import FaultMemory
from gateway.faults.settings import POWER, ConditionSettings, FaultOverride
from gateway.monitors.conformance import checked_emission
from gateway.monitors.contract import Monitor, MonitorParams
from gateway.servers.bus_server import BusServer
from gateway.servers.diagnostic_server import DiagnosticServer
from gateway.servers.dtc_frame import DtcFrameSender
from gateway.servers.identifiers import Identifiers
from gateway.servers.isotp.endpoint import IsoTpEndpoint
from gateway.servers.isotp.params import IsoTpParams
from gateway.servers.j1939.endpoint import J1939Endpoint
from gateway.servers.j1939.server import J1939Server
from gateway.servers.obd.server import ObdServer
from gateway.servers.tester_control import TesterControl
from gateway.servers.uds.context import Context
from gateway.servers.uds.security import Security
from gateway.servers.uds.server import UdsServer
from gateway.signals.database import Database, load_database
from gateway.signals.tables import SignalRef

#: Databases of messages that the gateway itself sends.
OWN_DATABASES = ("dbc/gateway.dbc", "dbc/pedal.dbc")


@dataclass(frozen=True)
class Parts:
    """What a gateway is made of, before its fault memory is opened.

    Attributes:
        databases: (bus index, database) pairs.
        engine: compiled.
        catalogue: the faults, in the engine's order.
        frozen: fault id -> signals of its freeze frame, by the names they are stored under.
        slots: mailbox slots of all signals that a name outside the engine stands for.
        cycles: names of the operation cycles, in the engine's order.
        security: of the UDS server; its key functions have been found.
    """

    databases: list[tuple[int, Database]]
    engine: Engine
    catalogue: Catalogue
    frozen: dict[str, tuple[str, ...]]
    slots: dict[str, int]
    cycles: tuple[str, ...]
    security: Security


def load_databases(config: Config, file: Path | None = None) -> list[tuple[int, Database]]:
    """Load the databases of every bus.

    Raises:
        InputErrors: every database that cannot be loaded.
    """
    loaded, wrong = [], []
    for index, bus in enumerate(config.bus):
        try:
            loaded.append((index, load_database(bus.database)))
        except InputError as error:
            wrong.append(error)
        except InputErrors as errors:
            wrong += errors.errors
    if wrong:
        raise InputErrors(wrong)
    return loaded


class _Names:
    """Finds the signals that names in a configuration stand for."""

    def __init__(self, config: Config, databases: Mapping[int, Database]) -> None:
        self._config = config
        self._databases = databases
        self._identifiers = {did.name: did for did in config.did}
        self.found: dict[str, SignalRef] = {}

    def find(self, name: str, key: str) -> SignalRef:
        """Return a signal by ``bus.Message.Signal``, or ``Message.Signal`` of the first bus that has it.

        Raises:
            InputError: there is none; names the key.
        """
        if name not in self.found:
            try:
                self.found[name] = self._resolve(name)
            except InputError as error:
                raise InputError(error.message, key=key, value=name) from error
        return self.found[name]

    def _resolve(self, name: str) -> SignalRef:
        did = self._identifiers.get(name)
        if did is not None:
            if did.signal is None:
                raise InputError("this identifier is no signal, and never changes", value=name)
            name = did.signal
        parts = name.split(".")
        if len(parts) not in (2, 3):
            raise InputError('a signal is named "Message.Signal" or "bus.Message.Signal"')
        message, signal = parts[-2:]
        if len(parts) == 3:
            buses = [self._config.bus_index(parts[0])]
        else:
            having = [k for k in self._databases if self._has(k, message)]
            buses = having or list(self._databases)
        self._databases[buses[0]].signal(message, signal)
        return SignalRef(buses[0], message, signal)

    def _has(self, bus: int, message: str) -> bool:
        return any(known.name == message for known in self._databases[bus])

    def condition(self, settings: ConditionSettings, key: str) -> Condition:
        """Return a condition of the configuration for the engine."""
        low = float("-inf") if settings.min is None else settings.min
        high = float("inf") if settings.max is None else settings.max
        return Condition(self.find(settings.signal, f"{key}.signal"), low, high, settings.rise)


def _emission(
    entry: MonitorConfig, monitor: Monitor[Any], params: MonitorParams, database: Database
) -> Message:
    """Find the message that a monitor sends: in its bus's database, else among the gateway's own.

    Raises:
        InputError: the monitor has nothing to send, or its message is nowhere.
    """
    key = f'monitor "{entry.name}".send'
    emission = checked_emission(monitor, params)
    if emission is None:
        raise InputError(f"a {monitor.type} monitor has no message to send", key=key, value="true")
    name = entry.send if isinstance(entry.send, str) else emission.message
    # One after the other: where the bus's own database has the message, no other is read.
    own = (load_database([shipped(file)]) for file in OWN_DATABASES)
    for known in chain([database], own):
        if any(message.name == name for message in known):
            found = known.message(name)
            missing = set(emission.names) - {signal.name for signal in found.signals}
            if missing:
                lacking = ", ".join(sorted(missing))
                raise InputError(f"this message has no {lacking}", key=key, value=name)
            return found
    raise InputError("no database has this message", key=key, value=name)


def _gate(names: _Names, fault: str, settings: FaultOverride, cycles: Sequence[str]) -> Gate:
    at = settings.freeze_frame_at
    return Gate(
        tuple(
            names.condition(condition, f'fault."{fault}".enable[{k}]')
            for k, condition in enumerate(settings.enable)
        ),
        settings.caused_by,
        settings.when_disabled == "reset",
        at if isinstance(at, int) else 0,
        -1 if settings.cycle == POWER else cycles.index(settings.cycle),
    )


def _caused_by_buses(config: Config) -> dict[str, Gate]:
    """Return the gates of the timeouts: a bus that is off or lost is the fault, not each silent message."""
    return {
        f"{bus.name}.{check.message}.timeout": Gate(
            roots=(f"{bus.name}.bus_off", f"{bus.name}.bus_lost")
        )
        for bus in config.bus
        if bus.health.watched
        for check in bus.check
        if check.timeout_ms is not None
    }


def _shown_in_frames(config: Config, names: _Names) -> dict[str, str]:
    """Return what OBD and J1939 show of freeze frames: {signal: key}; checks what outputs serve."""
    for k, did in enumerate(config.did):
        if did.signal is not None:
            names.find(did.signal, f"did[{k}].signal")
    shown = {}
    if config.output.obd is not None:
        for k, pid in enumerate(config.output.obd.pid):
            shown[pid.signal] = f"output.obd.pid[{k}].signal"
    if config.output.j1939 is not None:
        for k, entry in enumerate(config.output.j1939.freeze_frame):
            shown[entry.signal] = f"output.j1939.freeze_frame[{k}].signal"
    for signal, key in shown.items():
        names.find(signal, key)
    return shown


def _monitors(
    config: Config, databases: Mapping[int, Database]
) -> tuple[list[MonitorInstance], list[CheckInstance]]:
    monitors = []
    for entry in config.monitor:
        monitor, params = monitor_of(entry)
        bus = config.bus_index(entry.bus)
        monitors.append(
            MonitorInstance(
                entry.name,
                monitor,
                params,
                bus,
                entry.priority,
                entry.signals,
                _emission(entry, monitor, params, databases[bus]) if entry.send else None,
            )
        )
    checks = [
        CheckInstance(check, index, f"{bus.name}.{check.message}")
        for index, bus in enumerate(config.bus)
        for check in bus.check
    ]
    return monitors, checks


def _refuse_unknown(config: Config, engine: Engine) -> None:
    known = {slot.id for slot in engine.faults}
    unknown = [fault for fault in config.fault if fault not in known]
    if unknown:
        raise InputErrors(
            [
                InputError(
                    f"no monitor reports this fault; known: {', '.join(sorted(known))}",
                    key=f'fault."{fault}"',
                )
                for fault in unknown
            ]
        )


def _own_faults(config: Config) -> list[FaultSlot]:
    """Return the faults of the gateway itself, on its first bus."""
    watched = memory_health.FAULTS if config.memory.watched else ()
    return [FaultSlot(f"{memory_health.OWNER}.{fault.name}", fault, 0) for fault in watched]


def _settings(config: Config, slot: FaultSlot) -> FaultOverride | None:
    """Return what the configuration sets of a fault; one of the gateway itself is none of the vehicle's."""
    settings = config.fault.get(slot.id)
    if slot.fault not in memory_health.FAULTS:
        return settings
    asked = {} if settings is None else settings.model_dump(exclude_unset=True)
    own = {"emission_related": False, "priority": memory_health.PRIORITY}
    return FaultOverride.model_validate({**own, **asked})


def assemble(config: Config) -> Parts:
    """Build everything that needs no fault memory.

    Raises:
        InputError, InputErrors: a database, message, signal, fault or key function that is wrong.
    """
    databases = load_databases(config)
    names = _Names(config, dict(databases))
    monitors, checks = _monitors(config, dict(databases))
    frozen = {
        fault: settings.freeze_frame
        for fault, settings in config.fault.items()
        if settings.freeze_frame
    }
    for fault, wanted in frozen.items():
        for k, name in enumerate(wanted):
            names.find(name, f'fault."{fault}".freeze_frame[{k}]')
    shown = _shown_in_frames(config, names)
    gates = _caused_by_buses(config)
    for fault, settings in config.fault.items():
        roots = settings.caused_by or gates.get(fault, Gate()).roots
        gates[fault] = replace(_gate(names, fault, settings, tuple(config.cycle)), roots=roots)
    cycles = [
        CycleWatch(
            names.condition(cycle.begins, f"cycle.{name}.begins"),
            names.condition(cycle.ends, f"cycle.{name}.ends"),
        )
        for name, cycle in config.cycle.items()
    ]
    engine = build_engine(
        databases,
        monitors,
        checks,
        debounce=lambda name, fault: debounce_of(fault, config.fault.get(name)),
        gates=gates,
        cycles=cycles,
        extra=set(names.found.values()),
        pgn=[index for index, bus in enumerate(config.bus) if bus.match == "pgn"],
        buses=[BusInstance(bus.name, bus.health) for bus in config.bus],
        clock=config.clock,
        reported=_own_faults(config),
    )
    _refuse_unknown(config, engine)
    catalogue = Catalogue(
        replace(
            define(slot.id, slot.fault, _settings(config, slot)),
            caused_by=gates.get(slot.id, Gate()).roots,
        )
        for slot in engine.faults
    )
    uds = config.output.uds
    return Parts(
        databases,
        engine,
        catalogue,
        {
            definition.id: _unique(
                [*frozen.get(definition.id, ()), *(shown if definition.emission_related else ())]
            )
            for definition in catalogue
        },
        {name: engine.plan.slot(*ref) for name, ref in names.found.items()},
        tuple(config.cycle),
        Security(() if uds is None else uds.security),
    )


def _unique(names: Iterable[str]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(names))


def identifiers_of(
    config: Config, parts: Parts, memory: FaultMemory, control: TesterControl
) -> Identifiers:
    """Return the table of data identifiers, with those of the freeze frames' signals."""
    named = {did.name for did in config.did}
    frozen = {name for names in parts.frozen.values() for name in names} - named
    return Identifiers(
        config.did, frozen, control.value, memory.identifiers, memory.write_identifier
    )


def outputs_of(
    config: Config,
    parts: Parts,
    memory: FaultMemory,
    control: TesterControl,
    identifiers: Identifiers,
) -> list[BusServer]:
    """Build what is on the buses on the gateway's behalf."""
    made: list[BusServer] = []
    asked = config.output
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
    uds = None
    if asked.uds is not None:
        context = Context(asked.uds, memory, identifiers, control, parts.security)
        uds = UdsServer(context)
    obd = None if asked.obd is None else ObdServer(asked.obd, memory, control)

    def server(params: IsoTpParams, uds: UdsServer | None, obd: ObdServer | None) -> None:
        transport = IsoTpEndpoint(params, config.bus_index(params.bus))
        made.append(DiagnosticServer(transport, uds, obd))

    if asked.uds is not None and config.diagnostic_address_is_shared():
        server(asked.uds, uds, obd)
    else:
        if asked.uds is not None:
            server(asked.uds, uds, None)
        if asked.obd is not None:
            server(asked.obd, None, obd)
    if asked.j1939 is not None:
        bus = config.bus_index(asked.j1939.bus)
        endpoint = J1939Endpoint(asked.j1939.name, asked.j1939.address, bus)
        made.append(J1939Server(asked.j1939, endpoint, memory, control))
    return made
