"""An engine goes on where another one, of a changed configuration, stops.

Each record of the engine marks its fields: state, constants that the state is counted in, and places or settings that
the state does not depend on. State goes over where the constants are equal. Each state of a message's check has
constants of its own: a new timeout does not touch the state of the CRC.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gateway.engine.checks.bus_health import SILENT, SPOKEN, HealthState, await_anybody, watch_clock
from gateway.engine.checks.communication import COUNTED_IN
from gateway.engine.core import Engine
from gateway.engine.debounce import DebounceConst, DebounceState
from gateway.engine.emission import EmitConst, EmitState
from gateway.engine.gate import WatchConst, WatchState
from gateway.engine.samples import SamplerState
from gateway.engine.tables import NEVER, ClockState, HandlerState, PageState, Tables, VectorState
from gateway.engine.timers import note_all
from gateway.signals.tables import SignalRef
from gateway_fdi.jit import Record


def adopt(new: Engine, old: Engine, buses: Mapping[int, int], cycles: Mapping[int, int]) -> None:
    """Take over the clock and the counters, and the state of all that both engines have.

    Args:
        new: has not run yet.
        old: between two calls; not to be used any more.
        buses: index of a bus in ``old`` -> its index in ``new``.
        cycles: index of an operation cycle in ``old`` -> its index in ``new``.
    """
    old.count_runs()
    clock = new.tables.clock[0]
    _take(clock, old.tables.clock[0], ClockState)
    _signals(new, old, buses)
    _messages(new, old, buses)
    _monitors(new, old, buses)
    places = {slot.id: k for k, slot in enumerate(old.faults)}
    pairs = [(k, places[slot.id]) for k, slot in enumerate(new.faults) if slot.id in places]
    both = np.array(pairs, int).reshape(-1, 2)
    states, constants = DebounceState.dtype.names or (), DebounceConst.dtype.names or ()
    _take_all(new.tables.debounces, old.tables.debounces, both, {states: constants})
    new.tables.buckets[both[:, 0]] = old.tables.buckets[both[:, 1]]
    _health(new, old, buses)
    _cycles(new, old, buses, cycles)
    note_all(new.tables)


def _take(target: Any, source: Any, state: type[Record], const: type[Record] | None = None) -> bool:
    """Copy the state of a record, if its constants are equal; returns whether they are."""
    constants = () if const is None else const.dtype.names or ()
    if not all(np.array_equal(target[name], source[name]) for name in constants):
        return False
    for name in state.dtype.names or ():
        target[name] = source[name]
    return True


def _take_all(
    target: Any, source: Any, both: NDArray[np.int64], counted_in: Mapping[tuple[str, ...], tuple[str, ...]]
) -> None:
    """Copy states of many records of a table at once: there are thousands, and frames wait.

    Args:
        target: the table.
        source: the table before.
        both: rows that both have, shape (n, 2): in ``target``, in ``source``.
        counted_in: names of states: the constants that have to be equal, those of records within by their path.
    """
    for names, constants in counted_in.items():
        same = np.ones(len(both), np.bool_)
        for path in constants:
            same &= _of(target, path)[both[:, 0]] == _of(source, path)[both[:, 1]]
        mine, theirs = both[same].T
        for name in names:
            target[name][mine] = source[name][theirs]


def _of(table: Any, path: str) -> Any:
    for name in path.split("."):
        table = table[name]
    return table


def _signals(new: Engine, old: Engine, buses: Mapping[int, int]) -> None:
    slots = {ref: k for k, ref in enumerate(new.plan.slot_names)}
    for k, ref in enumerate(old.plan.slot_names):
        if ref.bus in buses:
            slot = slots.get(SignalRef(buses[ref.bus], ref.message, ref.signal))
            if slot is not None:
                new.tables.mailbox[slot] = old.tables.mailbox[k]
    pages = {int(page["slot"]): page for page in new.tables.pages}
    for before in old.tables.pages:
        ref = old.plan.slot_names[before["slot"]]
        slot = slots.get(SignalRef(buses[ref.bus], ref.message, ref.signal)) if ref.bus in buses else None
        if slot in pages:
            _take(pages[slot], before, PageState)


def _rows(new: Engine, old: Engine, buses: Mapping[int, int]) -> dict[int, int]:
    """Return the rows of messages that both have: in ``new`` -> in ``old``."""
    rows = {key: k for k, key in enumerate(new.plan.message_names)}
    return {
        rows[buses[bus], name]: k
        for k, (bus, name) in enumerate(old.plan.message_names)
        if bus in buses and (buses[bus], name) in rows
    }


def _messages(new: Engine, old: Engine, buses: Mapping[int, int]) -> None:
    now_ns, before = int(new.tables.clock[0]["now_ns"]), _rows(new, old, buses)
    pairs: list[tuple[int, int]] = []
    for row, vector in enumerate(new.tables.vectors):
        other = old.tables.vectors[before[row]] if row in before else None
        if other is not None:
            _take(vector, other, VectorState)
        if vector["check"] < 0:
            continue
        check = new.tables.checks[vector["check"]]
        if check["timeout_ns"] > 0 and old.tables.clock[0]["started"]:
            check["deadline_ns"] = now_ns + check["timeout_ns"]
        if other is not None and other["check"] >= 0:
            pairs.append((int(vector["check"]), int(other["check"])))
    _take_all(new.tables.checks, old.tables.checks, np.array(pairs, int).reshape(-1, 2), COUNTED_IN)
    rows = {theirs: mine for mine, theirs in before.items()}
    known = [other for other in old.tables.others if other["last_ns"] and int(other["row"]) in rows]
    for k, other in enumerate(known):
        new.tables.others[k] = other
        new.tables.others[k]["row"] = rows[int(other["row"])]


def _monitors(new: Engine, old: Engine, buses: Mapping[int, int]) -> None:
    places = {(instance.name, instance.part): k for k, instance in enumerate(old.monitors)}
    for k, instance in enumerate(new.monitors):
        before = places.get((instance.name, instance.part))
        if before is None or not _alike(instance, old.monitors[before], buses):
            continue
        new.state_of(k)[:] = old.state_of(before)
        handler, other = new.tables.handlers[k], old.tables.handlers[before]
        _take(handler, other, HandlerState)
        _take_samples(new.tables, handler, old.tables, other)
        if handler["emit"] >= 0 and other["emit"] >= 0:
            sent = old.tables.emits[other["emit"]]
            _take(new.tables.emits[handler["emit"]], sent, EmitState, EmitConst)


def _take_samples(new: Tables, handler: Any, old: Tables, other: Any) -> None:
    """Take over what has come of samples that are not there yet, and the inputs of the last one."""
    if handler["sampled"] == 0:
        return
    for mine, theirs in zip(_samplers(new, handler), _samplers(old, other), strict=True):
        _take(mine, theirs, SamplerState)
        cells = int(mine["cells"])
        new.held[mine["held"] :][:cells] = old.held[theirs["held"] :][:cells]
    last = int(handler["cells"] - handler["inputs"] + handler["slots"])
    new.pool[handler["inputs"] :][:last] = old.pool[other["inputs"] :][:last]


def _samplers(tables: Tables, handler: Any) -> list[Any]:
    """Return the rows of a monitor's samplings."""
    mine = tables.sampled[handler["first_sampled"] :][: handler["sampled"]]
    return [tables.samplers[k] for k in dict.fromkeys(mine["sampler"].tolist())]


