"""A configuration with everything that it names: looked up once, here, and passed down from here.

The builder (``gateway.runtime.assemble``) asks for no name again.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gateway.common.calls import CALLS
from gateway.config.answer_bus import AnswerBus
from gateway.config.codes import codes_of_messages, network_codes
from gateway.config.model import Config, MonitorConfig
from gateway.config.monitor_types import monitor_of
from gateway.config.names import Names
from gateway.config.reserved_ids import bus_instances
from gateway.engine.checks.bus_health import BusInstance
from gateway.engine.checks.communication import CheckInstance
from gateway.engine.gate import AWAKE, MOVING, SUPPLIED, Condition, CycleWatch, Gate
from gateway.engine.instances import MonitorInstance
from gateway.faults.settings import POWER, FaultOverride
from gateway.monitors.conformance import checked_emission, checked_faults
from gateway.monitors.contract import Monitor, MonitorParams, Parts
from gateway.monitors.network_codes import NetworkCodes, Pair
from gateway.servers.access import FREE, GUARDED, ROUTE, SESSIONLESS, AccessParams, Conditions
from gateway.servers.access_review import forgeable
from gateway.servers.uds.authentication import Authentication
from gateway.servers.uds.security import Security
from gateway.signals.database import Database, load_database
from gateway.signals.protection.auto import automatic
from gateway.signals.protection.params import ProtectionParams
from gateway.signals.tables import SignalRef
from gateway_fdi.common.resources import shipped
from gateway_fdi.errors import Gathered, InputError, InputErrors, each_of, named, nearest, under

if TYPE_CHECKING:
    from cantools.database.can import Message
    from cantools.database.can.signal import Signal

#: Databases of messages that the gateway itself sends.
OWN_DATABASES = ("dbc/gateway.dbc", "dbc/pedal.dbc")
#: Name of the call that returns the buses of answers.
ANSWER_BUSES = "answer_buses"


@dataclass(frozen=True)
class Resolved:
    """Objects that a configuration's names stand for.

    Attributes:
        config: the configuration.
        databases: of each bus, in the order of the buses, those of ECUs' answers last.
        answers: buses of ECUs' answers, in the order of ``Config.answered``.
        monitors: types and parameters, buses, and the messages they send.
        checks: of messages.
        buses: whose health is judged.
        debounces: fault id -> settings of its debounce that are not its monitor's.
        gates: fault id -> when its test results count.
        cycles: operation cycles by name, in the engine's order.
        freeze_frames: fault id -> names of the signals and live values that its freeze frame asks for.
        shown: names of the signals that outputs such as OBD show of freeze frames of emission related faults.
        signals: each name outside of the engine that stands for a signal -> that signal.
        live: each name that stands for a live value of a monitor -> monitor, value.
        security: of the UDS server; its key functions have been found.
        authentication: of the UDS server; its roots have been read.
        opened: table of outputs -> what its section has read of files.
        notes: what was taken where the configuration leaves it to the databases, one line each.
        forgeable: conditions of access that frames of others meet, one line each.
        codes: full name of a message, signal or relation -> the base codes of DTCs given out for it.
    """

    config: Config
    databases: tuple[Database, ...]
    answers: tuple[AnswerBus, ...]
    monitors: tuple[MonitorInstance, ...]
    checks: tuple[CheckInstance, ...]
    buses: tuple[BusInstance, ...]
    debounces: Mapping[str, Mapping[str, Any]]
    gates: Mapping[str, Gate]
    cycles: Mapping[str, CycleWatch]
    freeze_frames: Mapping[str, tuple[str, ...]]
    shown: tuple[str, ...]
    signals: Mapping[str, SignalRef]
    live: Mapping[str, tuple[str, str]]
    security: Security
    authentication: Authentication
    opened: Mapping[str, Any]
    notes: tuple[str, ...]
    forgeable: tuple[str, ...]
    codes: Mapping[str, tuple[str, ...]]


def resolve(config: Config, *, extra: Collection[str] = ()) -> Resolved:
    """Look up everything that a configuration names, and ``extra`` signals.

    Raises:
        InputError, InputErrors: a database, message, signal or key function that is wrong.
    """
    answers = answer_buses(config)
    databases = (*load_databases(config, keyed=True), *(bus.database for bus in answers))
    types = [monitor_of(entry) for entry in config.monitor]
    readouts = {entry.name: monitor.readout for entry, (monitor, _) in zip(config.monitor, types, strict=True)}
    names = Names(config, dict(enumerate(databases)), readouts)
    uds = config.output.uds
    asked = _find_access(config, names)
    _find_usage(config, names)
    _find_asked(config, names)
    _each(names.find, ((name, "--signal") for name in extra))
    notes = [f"{bus.name}: {note}" for bus, one in zip(config.bus, databases, strict=False) for note in one.notes]
    whole = [type_ for type_ in types if type_[0].capability(Parts) is None]
    codes = network_codes(config, (fault for type_ in whole for fault in checked_faults(*type_)))
    monitors = _all_monitors(config, types, databases, codes)
    pairs = codes_of_messages(config, databases, codes)
    checks = tuple(_checks(config, databases, pairs, notes))
    return Resolved(
        config=config,
        databases=databases,
        monitors=monitors,
        checks=checks,
        notes=tuple(notes),
        forgeable=_forgeable(config, asked, names, checks),
        codes=codes.given,
        answers=answers,
        buses=bus_instances(config),
        freeze_frames=_freeze_frames(config, names),
        shown=_shown(config, names),
        debounces={fault: settings.debounce.asked for fault, settings in config.fault.items()},
        gates=_gates(config, names, monitors),
        cycles={
            name: CycleWatch(
                names.condition(cycle.begins, f"cycle.{name}.begins"),
                names.condition(cycle.ends, f"cycle.{name}.ends"),
            )
            for name, cycle in config.cycle.items()
        },
        signals=names.found,
        live=names.live,
        security=Security(() if uds is None else uds.security),
        authentication=Authentication(None if uds is None else uds.authentication),
        opened={name: one.opened(params) for name, (one, params) in config.output.sections.items()},
    )


def load_databases(config: Config, *, keyed: bool = False) -> tuple[Database, ...]:
    """Load the databases of every bus.

    Args:
        config: with the buses.
        keyed: they are of a configuration's file: a database that is not there is an error of its key.

    Raises:
        InputError, InputErrors: every database that cannot be loaded.
    """
    loaded, wrong = [], Gathered()
    for k, bus in enumerate(config.bus):
        with wrong, _missing_file(f"bus[{k}].database") if keyed else nullcontext():
            loaded.append(load_database(bus.database))
    wrong.check()
    return tuple(loaded)


@contextmanager
def _missing_file(key: str) -> Iterator[None]:
    """Have a file that is not there be an error of the key that names it, with the files of like names.

    Raises:
        InputError: the error raised within.
    """
    try:
        yield
    except InputError as error:
        if error.file is None or error.key is not None:
            raise
        if not isinstance(error.__cause__, FileNotFoundError):
            raise error.replace(message=f"{error.message} (named by {key})") from error.__cause__
        path = Path(error.file)
        there = [each.name for each in path.parent.iterdir()] if path.parent.is_dir() else []
        raise InputError(f"No such file or directory{nearest(path.name, there)}", key=key, value=error.file) from error


def answer_buses(config: Config) -> tuple[AnswerBus, ...]:
    """Return a bus of answers for each bus that has ECUs, by the package that asks them.

    Raises:
        InputError, InputErrors: no package asks ECUs; every file of layouts that cannot be read.
    """
    if not config.answered:
        return ()
    if ANSWER_BUSES not in CALLS:
        raise InputError("no installed package asks ECUs", key="ecu" if config.ecu else "bus.dm1")
    made: tuple[AnswerBus, ...] = CALLS[ANSWER_BUSES](config)
    return made


def _find_asked(config: Config, names: Names) -> None:
    """Find the signals that say when ECUs are asked."""
    conditions = [
        (read.when, f"ecu[{k}].read[{at}]") for k, ecu in enumerate(config.ecu) for at, read in enumerate(ecu.read)
    ]
    conditions += [(ecu.dtcs.when, f"ecu[{k}].dtcs") for k, ecu in enumerate(config.ecu) if ecu.dtcs is not None]
    _each(
        names.find, ((one.signal, f"{key}.when[{j}].signal") for when, key in conditions for j, one in enumerate(when))
    )


def _each(find: Callable[[str, str], object], asked: Iterable[tuple[str, str]]) -> None:
    """Find what names stand for, each with the key that has it.

    Raises:
        InputError, InputErrors: those that are not there.
    """
    wrong = Gathered()
    for name, key in asked:
        with wrong:
            find(name, key)
    wrong.check()


def _checks(
    config: Config, databases: Sequence[Database], pairs: Mapping[str, Pair], notes: list[str]
) -> list[CheckInstance]:
    """Return the checks of messages; codes given out and protections from databases are put in, and noted.

    Raises:
        InputError, InputErrors: checks of messages that are not there.
    """
    made, wrong = [], Gathered()
    for index, bus in enumerate(config.buses):
        for at, check in enumerate(bus.check):
            name, key = f"{bus.name}.{check.message}", config.key_of_check(index, at)
            given = pairs[name]._asdict() if name in pairs else {}
            update: dict[str, Any] = {what: code for what, code in given.items() if what not in check.model_fields_set}
            if check.protection == "auto":
                with wrong:
                    taken, why = _automatic(databases[index], check.message, key)
                    update |= {what: getattr(taken, what) for what in ("e2e", "checksum", "counter")}
                    notes.append(f"{name}: {why}")
            made.append(CheckInstance(check.model_copy(update=update), index, name, key))
    wrong.check()
    return made


def _automatic(database: Database, name: str, key: str) -> tuple[ProtectionParams, str]:
    """Return what a database says of the protection of a message, and why.

    Raises:
        InputError: there is no such message.
    """
    with under(f"{key}.message", name):
        return automatic(database.message(name), database.file_of(name))


def protections(config: Config) -> dict[tuple[int, str], ProtectionParams]:
    """Return how messages are protected, by their checks: (bus index, message) -> keys of the check.

    Raises:
        InputError, InputErrors: checks of messages that are not there.
    """
    checks = _checks(config.model_copy(update={"ecu": ()}), load_databases(config), {}, [])
    return {(check.bus, check.params.message): check.params for check in checks}


def _all_monitors(
    config: Config,
    types: Sequence[tuple[Monitor[Any], MonitorParams]],
    databases: Sequence[Database],
    codes: NetworkCodes,
) -> tuple[MonitorInstance, ...]:
    made: list[MonitorInstance] = []
    wrong = Gathered()
    for at, type_ in enumerate(types):
        with wrong:
            made += _monitors(config, at, *type_, databases, codes)
    wrong.check()
    return tuple(made)


def _monitors(
    config: Config,
    at: int,
    monitor: Monitor[Any],
    params: MonitorParams,
    databases: Sequence[Database],
    codes: NetworkCodes,
) -> list[MonitorInstance]:
    """Return a configured monitor, or its parts.

    Raises:
        InputError, InputErrors: signals that are not there, or a part that cannot be made.
    """
    entry, key = config.monitor[at], f"monitor[{at}]"
    bus = config.bus_index(entry.bus)
    sent = _emission(entry, monitor, params, databases[bus]) if entry.send else None
    parts, several = monitor.capability(Parts), {"": params}
    if parts is not None:

        def find(name: str) -> Signal:
            return _signal(config, databases, bus, entry.signals.get(name, name))

        wrong = Gathered()
        for name, other in entry.signals.items():
            with wrong, under(f'{key}.signals."{name}"', other):
                find(name)
        wrong.check()
        try:
            several = dict(parts.of(params, find, partial(codes.give, config.buses[bus].name)))
        except (InputError, InputErrors) as error:
            for each in each_of(error):
                own = f"{key}.{each.key}" if each.key else key
                with wrong:
                    if each.file is not None:  # of the monitor itself
                        raise each from error
                    raise InputError(each.message, key=own, value=each.value) from error
            wrong.check()
    return [
        MonitorInstance(entry.name, monitor, part, bus, entry.priority, entry.signals, sent, name, key, entry.trusted)
        for name, part in several.items()
    ]


def _signal(config: Config, databases: Sequence[Database], bus: int, name: str) -> Signal:
    """Return a signal by ``Message.Signal`` of a bus, or ``bus.Message.Signal``.

    Raises:
        InputError: there is none.
    """
    *of, message, signal = name.rsplit(".", 2) if "." in name else ("", "", "")
    if not signal:
        close = nearest(name, [each.name for message in databases[bus] for each in message.signals])
        having = [f"{m.name}.{each.name}" for m in databases[bus] for each in m.signals if each.name == name]
        hint = f"; did you mean {' or '.join(having[:3])}?" if having else close
        raise InputError(f'a signal is named "Message.Signal" or "bus.Message.Signal"{hint}')
    try:
        index = config.bus_index(of[0]) if of else bus
    except InputError as error:
        raise InputError(error.message) from error
    return databases[index].signal(message, signal)


def _emission(entry: MonitorConfig, monitor: Monitor[Any], params: MonitorParams, database: Database) -> Message:
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


def _freeze_frames(config: Config, names: Names) -> dict[str, tuple[str, ...]]:
    """Return the signals that the faults' freeze frames ask for."""
    asked = {fault: settings.freeze_frame for fault, settings in config.fault.items() if settings.freeze_frame}
    _each(
        names.find_shown,
        (
            (name, f'fault."{fault}".freeze_frame[{k}]')
            for fault, wanted in asked.items()
            for k, name in enumerate(wanted)
        ),
    )
    return asked


