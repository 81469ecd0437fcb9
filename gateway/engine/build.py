"""From configured monitors, checks and buses to the engine's tables: one function a table, top to bottom."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gateway.bus.frames import EXTENDED
from gateway.engine import emission
from gateway.engine.buckets import Bucket
from gateway.engine.checks import bus_health, clock_health, communication
from gateway.engine.checks.bus_health import BusInstance, Health, Silence
from gateway.engine.checks.bus_sleep import sender_of, silence_of
from gateway.engine.checks.clock_health import ClockParams
from gateway.engine.checks.communication import Check, CheckInstance
from gateway.engine.checks.unknown_ids import MOST as MOST_STRANGERS
from gateway.engine.checks.unknown_ids import UnknownId, known_table
from gateway.engine.consistency import assert_consistent
from gateway.engine.core import Engine
from gateway.engine.debounce import DebounceRow, configure
from gateway.engine.emission import Emitted
from gateway.engine.events import EVENT
from gateway.engine.gate import CycleWatch, Gate, fill_gates, fill_watches
from gateway.engine.instances import FaultSlot, MonitorInstance
from gateway.engine.samples import Sampled, Sampler, fill
from gateway.engine.tables import (
    MOST_REPORTS,
    MOST_SOURCES,
    NEVER,
    Clock,
    Handler,
    Page,
    Report,
    Source,
    Tables,
    Vector,
    table,
)
from gateway.engine.timers import CHECK, DEBOUNCE, HANDLER, HEALTH, timers_of
from gateway.engine.wiring import Wired, wire
from gateway.j1939.transport import LONGEST
from gateway.monitors.authors import author_of
from gateway.monitors.conformance import checked_emission, checked_faults
from gateway.monitors.contract import RESULTS, Debounce, Numbered
from gateway.monitors.sampling import MOST_MESSAGES
from gateway.signals.database import Database
from gateway.signals.protection import protection
from gateway.signals.tables import DecodePlan, SignalRef, compile_plan
from gateway_fdi.errors import Gathered, InputError, named, under
from gateway_fdi.jit import Record


def build_engine(
    databases: Sequence[tuple[int, Database]],
    monitors: Sequence[MonitorInstance],
    checks: Sequence[CheckInstance],
    *,
    debounces: Mapping[str, Mapping[str, Any]] | None = None,
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
        debounces: fault id -> settings of its debounce that are not the fault's own.
        gates: by fault id, when its test results count; default: always.
        cycles: operation cycles that signals begin and end; events name them by their index.
        extra: further signals to decode (freeze frames, identifiers).
        pgn: buses whose extended identifiers match by J1939 PGN.
        buses: whose health is judged, in the order of their indices.
        clock: how the gateway's own clock is judged; None: it is not.
        reported: faults without a test in the loop; their results are told by :meth:`Engine.report`.
        ring: events that one pass of the loop can hold.

    Returns:
        the engine; its faults are those of the monitors, then those of the checks, then those of the buses,
        in order, then the gateway's own.

    Raises:
        InputError, InputErrors: a message or signal that no database has, a CRC signal off its byte boundary.
    """
    by_bus, gates = dict(databases), gates or {}
    monitors = sorted(monitors, key=lambda m: m.priority)
    wirings = _wirings(monitors, by_bus, {bus.name: k for k, bus in enumerate(buses)})
    wanted = _signals(wirings, checks, by_bus, gates, cycles) | set(extra)
    plan = compile_plan(databases, wanted, messages=_messages(wirings, checks), pgn=pgn)
    faults: list[FaultSlot] = []
    made = _handlers(monitors, wirings, plan, faults)
    vectors, triggers = _vectors(plan, made.triggered)
    pages = _pages(made.pages, vectors, plan)
    crcs = protection.Tables()
    check_rows = _checks(checks, buses, plan, by_bus, vectors, faults, crcs, (debounces or {}).keys())
    silences = [silence_of(k, bus.params, checks, by_bus) for k, bus in enumerate(buses)]
    health = _health(buses, silences, clock, faults)
    faults += reported
    verdicts = _verdicts(faults, debounces or {}, gates, plan)
    watched = _watches(cycles, vectors, plan)
    own = {
        "vectors": vectors,
        "pages": pages,
        "triggers": np.asarray(triggers, np.int32),
        "checks": check_rows,
        "health": health,
        **_strangers(databases, buses, made, pgn),
    }
    tables = _tables(plan, made, verdicts, crcs, ring=table(ring, EVENT), **own, **watched)
    assert_consistent(tables)
    return Engine(plan, tables, tuple(faults), tuple(monitors), tuple(made.states), tuple(made.consts))


