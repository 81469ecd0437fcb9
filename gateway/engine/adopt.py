"""An engine goes on where another one, of a changed configuration, stops."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from gateway.engine.core import Engine
from gateway.engine.debounce import STATE as DEBOUNCE_STATE
from gateway.engine.tables import NEVER
from gateway.monitors.bus_health import watch_clock
from gateway.signals.tables import SignalRef

#: What of a communication check depends on the whole configuration rather than on the check.
_PLACES = ("fault", "bus", "counter")
_HEALTH_SETTINGS = ("fault", "most", "window_ns")
_EMIT_STATE = "next"


def adopt(new: Engine, old: Engine, buses: Mapping[int, int], cycles: Mapping[int, int]) -> None:
    """Take over the clock and the counters, and the state of all that both engines have.

    Args:
        new: has not run yet.
        old: between two calls; not to be used any more.
        buses: index of a bus in ``old`` -> its index in ``new``.
        cycles: index of an operation cycle in ``old`` -> its index in ``new``.
    """
    _clock(new, old)
    _signals(new, old, buses)
    _checks(new, old, buses)
    _monitors(new, old, buses)
    _faults(new, old)
    for before, now in buses.items():
        if before < len(old.tables.health) - 1 and now < len(new.tables.health) - 1:
            _copy(new.tables.health[now], old.tables.health[before], _HEALTH_SETTINGS)
    own = new.tables.health[-1]
    _copy(own, old.tables.health[-1], _HEALTH_SETTINGS)
    if old.tables.clock[0]["started"] and own["until"].min() == NEVER:  # watched from now on
        watch_clock(own, new.now_ns)
    for before, now in cycles.items():
        new.tables.cycles[now] = old.tables.cycles[before]


def _copy(target: Any, source: Any, without: tuple[str, ...]) -> None:
    for name in source.dtype.names:
        if name not in without:
            target[name] = source[name]


def _same(one: Any, other: Any, names: tuple[str, ...]) -> bool:
    return all(np.array_equal(one[name], other[name]) for name in names)


def _clock(new: Engine, old: Engine) -> None:
    clock = new.tables.clock[0]
    _copy(clock, old.tables.clock[0], ("timed", "held", "stop", "events", "sent", "fed", "taken"))
    clock["deadline_ns"] = clock["now_ns"]  # a lower bound: the next pass looks for the real one


def _signals(new: Engine, old: Engine, buses: Mapping[int, int]) -> None:
    slots = {ref: k for k, ref in enumerate(new.plan.slot_names)}
    for k, ref in enumerate(old.plan.slot_names):
        if ref.bus in buses:
            slot = slots.get(SignalRef(buses[ref.bus], ref.message, ref.signal))
            if slot is not None:
                new.tables.mailbox[slot] = old.tables.mailbox[k]
    for before, now in _messages(new, old, buses).items():
        new.tables.vectors[now]["arrived_ns"] = old.tables.vectors[before]["arrived_ns"]


def _messages(new: Engine, old: Engine, buses: Mapping[int, int]) -> dict[int, int]:
    rows = {key: k for k, key in enumerate(new.plan.message_names)}
    found = {}
    for k, (bus, name) in enumerate(old.plan.message_names):
        if bus in buses and (buses[bus], name) in rows:
            found[k] = rows[buses[bus], name]
    return found


def _checks(new: Engine, old: Engine, buses: Mapping[int, int]) -> None:
    now_ns = int(new.tables.clock[0]["now_ns"])
    settings = ("timeout_ns", "modulo", "max_step", "crc_byte", "crc_table", "data_id", "length")
    before_of = {now: before for before, now in _messages(new, old, buses).items()}
    for row, vector in enumerate(new.tables.vectors):
        if vector["check"] < 0:
            continue
        check = new.tables.checks[vector["check"]]
        if check["timeout_ns"] > 0 and old.tables.clock[0]["started"]:
            check["deadline_ns"] = now_ns + check["timeout_ns"]
        before = int(old.tables.vectors[before_of[row]]["check"]) if row in before_of else -1
        if before >= 0 and _same(check, old.tables.checks[before], settings):
            _copy(check, old.tables.checks[before], _PLACES)


def _monitors(new: Engine, old: Engine, buses: Mapping[int, int]) -> None:
    places = {instance.name: k for k, instance in enumerate(old.monitors)}
    for k, instance in enumerate(new.monitors):
        before = places.get(instance.name)
        if before is None or not _alike(instance, old.monitors[before], buses):
            continue
        new.state_of(k)[:] = old.state_of(before)
        handler, other = new.tables.handlers[k], old.tables.handlers[before]
        for name in ("tested", "wake_ns", "steps", "skipped"):
            handler[name] = other[name]
        if handler["emit"] >= 0 and other["emit"] >= 0:
            emit, sent = new.tables.emits[handler["emit"]], old.tables.emits[other["emit"]]
            if emit["modulo"] == sent["modulo"]:
                emit[_EMIT_STATE] = sent[_EMIT_STATE]


def _alike(one: Any, other: Any, buses: Mapping[int, int]) -> bool:
    return (
        one.monitor is other.monitor
        and type(one.params) is type(other.params)
        # Not the models themselves: they keep arrays that they have computed, which have no truth value.
        and one.params.model_dump() == other.params.model_dump()
        and one.signals == other.signals
        and buses.get(other.bus) == one.bus
    )


def _faults(new: Engine, old: Engine) -> None:
    places = {slot.id: k for k, slot in enumerate(old.faults)}
    settings = ("failed_after", "passed_after", "failed_step", "passed_step", "timed")
    for k, slot in enumerate(new.faults):
        before = places.get(slot.id)
        if before is None:
            continue
        row, other = new.tables.debounces[k], old.tables.debounces[before]
        if _same(row, other, settings):
            for name in DEBOUNCE_STATE:
                row[name] = other[name]