def _shown(config: Config, names: Names) -> tuple[str, ...]:
    """Return what other outputs show of freeze frames; finds what identifiers read, too."""
    _each(
        names.find_shown,
        ((did.signal, f"did[{k}].signal") for k, did in enumerate(config.did) if did.signal is not None),
    )
    shown = {
        signal: f"output.{name}.{key}"
        for name, (one, params) in config.output.sections.items()
        for signal, key in one.shown(params)
    }
    _each(names.find, shown.items())
    return tuple(shown)


def _find_access(config: Config, names: Names) -> dict[str, str]:
    """Find the signals that rules of access ask for; returns each with a key that asks for it."""
    own = {} if config.output.uds is None else config.output.uds.rules
    rules: dict[str, AccessParams | Conditions | None] = {"access": config.access}
    rules |= {f"access.{name}": getattr(config.access, name) for name in (*GUARDED, *FREE, ROUTE, *SESSIONLESS)}
    rules |= {f"output.uds.{name}": rule for name, rule in own.items()}
    sections = config.output.sections.items()
    _each(names.find, ((s, f"output.{name}.{key}") for name, (one, p) in sections for s, key in one.signals(p)))
    asked = [
        (condition.signal, f"{key}.when[{k}].signal")
        for key, rule in rules.items()
        for k, condition in enumerate(rule.when or () if rule is not None else ())
    ]
    _each(names.find, asked)
    return dict(reversed(asked))