def _wirings(
    monitors: Sequence[MonitorInstance], databases: Mapping[int, Database], buses: Mapping[str, int]
) -> list[Wired]:
    wirings, wrong = [], Gathered()
    for m in monitors:
        with wrong:
            wirings.append(wire(m, databases, buses))
    wrong.check()
    return wirings


def _signals(
    wirings: Sequence[Wired],
    checks: Sequence[CheckInstance],
    databases: Mapping[int, Database],
    gates: Mapping[str, Gate],
    cycles: Sequence[CycleWatch],
) -> set[SignalRef]:
    """Return the signals that monitors, checks, gates and operation cycles need decoded."""
    wanted = {c.signal for gate in gates.values() for c in gate.conditions}
    wanted.update(c.signal for cycle in cycles for c in (cycle.begins, cycle.ends))
    for wired in wirings:
        wanted.update(reference for reference in wired.inputs if reference is not None)
        wanted.update(wired.counters)
    wrong = Gathered()
    for check in checks:
        with wrong:
            wanted.update(communication.signals_of(check, databases[check.bus]))
    wrong.check()
    return wanted


def _messages(wirings: Sequence[Wired], checks: Sequence[CheckInstance]) -> set[tuple[int, str]]:
    """Return the messages (bus, name) whose arrival matters."""
    watched = {(check.bus, check.params.message) for check in checks}
    return watched.union(*(wired.triggers for wired in wirings))


@dataclass
class _Handlers:
    """The monitors' table, and the tables that its rows point to.

    Attributes:
        rows: of Handler, shape (monitors,).
        pool: float64, the monitors' inputs one after the other.
        slots: mailbox slots of these inputs.
        samplers: of Sampler, of the monitors that step once a sample.
        sampled: their messages.
        carried: inputs, by their numbers, that each of these carries, and those of no sample.
        held: cells that hold what has come of samples that are not there yet.
        sources: messages that they come from, and those of their pages, as the loop has them.
        pages: mailbox slot of each multiplexed signal among them -> its page.
        triggered: row of a message -> the monitors that it steps, by priority.
        states: a record of each monitor.
        consts: a record of each monitor.
        emitted: messages that they send.
    """

    rows: Any
    pool: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    slots: list[int] = field(default_factory=list)
    samplers: list[Any] = field(default_factory=list)
    sampled: list[tuple[int, ...]] = field(default_factory=list)
    carried: list[int] = field(default_factory=list)
    held: int = 0
    sources: list[int] = field(default_factory=list)
    pages: dict[int, int] = field(default_factory=dict)
    triggered: dict[int, list[int]] = field(default_factory=dict)
    states: list[Any] = field(default_factory=list)
    consts: list[Any] = field(default_factory=list)
    emitted: list[Emitted] = field(default_factory=list)


def _prepare(m: MonitorInstance, state: Any, const: Any) -> None:
    """Have a monitor fill its records.

    Raises:
        InputError: parameters that only show there that they are wrong; the key is that of the configuration.
    """
    try:
        with under(m.key or f'monitor "{m.name}"'), author_of(m.monitor, "prepare"):
            m.monitor.prepare(m.params, state, const)
    except (ArithmeticError, ValueError) as error:
        # Raised by a design of gains or a number of nanoseconds where a plant's numbers are impossible.
        key = m.key or f'monitor "{m.name}"'
        raise InputError(f"nothing can be made of these parameters: {error}", key=key, value=m.monitor.type) from error


