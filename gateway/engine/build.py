"""From configured monitors and message checks to the engine's tables."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from cantools.database.can import Message

from gateway.engine import emission
from gateway.engine.checks import bus_health, communication
from gateway.engine.checks.bus_health import Health
from gateway.engine.checks.clock_health import OWN, OWN_FAULTS, ClockParams
from gateway.engine.checks.communication import Check
from gateway.engine.core import Engine, FaultSlot
from gateway.engine.debounce import DebounceRow, configure
from gateway.engine.emission import Emitted
from gateway.engine.events import EVENT, NO_BUS
from gateway.engine.gate import CycleWatch, Gate, prepare_gates, prepare_watches
from gateway.engine.tables import (
    MOST_REPORTS,
    NEVER,
    Clock,
    Handler,
    Report,
    Tables,
    Vector,
    table,
)
from gateway.errors import InputError, nearest
from gateway.monitors.conformance import checked_emission, checked_faults, connections
from gateway.monitors.contract import RESULTS, Debounce, Fault, Monitor, MonitorParams, Signal
from gateway.signals.crc import ALGORITHMS, crc8_table
from gateway.signals.database import Database
from gateway.signals.tables import DecodePlan, SignalRef, compile_plan


@dataclass(frozen=True)
class MonitorInstance:
    """A configured monitor: its name, type, parameters, bus, and place in the order of priority.

    ``signals`` maps a default ``"Message.Signal"`` to the user's own, or to ``"bus.Message.Signal"`` of another bus;
    ``priority`` 0 steps first.
    ``emission`` is the message its results are sent in; None: they are not sent.
    """

    name: str
    monitor: Monitor[Any]
    params: MonitorParams
    bus: int = 0
    priority: int = 0
    signals: Mapping[str, str] = field(default_factory=dict)
    emission: Message | None = None


@dataclass(frozen=True)
class CheckInstance:
    """The configured communication checks of one message of a bus."""

    params: communication.Params
    bus: int = 0
    name: str = ""


@dataclass(frozen=True)
class BusInstance:
    """A bus, and how its health is judged."""

    name: str
    params: bus_health.Params = field(default_factory=bus_health.Params)


def _split(reference: str, bus: int, buses: Mapping[str, int]) -> SignalRef:
    """Read ``Message.Signal`` of a bus, or ``bus.Message.Signal``."""
    parts = reference.split(".")
    if len(parts) == 3 and parts[0] in buses:
        return SignalRef(buses[parts[0]], parts[1], parts[2])
    if len(parts) == 3:
        known = ", ".join(buses)
        raise InputError(f"the buses are {known}", value=reference)
    if len(parts) != 2:
        raise InputError('a signal is named "Message.Signal"', value=reference)
    return SignalRef(bus, parts[0], parts[1])


def build_engine(
    databases: Sequence[tuple[int, Database]],
    monitors: Sequence[MonitorInstance],
    checks: Sequence[CheckInstance],
    *,
    debounce: Callable[[str, Fault], Debounce] | None = None,
    gates: Mapping[str, Gate] | None = None,
    cycles: Sequence[CycleWatch] = (),
    extra: Collection[SignalRef] = (),
    pgn: Collection[int] = (),
    buses: Sequence[BusInstance] = (),
    clock: ClockParams | None = None,
    reported: Sequence[FaultSlot] = (),
    ring: int = 4096,
) -> Engine:
    """Compile everything into one engine.

    Args:
        databases: (bus index, database) pairs.
        monitors: configured monitors.
        checks: communication checks.
        debounce: fault id, fault -> its debounce; default: the fault's own.
        gates: by fault id, when its test results count; default: always.
        cycles: operation cycles that signals begin and end; events name them by their index.
        extra: further signals to decode (freeze frames, identifiers).
        pgn: buses whose extended identifiers match by J1939 PGN.
        buses: whose health is judged, in the order of their indices.
        clock: how the gateway's own clock is judged; None: it is not.
        reported: faults that nobody tests in the loop; their results are told by :meth:`Engine.report`.
        ring: events that one pass of the loop can hold.

    Returns:
        the engine; its faults are those of the monitors, then those of the checks, then those of the buses,
        in order, then the gateway's own.

    Raises:
        InputError: a message or signal that no database has, a CRC signal off its byte boundary.
    """
    by_bus = dict(databases)
    monitors = sorted(monitors, key=lambda m: m.priority)
    indices = {bus.name: k for k, bus in enumerate(buses)}
    wirings = [_wire(m, by_bus, indices) for m in monitors]
    gates = gates or {}
    wanted: set[SignalRef] = set(extra)
    wanted.update(c.signal for gate in gates.values() for c in gate.conditions)
    wanted.update(c.signal for cycle in cycles for c in (cycle.begins, cycle.ends))
    watched: set[tuple[int, str]] = set()
    for wired in wirings:
        wanted.update(reference for reference in wired.inputs if reference is not None)
        watched |= wired.triggers
    for check in checks:
        watched.add((check.bus, check.params.message))
        wanted.update(_check_signals(check, by_bus[check.bus]))
    plan = compile_plan(databases, wanted, messages=watched, pgn=pgn)

    faults: list[FaultSlot] = []
    handlers = table(len(monitors), Handler)
    slots: list[int] = []
    sources: list[int] = []
    triggered: dict[int, list[int]] = {}
    states, consts = [], []
    emitted: list[Emitted] = []
    cells = 0
    nowhere = plan.n_slots  # a slot that stays NaN
    for k, (m, wired) in enumerate(zip(monitors, wirings, strict=True)):
        h = handlers[k]
        state, const = table(1, m.monitor.state), table(1, m.monitor.const)
        m.monitor.prepare(m.params, state.view(np.recarray)[0], const.view(np.recarray)[0])
        states.append(state)
        consts.append(const)
        own = [nowhere if place is None else plan.slot(*place) for place in wired.inputs]
        waived = {plan.message(*message) for message in wired.optional}
        rows = sorted({int(plan.slot_message[slot]) for slot in own if slot != nowhere} - waived)
        h["state"], h["const"] = state.ctypes.data, const.ctypes.data
        h["inputs"] = cells
        size = m.monitor.inputs.dtype.itemsize
        assert size == 8 * (2 + len(own)), "as the step copies them"
        while own and own[-1] == nowhere:  # stays NaN without a step's copying it
            own.pop()
        h["first_slot"], h["slots"] = len(slots), len(own)
        h["first_source"], h["sources"] = len(sources), len(rows)
        mine = checked_faults(m.monitor, m.params)
        h["fault"], h["faults"] = len(faults), len(mine)
        h["bus"] = m.bus
        h["wake_ns"] = NEVER
        h["emit"] = -1
        own_message = checked_emission(m.monitor, m.params)
        if m.emission is not None and own_message is not None:
            h["emit"] = len(emitted)
            emitted.append(Emitted(own_message, m.emission, m.bus))
        slots += own
        sources += rows
        cells += size // 8
        for message in sorted(wired.triggers):
            triggered.setdefault(plan.message(*message), []).append(k)
        faults += [FaultSlot(f"{m.name}.{fault.name}", fault, m.bus) for fault in mine]
    pool = np.full(max(cells, 1), np.nan)
    for k in range(len(monitors)):
        handlers[k]["inputs_address"] = pool.ctypes.data + 8 * int(handlers[k]["inputs"])

    vectors, flat = _vector_table(len(plan.messages), triggered)
    check_rows = table(len(checks), Check)
    for k, check in enumerate(checks):
        row = plan.message(check.bus, check.params.message)
        vectors[row]["check"] = k
        faults += _prepare_check(check_rows[k], check, plan, by_bus[check.bus], len(faults))

    health = table(len(buses) + 1, Health)
    codes = bus_health.codes_of([bus.params for bus in buses])
    for k, (bus, code) in enumerate(zip(buses, codes, strict=True)):
        faults += _prepare_health(health[k], bus, k, code, len(faults))
    faults += _prepare_own(health[-1], clock, len(faults))

    faults += reported
    debounces = table(len(faults), DebounceRow)
    own_gates = [gates.get(slot.id, Gate()) for slot in faults]
    for k, (slot, gate) in enumerate(zip(faults, own_gates, strict=True)):
        asked = slot.fault.debounce if debounce is None else debounce(slot.id, slot.fault)
        configure(debounces[k], asked, trigger_fdc=gate.trigger_fdc)
        debounces[k]["bus"] = slot.bus
    ids = {slot.id: k for k, slot in enumerate(faults)}
    _refuse_unknown_roots(gates, ids)
    conditions, roots = prepare_gates(own_gates, debounces, ids, plan)
    watches = prepare_watches(cycles, vectors, plan)
    known = set(plan.message_names)
    emits, emit_signals = emission.prepare(
        emitted, [(entry.bus, entry.message.name) in known for entry in emitted]
    )
    outbox, outbox_cells = emission.outbox()
    out = table(1, RESULTS)
    clock_row = table(1, Clock)
    clock_row[0]["deadline_ns"] = NEVER
    clock_row[0]["timed"] = bool(debounces["timed"].any())
    tables = Tables(
        keys=plan.keys,
        rows=plan.rows,
        messages=plan.messages,
        signals=plan.signals,
        mux_ids=plan.mux_ids,
        values=np.zeros(max(plan.max_signals, 1)),
        present=np.zeros(max(plan.max_signals, 1), np.uint8),
        mailbox=np.full(plan.n_slots + 1, np.nan),
        vectors=vectors,
        triggers=np.asarray(flat, np.int32),
        handlers=handlers,
        slots=np.asarray(slots, np.int32),
        sources=np.asarray(sources, np.int32),
        pool=pool,
        pool_ns=pool.view(np.int64),
        checks=check_rows,
        crc_tables=np.stack([crc8_table(name) for name in ALGORITHMS]),
        debounces=debounces,
        conditions=conditions,
        roots=roots,
        watches=watches,
        cycles=np.zeros(max(len(cycles), 1), np.uint8),
        out=out,
        out_address=np.asarray([out.ctypes.data], np.int64),
        emits=emits,
        emit_signals=emit_signals,
        outbox=outbox,
        outbox_cells=outbox_cells,
        ring=table(ring, EVENT),
        health=health,
        reports=table(MOST_REPORTS, Report),
        clock=clock_row,
    )
    _assert_consistent(tables)
    return Engine(plan, tables, tuple(faults), tuple(monitors), tuple(states), tuple(consts))


def _assert_consistent(t: Tables) -> None:
    """Assert what the loop takes for granted of the tables to each other: it checks no index."""
    messages, slots, faults = len(t.messages), len(t.mailbox), len(t.debounces)
    assert len(t.vectors) == messages
    assert (t.vectors["first"] + t.vectors["count"] <= len(t.triggers)).all()
    assert (t.vectors["check"] < len(t.checks)).all()
    assert (t.vectors["first_watch"] + t.vectors["watches"] <= len(t.watches)).all()
    assert ((t.triggers >= 0) & (t.triggers < max(len(t.handlers), 1))).all()
    assert ((t.slots >= 0) & (t.slots < slots)).all()
    assert ((t.sources >= 0) & (t.sources < messages)).all()
    for h in t.handlers:
        assert h["first_slot"] + h["slots"] <= len(t.slots)
        assert h["first_source"] + h["sources"] <= len(t.sources)
        assert h["inputs"] + 2 + h["slots"] <= len(t.pool)
        assert 0 <= h["fault"] <= h["fault"] + h["faults"] <= faults
        assert h["emit"] < len(t.emits)
    for row in (*t.checks, *t.health):
        assert (row["fault"] < faults).all()
    for d in t.debounces:
        assert d["first_condition"] + d["conditions"] <= len(t.conditions)
        assert d["first_root"] + d["roots"] <= len(t.roots)
    assert ((t.roots >= 0) & (t.roots < max(faults, 1))).all()
    assert ((t.conditions["slot"] >= 0) & (t.conditions["slot"] < slots)).all()
    assert (t.emits["first"] + t.emits["count"] <= len(t.emit_signals)).all()
    assert t.values.shape == t.present.shape
    assert t.out.itemsize == RESULTS.itemsize


class Wired(NamedTuple):
    """What a monitor wants from the buses, as the user names it.

    Attributes:
        triggers: messages (bus, name) that step it.
        inputs: the signal of each number of its inputs, None: nothing.
        optional: messages that need not come.
    """

    triggers: set[tuple[int, str]]
    inputs: list[SignalRef | None]
    optional: set[tuple[int, str]]


def _wire(m: MonitorInstance, databases: Mapping[int, Database], buses: Mapping[str, int]) -> Wired:
    """Find what a monitor is connected to.

    Raises:
        InputError: a signal or message that is not there, another unit, a name that the monitor does not know.
    """
    connected = connections(m.monitor, m.params)
    known = {signal.name for _, signal in connected.inputs if signal is not None}
    inputs: list[SignalRef | None] = []
    places: dict[str, tuple[int, str]] = {}  # default name of a message -> where it is
    optional: set[tuple[int, str]] = set()
    try:
        for name in m.signals:
            if name not in known:
                raise InputError(
                    f"the monitor has no such signal{nearest(name, known)}", value=name
                )
        for _, signal in connected.inputs:
            if signal is None:
                inputs.append(None)
                continue
            place = _split(m.signals.get(signal.name, signal.name), m.bus, buses)
            _refuse_unit(databases[place.bus].signal(place.message, place.signal).unit, signal)
            inputs.append(place)
            message = signal.name.rpartition(".")[0]
            places[message] = (place.bus, place.message)
            if signal.optional:
                optional.add((place.bus, place.message))
        stepped = {name.rpartition(".")[0] for name in connected.signals} | connected.messages
        triggers = {places.get(name, (m.bus, name)) for name in stepped}
        for bus, name in triggers:
            databases[bus].message(name)
    except InputError as error:
        raise InputError(error.message, key=f'monitor "{m.name}"', value=error.value) from error
    return Wired(triggers, inputs, optional)


def _refuse_unit(told: str | None, signal: Signal) -> None:
    if signal.unit is not None and signal.unit != (told or ""):
        raise InputError(
            f'its unit is "{told or ""}" in the database, the plant wants "{signal.unit}"',
            value=signal.name,
        )


def _check_signals(check: CheckInstance, database: Database) -> list[SignalRef]:
    """Return the signals that a check needs decoded."""
    p = check.params
    try:
        database.message(p.message)
        if p.counter is None:
            return []
        database.signal(p.message, p.counter.signal)
    except InputError as error:
        raise InputError(error.message, key=f'check of "{p.message}"', value=error.value) from error
    return [SignalRef(check.bus, p.message, p.counter.signal)]


def _refuse_unknown_roots(gates: Mapping[str, Gate], ids: Mapping[str, int]) -> None:
    for name, gate in gates.items():
        for root in gate.roots:
            if root not in ids or root == name:
                raise InputError(
                    f"the faults are {', '.join(sorted(set(ids) - {name}))}",
                    key=f'fault."{name}".caused_by',
                    value=root,
                )


def _vector_table(messages: int, triggered: Mapping[int, Sequence[int]]) -> tuple[Any, list[int]]:
    """Return the vector table, and the handlers of all messages one after the other."""
    vectors = table(messages, Vector)
    flat: list[int] = []
    for row in range(messages):
        mine = triggered.get(row, [])
        vectors[row]["first"], vectors[row]["count"] = len(flat), len(mine)
        vectors[row]["check"], vectors[row]["arrived_ns"] = -1, -1
        flat += mine
    return vectors, flat


def _prepare_check(
    row: Any, check: CheckInstance, plan: DecodePlan, database: Database, first_fault: int
) -> list[FaultSlot]:
    """Fill one row of checks; returns the faults it can report, in order."""
    p = check.params
    message = database.message(p.message)
    asked = (
        p.timeout_ms is not None,
        p.counter is not None,
        p.crc is not None,
        p.length,
        p.value and bool(plan.messages[plan.message(check.bus, p.message)]["floats"]),
    )
    slots: list[FaultSlot] = []
    for kind, wanted in enumerate(asked):
        row["fault"][kind] = first_fault + len(slots) if wanted else -1
        if wanted:
            fault = p.fault_of(kind)
            slots.append(FaultSlot(f"{check.name}.{fault.name}", fault, check.bus))
    row["bus"] = check.bus
    row["length"] = message.length
    row["timeout_ns"] = round((p.timeout_ms or 0) * 1e6)
    row["deadline_ns"] = NEVER
    if p.counter is not None:
        signal = database.signal(p.message, p.counter.signal)
        row["counter"] = plan.position(check.bus, p.message, p.counter.signal)
        row["modulo"] = 1 << signal.length
        row["max_step"] = p.counter.max_step
    if p.crc is not None:
        signal = database.signal(p.message, p.crc.signal)
        big = signal.byte_order == "big_endian"
        if signal.length != 8 or signal.start % 8 != (7 if big else 0):
            raise InputError(
                "a CRC signal has 8 bits on a byte boundary",
                key=f"{p.message}.{p.crc.signal}",
                value=f"start {signal.start}, length {signal.length}",
            )
        algorithm = ALGORITHMS[p.crc.algorithm]
        row["crc_byte"] = signal.start // 8
        row["data_id"] = -1 if p.crc.data_id is None else p.crc.data_id
        row["crc_table"] = list(ALGORITHMS).index(p.crc.algorithm)
        row["crc_init"], row["crc_xor"] = algorithm.init, algorithm.xorout
    return slots


def _prepare_health(
    row: Any, bus: BusInstance, index: int, code: str, first_fault: int
) -> list[FaultSlot]:
    """Fill the health of one bus; returns the faults it can report, in order."""
    p = bus.params
    row["most"], row["window_ns"] = p.errors, round(p.window_ms * 1e6)
    row["deadline_ns"] = NEVER
    row["until"] = NEVER
    row["fault"] = -1
    if not p.watched:
        return []
    faults = bus_health.faults_of(code)
    row["fault"][: len(faults)] = first_fault + np.arange(len(faults))
    return [FaultSlot(f"{bus.name}.{fault.name}", fault, index) for fault in faults]


def _prepare_own(row: Any, params: ClockParams | None, first_fault: int) -> list[FaultSlot]:
    """Fill the health of the gateway itself; returns the faults it can report, in order."""
    row["deadline_ns"] = NEVER
    row["until"] = NEVER
    row["fault"] = -1
    if params is None or not params.watched:
        return []
    row["most"], row["window_ns"] = (
        round(params.tolerance_ms * 1e3),
        round(params.heals_after_s * 1e9),
    )
    row["fault"][-len(OWN_FAULTS) :] = first_fault + np.arange(len(OWN_FAULTS))
    return [FaultSlot(f"{OWN}.{fault.name}", fault, NO_BUS) for fault in OWN_FAULTS]