def _forgeable(
    config: Config, asked: Mapping[str, str], names: Names, checks: Sequence[CheckInstance]
) -> tuple[str, ...]:
    """Return which conditions of access frames of others meet, one line each.

    Raises:
        InputErrors: those that one forged frame meets, and that nobody has accepted.
    """
    places = {signal: (key, f"{config.buses[names.found[signal].bus].name}.{names.found[signal].message}")
              for signal, key in asked.items()}  # fmt: skip
    wrong, told = forgeable(config.needs, places, {check.name: check.params for check in checks},
                            config.access.unprotected)  # fmt: skip
    if wrong:
        raise InputErrors(wrong)
    return tuple(told)


def _find_usage(config: Config, names: Names) -> None:
    """Find the signals that tell how the vehicle is used."""
    usage = config.usage
    if usage is None:
        return
    named = [
        (condition.signal, f"usage.{what}[{k}].signal")
        for what, conditions in (("running", usage.running), ("denominator", usage.denominator))
        for k, condition in enumerate(conditions)
    ]
    others = (("speed", usage.speed), ("odometer", usage.odometer))
    named += [(signal, f"usage.{what}") for what, signal in others if signal is not None]
    _each(names.find, named)


def _gates(config: Config, names: Names, monitors: Sequence[MonitorInstance]) -> dict[str, Gate]:
    """Return when the test results of each fault count."""
    gates = _caused_by_buses(config)
    cycles = tuple(config.cycle)
    wrong = Gathered()
    for fault, settings in config.fault.items():
        roots = settings.caused_by or gates.get(fault, Gate()).roots
        with wrong:
            gates[fault] = replace(_gate(names, fault, settings, cycles), roots=roots)
    wrong.check()
    for fault, power in _powered(config, names, monitors).items():
        gate = gates.get(fault, Gate())
        gates[fault] = replace(gate, conditions=(*gate.conditions, *power))
    return gates