def _handlers(
    monitors: Sequence[MonitorInstance],
    wirings: Sequence[Wired],
    plan: DecodePlan,
    faults: list[FaultSlot],
) -> _Handlers:
    """Fill the monitors' table; their faults are appended to ``faults``."""
    made = _Handlers(table(len(monitors), Handler))
    cells = 0
    for k, (m, wired) in enumerate(zip(monitors, wirings, strict=True)):
        row = made.rows[k]
        state, const = table(1, m.monitor.state), table(1, m.monitor.const)
        _prepare(m, state.view(np.recarray)[0], const.view(np.recarray)[0])
        _number(m, plan, const)
        made.states.append(state)
        made.consts.append(const)
        row["state"], row["const"] = state.ctypes.data, const.ctypes.data
        row["inputs"] = cells
        cells += _connect(row, m, wired, plan, made)
        _send(row, m, made)
        row["bus"], row["wake_ns"], row["takes_nan"] = m.bus, NEVER, wired.takes_nan
        mine = checked_faults(m.monitor, m.params)
        row["fault"], row["faults"] = len(faults), len(mine)
        faults += [FaultSlot(f"{m.name}.{fault.name}", fault, m.bus) for fault in mine]
        for message in sorted(wired.triggers):
            made.triggered.setdefault(plan.message(*message), []).append(k)
    made.pool = np.full(max(cells, 1), np.nan)
    for row in made.rows:
        row["inputs_address"] = made.pool.ctypes.data + 8 * int(row["inputs"])
    return made


def _number(m: MonitorInstance, plan: DecodePlan, const: Any) -> None:
    """Tell a monitor the numbers of its messages, if it wants them."""
    numbered = m.monitor.capability(Numbered)
    if numbered is not None and m.monitor.triggers is not None:
        for k, name in enumerate(m.monitor.triggers(m.params)):
            const[0][numbered.field][k] = plan.message(m.bus, name)


def _connect(row: Any, m: MonitorInstance, wired: Wired, plan: DecodePlan, made: _Handlers) -> int:
    """Say which mailbox slots go to a monitor's inputs; returns how many cells of the pool these take."""
    nowhere = plan.n_slots  # a slot that stays NaN
    own = [nowhere if place is None else plan.slot(*place) for place in wired.inputs]
    waived = {plan.message(*message) for message in wired.optional}
    needed = sorted({slot for slot in own if slot != nowhere and int(plan.slot_message[slot]) not in waived})
    sources = sorted({int(plan.slot_message[slot]) for slot in needed})
    for slot in filter(plan.is_multiplexed, needed):
        sources.append(-1 - made.pages.setdefault(slot, len(made.pages)))
    size = m.monitor.inputs.dtype.itemsize
    assert size == 8 * (m.monitor.header + len(own)), "as the step copies them"
    row["cells"] = row["inputs"] + m.monitor.header
    _sample(row, m, wired, plan, made)
    while own and own[-1] == nowhere:  # stays NaN without a step's copying it
        own.pop()
    row["first_slot"], row["slots"] = len(made.slots), len(own)
    row["first_source"], row["sources"] = len(made.sources), len(sources)
    made.slots += own
    made.sources += sources
    return size // 8


def _sample(row: Any, m: MonitorInstance, wired: Wired, plan: DecodePlan, made: _Handlers) -> None:
    """Say how the frames of a monitor become samples, if it steps once a sample."""
    row["first_sampled"], row["first_loose"] = len(made.sampled), len(made.carried)
    if not wired.samplings:
        return
    rows = [-1 if place is None else int(plan.slot_message[plan.slot(*place)]) for place in wired.inputs]
    stepping = {plan.message(*message) for message in wired.triggers}
    counters = {int(plan.slot_message[slot]): slot for slot in (plan.slot(*place) for place in wired.counters)}
    taken: set[int] = set()
    for which, asked in enumerate(wired.samplings):
        carried: dict[int, list[int]] = {}
        for k, (message, name) in enumerate(zip(rows, wired.fields, strict=True)):
            if message in stepping and (not asked.inputs or name in asked.inputs):
                carried.setdefault(message, []).append(k)
                taken.add(k)
                if asked.ordered:  # that of the last input comes last
                    carried[message] = carried.pop(message)
        if which == len(wired.samplings) - 1:
            carried.update((message, []) for message in sorted(stepping.difference(rows)))
        if len(carried) > MOST_MESSAGES:
            text = f"its inputs come in {len(carried)} messages; a sample has at most {MOST_MESSAGES}"
            raise InputError(text, key=m.key or f'monitor "{m.name}"')
        if carried:
            fill(made, asked, carried, counters, which=which, nowhere=plan.n_slots, slots=len(rows))
            row["samplings"] += 1
            row["ticks"] |= asked.between == "held"
    for message in set(counters) - {place[0] for place in made.sampled[row["first_sampled"] :]}:
        text = f"a frame counter of {plan.message_names[message][1]}, which carries none of the inputs that trigger"
        raise InputError(text, file=m.monitor.file, key=f'monitor type "{m.monitor.type}".Sampled')
    row["sampled"] = len(made.sampled) - row["first_sampled"]
    loose = [k for k, message in enumerate(rows) if message >= 0 and k not in taken]
    row["first_loose"], row["loose"] = len(made.carried), len(loose)
    made.carried += loose