def _alike(one: Any, other: Any, buses: Mapping[int, int]) -> bool:
    return (
        one.monitor is other.monitor
        and type(one.params) is type(other.params)
        # Not the models themselves: they keep arrays that they have computed, which have no truth value.
        and one.params.model_dump() == other.params.model_dump()
        and one.signals == other.signals
        and buses.get(other.bus) == one.bus
    )


def _health(new: Engine, old: Engine, buses: Mapping[int, int]) -> None:
    for before, now in buses.items():
        if before < len(old.tables.health) - 1 and now < len(new.tables.health) - 1:
            _take(new.tables.health[now], old.tables.health[before], HealthState)
            if new.tables.health[now]["quiet_ns"] != old.tables.health[before]["quiet_ns"]:
                _hear_again(new, now)
    for added in set(range(len(new.tables.health) - 1)) - set(buses.values()):
        health = new.tables.health[added]
        health["heard_ns"] = new.now_ns
        await_anybody(health, new.now_ns)
    own = new.tables.health[-1]
    _take(own, old.tables.health[-1], HealthState)
    if old.tables.clock[0]["started"] and own["until"].min() == NEVER:  # watched from now on
        watch_clock(own, new.now_ns)


def _hear_again(new: Engine, bus: int) -> None:
    """Start the silence of a bus again if it is judged otherwise: messages would wait for the old end of it."""
    health, checks = new.tables.health[bus], new.tables.checks
    health["heard_ns"], health["silence"], health["asleep"] = new.now_ns, SPOKEN, 0
    health["until"][SILENT] = NEVER
    rest = int(health["bad"]) & ~(1 << SILENT)
    health["bad"] = rest | 1 << SILENT if health["quiet_ns"] > 0 else rest
    parked = (checks["bus"] == bus) & (checks["parked_ns"] > 0)
    checks["deadline_ns"][parked] = new.now_ns + checks["timeout_ns"][parked]
    checks["parked_ns"][parked] = 0


def _cycles(new: Engine, old: Engine, buses: Mapping[int, int], cycles: Mapping[int, int]) -> None:
    for before, now in cycles.items():
        new.tables.cycles[now] = old.tables.cycles[before]
    watched = {
        (cycles[cycle], buses[ref.bus], ref.message, ref.signal, begins): watch
        for cycle, ref, begins, watch in _watches(old)
        if cycle in cycles and ref.bus in buses
    }
    for cycle, ref, begins, watch in _watches(new):
        other = watched.get((cycle, *ref, begins))
        if other is not None:
            _take(watch, other, WatchState, WatchConst)


def _watches(engine: Engine) -> Iterator[tuple[int, SignalRef, int, Any]]:
    """Yield what begins or ends operation cycles: cycle, signal, whether it begins, its record."""
    count = int(engine.tables.vectors["watches"].sum())
    for watch in engine.tables.watches[:count]:
        yield (
            int(watch["cycle"]),
            engine.plan.slot_names[watch["slot"]],
            int(watch["begins"]),
            watch,
        )