def _powered(config: Config, names: Names, monitors: Sequence[MonitorInstance]) -> dict[str, tuple[Condition, ...]]:
    """Return what the power must be for the test results of faults to count."""
    power, wrong = config.power, Gathered()
    awake: list[Condition] = []
    moving: list[Condition] = []
    for some, key, counts, into in ((power.awake, "awake", AWAKE, awake), (power.moving, "moving", MOVING, moving)):
        for k, condition in enumerate(some):
            with wrong:
                into.append(names.condition(condition, f"power.{key}[{k}]", counts))
    supplied: list[Condition] = []
    if power.voltage is not None:
        with wrong:
            supplied.append(names.condition(power.voltage, "power.voltage", SUPPLIED))
    found: dict[str, tuple[Condition, ...]] = {}
    of_monitors: dict[str, set[str]] = {}
    for m in monitors:
        own = {f"{m.name}.{one.name}" for one in checked_faults(m.monitor, m.params)}
        of_monitors.setdefault(m.name, set()).update(own)
    for k, name in enumerate(power.suffers):
        with wrong:
            for fault in _suffering(name, of_monitors, f"power.suffers[{k}]"):
                found[fault] = tuple(supplied)
    wrong.check()
    for bus in config.buses:
        silent = [f"{bus.name}.{check.message}.timeout" for check in bus.check if check.timeout_ms is not None]
        found |= dict.fromkeys(silent, (*awake, *supplied))
        found[f"{bus.name}.bus_silent"] = (*awake, *supplied, *moving)
    return found if awake or supplied or moving else {}