def _send(row: Any, m: MonitorInstance, made: _Handlers) -> None:
    """Say which message a monitor sends, if it does."""
    own = checked_emission(m.monitor, m.params)
    row["emit"] = -1
    if m.emission is not None and own is not None:
        row["emit"] = len(made.emitted)
        made.emitted.append(Emitted(own, m.emission, m.bus))


def _vectors(plan: DecodePlan, triggered: Mapping[int, Sequence[int]]) -> tuple[Any, list[int]]:
    """Return the vector table, and the handlers of all messages one after the other."""
    vectors = table(len(plan.messages), Vector)
    flat: list[int] = []
    vectors["by_group"], vectors["source"] = plan.by_pgn, plan.named_sources()
    for row in range(len(vectors)):
        mine = triggered.get(row, [])
        vectors[row]["first"], vectors[row]["count"] = len(flat), len(mine)
        vectors[row]["check"], vectors[row]["arrived_ns"] = -1, -1
        flat += mine
    return vectors, flat


def _pages(slots: Mapping[int, int], vectors: Any, plan: DecodePlan) -> Any:
    """Return the table of multiplexed signals that monitors wait for; the vectors say which are of their messages."""
    pages = table(len(slots), Page)
    vectors["page"] = -1
    for slot, k in slots.items():
        message = vectors[plan.slot_message[slot]]
        pages[k]["place"], pages[k]["slot"] = plan.positions[plan.slot_names[slot]], slot
        pages[k]["after"], message["page"] = message["page"], k
    return pages


def _checks(
    checks: Sequence[CheckInstance],
    buses: Sequence[BusInstance],
    plan: DecodePlan,
    databases: Mapping[int, Database],
    vectors: Any,
    faults: list[FaultSlot],
    crcs: protection.Tables,
    named: Collection[str],
) -> Any:
    """Return the table of message checks; their faults are appended to ``faults``."""
    rows = table(len(checks), Check)
    numbers: dict[tuple[int, str], int] = {}
    for k, check in enumerate(checks):
        sender = sender_of(check.params.message, databases[check.bus])
        rows[k]["sender"] = numbers.setdefault((check.bus, sender), len(numbers)) if sender else -1 - k
        vectors[plan.message(check.bus, check.params.message)]["check"] = k
        wake_ms = buses[check.bus].params.wake_ms if check.bus < len(buses) else 0.0
        faults += communication.fill(
            rows[k], check, plan, databases[check.bus], len(faults), crcs, wake_ms=wake_ms, named=named
        )
    communication.connect_synced(rows, checks)
    return rows


def _health(
    buses: Sequence[BusInstance], silences: Sequence[Silence], clock: ClockParams | None, faults: list[FaultSlot]
) -> Any:
    """Return the table of the buses' health, the gateway's own last; their faults are appended to ``faults``."""
    rows = table(len(buses) + 1, Health)
    codes = bus_health.codes_of([bus.params for bus in buses])
    for k, (bus, code, silence) in enumerate(zip(buses, codes, silences, strict=True)):
        faults += bus_health.fill(rows[k], bus, k, code, len(faults), silence)
    faults += clock_health.fill(rows[-1], clock, len(faults))
    return rows


def _strangers(
    databases: Sequence[tuple[int, Database]], buses: Sequence[BusInstance], made: _Handlers, pgn: Collection[int]
) -> dict[str, Any]:
    """Return what the buses know, and room for identifiers that they do not."""
    known = [(k, bus.known, bus.groups) for k, bus in enumerate(buses)]
    for each in made.emitted:
        flag = EXTENDED if each.message.is_extended_frame else 0
        known.append((each.bus, (each.message.frame_id | flag,), ()))
    watching = any(bus.params.watched and bus.params.unknown != "none" for bus in buses)
    keys, rows = known_table(databases if watching else (), known if watching else (), pgn)
    return {"known_keys": keys, "known_rows": rows, "strangers": table(MOST_STRANGERS + 1, UnknownId)}


def _watches(cycles: Sequence[CycleWatch], vectors: Any, plan: DecodePlan) -> dict[str, Any]:
    """Return what begins and ends operation cycles, and the cycles' state."""
    watches = fill_watches(cycles, vectors, plan)
    return {"watches": watches, "cycles": np.zeros(max(len(cycles), 1), np.uint8)}