def _suffering(name: str, of_monitors: Mapping[str, set[str]], key: str) -> set[str]:
    """Return the faults that a name stands for: a monitor's, or one.

    Raises:
        InputError: there is none.
    """
    known = {*of_monitors, *chain.from_iterable(of_monitors.values())}
    if name not in known:
        raise InputError(named("no monitor, and no fault of one; known:", name, known), key=key, value=name)
    return of_monitors.get(name, {name})


def _gate(names: Names, fault: str, settings: FaultOverride, cycles: tuple[str, ...]) -> Gate:
    at = settings.freeze_frame_at
    return Gate(
        tuple(
            names.condition(condition, f'fault."{fault}".enable[{k}]') for k, condition in enumerate(settings.enable)
        ),
        settings.caused_by,
        settings.when_disabled == "reset",
        at if isinstance(at, int) else 0,
        -1 if settings.cycle == POWER else cycles.index(settings.cycle),
    )


def _caused_by_buses(config: Config) -> dict[str, Gate]:
    """Return the gates of what is silent: a bus that is off or lost is the fault, not each silent message."""
    gates: dict[str, Gate] = {}
    for bus in config.bus:
        if bus.health.watched:
            gate = Gate(roots=(f"{bus.name}.bus_off", f"{bus.name}.bus_lost"))
            timeouts = [f"{bus.name}.{one.message}.timeout" for one in bus.check if one.timeout_ms is not None]
            gates |= dict.fromkeys([*timeouts, f"{bus.name}.bus_silent"], gate)
    for (k, _), answers in zip(config.answered.items(), config.buses[len(config.bus) :], strict=True):
        bus = config.bus[k]
        if bus.health.watched:
            roots = (f"{bus.name}.bus_off", f"{bus.name}.bus_lost")
            timeouts = [f"{answers.name}.{one.message}.timeout" for one in answers.check if one.timeout_ms is not None]
            gates |= dict.fromkeys(timeouts, Gate(roots=roots))
    return gates