@dataclass
class _Verdicts:
    """The debounces of all faults, with the conditions and root causes that their rows point to."""

    debounces: Any
    conditions: Any
    roots: NDArray[np.int32]


def _verdicts(
    faults: Sequence[FaultSlot],
    settings: Mapping[str, Mapping[str, Any]],
    gates: Mapping[str, Gate],
    plan: DecodePlan,
) -> _Verdicts:
    """Fill what makes a verdict of test results.

    Raises:
        InputError, InputErrors: a root cause that is no fault.
    """
    debounces = table(len(faults), DebounceRow)
    own_gates = [gates.get(slot.id, Gate()) for slot in faults]
    alike: dict[tuple[Debounce, int], list[int]] = {}
    for k, (slot, gate) in enumerate(zip(faults, own_gates, strict=True)):
        asked = slot.fault.debounce.changed(settings.get(slot.id, {}))
        alike.setdefault((asked, gate.trigger_fdc), []).append(k)
    for (asked, trigger_fdc), places in alike.items():
        one = debounces[places[0]]
        configure(one, asked, trigger_fdc=trigger_fdc)
        debounces[places[1:]] = one
    debounces["bus"] = [slot.bus for slot in faults]
    ids = {slot.id: k for k, slot in enumerate(faults)}
    _refuse_unknown_roots(gates, ids)
    return _Verdicts(debounces, *fill_gates(own_gates, debounces, ids, plan))


def _refuse_unknown_roots(gates: Mapping[str, Gate], ids: Mapping[str, int]) -> None:
    wrong = Gathered()
    for name, root in ((name, root) for name, gate in gates.items() for root in gate.roots):
        if root not in ids or root == name:
            text = named("no such fault; known:", root, set(ids) - {name})
            with wrong:
                raise InputError(text, key=f'fault."{name}".caused_by', value=root)
    wrong.check()


def _rows(rows: Sequence[Any], kind: type[Record]) -> Any:
    made = table(len(rows), kind)
    for k, row in enumerate(rows):
        made[k] = row
    return made


def _tables(plan: DecodePlan, made: _Handlers, verdicts: _Verdicts, crcs: protection.Tables, **others: Any) -> Tables:
    """Put all tables together; ``others`` are given as they are."""
    known = set(plan.message_names)
    emits, emit_signals = emission.fill(
        made.emitted, [(entry.bus, entry.message.name) in known for entry in made.emitted], crcs
    )
    outbox, outbox_cells = emission.outbox()
    out, clock = table(1, RESULTS), table(1, Clock)
    clock[0]["deadline_ns"] = NEVER
    timers, groups, members, heap = timers_of(
        [(CHECK, others["checks"]), (HANDLER, made.rows), (DEBOUNCE, verdicts.debounces), (HEALTH, others["health"])]
    )
    return Tables(
        keys=plan.keys,
        rows=plan.rows,
        messages=plan.messages,
        signals=plan.signals,
        mux_ids=plan.mux_ids,
        values=np.zeros(max(plan.max_signals, 1)),
        present=np.zeros(max(plan.max_signals, 1), np.uint8),
        mailbox=np.full(plan.n_slots + 1, np.nan),
        handlers=made.rows,
        slots=np.asarray(made.slots, np.int32),
        carried=np.asarray(made.carried, np.int32),
        samplers=_rows(made.samplers, Sampler),
        sampled=_rows(made.sampled, Sampled),
        held=np.full(max(made.held, 1), np.nan),
        sources=np.asarray(made.sources, np.int32),
        pool=made.pool,
        pool_ns=made.pool.view(np.int64),
        crc_tables=crcs.array(),
        debounces=verdicts.debounces,
        buckets=table(len(verdicts.debounces), Bucket),
        conditions=verdicts.conditions,
        roots=verdicts.roots,
        out=out,
        out_address=np.asarray([out.ctypes.data], np.int64),
        emits=emits,
        emit_signals=emit_signals,
        outbox=outbox,
        outbox_cells=outbox_cells,
        reports=table(MOST_REPORTS, Report),
        others=table(MOST_SOURCES, Source),
        woven=np.zeros((1, 2 + 8 * -(-LONGEST // 64)), np.uint64),
        timers=timers,
        groups=groups,
        members=members,
        heap=heap,
        clock=clock,
        **others,
    )
