"""Gates: whether a fault's test results count, and when an operation cycle begins and ends.

A gate is closed while the fault's operation cycle has not begun or is over, while an enable condition is not met, its
signal is unknown or overdue, or while a root cause is there or on its way (its fault detection counter above 0): so a
broken sensor's own fault comes first, and the faults of what is computed from it stay quiet.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import isnan
from typing import Any

import numpy as np

from gateway.engine.debounce import fault_detection_counter
from gateway.engine.tables import table
from gateway.monitors.contract import FAILED
from gateway.signals.tables import DecodePlan, SignalRef
from gateway_fdi.jit import Record, f8, i4, kernel, means, u1

#: States of an operation cycle that signals begin and end. LEFT: a process that died left it open, and neither signal
#: has come yet that says whether it goes on.
OVER, OPEN, LEFT = range(3)
#: How a condition counts: NOW: its message must be there; AWAKE, SUPPLIED: by the last value that came, none is met; of
#: those that say AWAKE one must be met, of all others each. MOVING closes no gate: it is asked by :func:`moves`.
NOW, AWAKE, SUPPLIED, MOVING = range(4)


class ConditionRow(Record):
    """One enable condition."""

    counts: u1 = means("NOW, AWAKE, SUPPLIED or MOVING")

    slot: i4 = means("mailbox slot of its signal")
    row: i4 = means("row of its message")
    low: f8 = means("least value that meets it")
    high: f8 = means("greatest value that meets it")


class WatchPlace(Record):
    """Places in other tables."""

    cycle: i4 = means("operation cycle")
    slot: i4 = means("mailbox slot of its signal")
    bus: u1 = means("number of the bus")


class WatchConst(Record):
    """When: the slot is in the closed range, and has risen by ``rise`` above its lowest value since it last was so."""

    begins: u1 = means("state of the operation cycle after it: OPEN or OVER")
    low: f8 = means("least value")
    high: f8 = means("greatest value")
    rise: f8 = means("what it has to rise by")


class WatchState(Record):
    """State of the signal."""

    lowest: f8 = means("lowest value since it last was so")


class Watch(WatchState, WatchConst, WatchPlace):
    """Begins or ends an operation cycle by a signal."""


@dataclass(frozen=True)
class Condition:
    """A signal in a closed range, in its own unit; ``rise``: and by this above its lowest value; ``counts``: as NOW."""

    signal: SignalRef
    low: float = -np.inf
    high: float = np.inf
    rise: float = 0.0
    counts: int = NOW


@dataclass(frozen=True)
class Gate:
    """When a fault's test results count.

    Attributes:
        conditions: all must be met.
        roots: ids of faults that may cause this one.
        resets: whether closing resets what was counted; else it is frozen.
        trigger_fdc: fault detection counter at which the freeze frame is wanted, 0: at a verdict only.
        cycle: index of the operation cycle outside of which they do not count, -1: they do in any.
    """

    conditions: tuple[Condition, ...] = ()
    roots: tuple[str, ...] = ()
    resets: bool = False
    trigger_fdc: int = 0
    cycle: int = -1


@dataclass(frozen=True)
class CycleWatch:
    """Begin and end of an operation cycle."""

    begins: Condition
    ends: Condition


@kernel
def is_valid(T: Any, t_ns: int, row: int) -> bool:
    """Return whether a message has arrived and is not overdue."""
    v = T.vectors[row]
    if v.arrived_ns < 0:
        return False
    if v.check >= 0:
        timeout = T.checks[v.check].timeout_ns
        if timeout > 0 and t_ns - v.arrived_ns > timeout:
            return False
    return True


@kernel
def sleeps(T: Any, d: Any) -> bool:
    """Return whether the power that a fault's test asks for is missing: the vehicle sleeps, or the voltage is wrong."""
    asked = awake = False
    for k in range(d.first_condition, d.first_condition + d.conditions):
        c = T.conditions[k]
        if c.counts in (NOW, MOVING):
            continue
        value = T.mailbox[c.slot]
        met = isnan(value) or c.low <= value <= c.high
        if c.counts == AWAKE:
            asked, awake = True, awake or met
        elif not met:
            return True
    return asked and not awake


@kernel
def said_awake(T: Any, d: Any) -> bool:
    """Return whether signals say that the vehicle is awake, for a fault whose test asks for that."""
    for k in range(d.first_condition, d.first_condition + d.conditions):
        c = T.conditions[k]
        if c.counts == AWAKE and c.low <= T.mailbox[c.slot] <= c.high:
            return True
    return False


@kernel
def moves(T: Any, t_ns: int) -> bool:
    """Return whether a signal says now that the vehicle moves."""
    for k in range(T.conditions.shape[0]):
        c = T.conditions[k]
        if c.counts == MOVING and is_valid(T, t_ns, c.row) and c.low <= T.mailbox[c.slot] <= c.high:
            return True
    return False


@kernel
def closed(T: Any, t_ns: int, d: Any) -> bool:
    """Return whether the gate of a fault is closed.

    Args:
        T: the tables.
        t_ns: now.
        d: the fault's record of DebounceRow.
    """
    if T.clock[0].held == 1:
        return True
    if d.cycle >= 0 and T.cycles[d.cycle] != OPEN:
        return True
    powered = True
    for k in range(d.first_condition, d.first_condition + d.conditions):
        c = T.conditions[k]
        if c.counts != NOW:
            powered = False
        elif not is_valid(T, t_ns, c.row) or not c.low <= T.mailbox[c.slot] <= c.high:
            return True
    if not powered and sleeps(T, d):
        return True
    for k in range(d.first_root, d.first_root + d.roots):
        root = T.debounces[T.roots[k]]
        if root.active == 1 or fault_detection_counter(root, t_ns) > 0:
            return True
    return False


@kernel
def is_lasting(T: Any, d: Any) -> bool:
    """Return whether the gate of a fault, open now, stays open until the clock counts a change that gates ask for.

    One that asks for a signal does not: it would have to be asked again. A cause must not be on its way.
    """
    for k in range(d.first_root, d.first_root + d.roots):
        root = T.debounces[T.roots[k]]
        if root.active == 1 or root.counter > 0 or (root.timed == 1 and root.direction == FAILED):
            return False
    return bool(d.conditions == 0)


def fill_gates(gates: Sequence[Gate], debounces: Any, ids: Mapping[str, int], plan: DecodePlan) -> tuple[Any, Any]:
    """Fill the gates of all faults; returns the tables of conditions and of roots."""
    conditions = [condition for gate in gates for condition in gate.conditions]
    roots = [ids[name] for gate in gates for name in gate.roots]
    for name in ("conditions", "roots"):
        counts = np.array([len(getattr(gate, name)) for gate in gates])
        debounces[name], debounces[f"first_{name[:-1]}"] = counts, counts.cumsum() - counts
    debounces["cycle"] = [gate.cycle for gate in gates]
    debounces["gated"] = [bool(gate.conditions or gate.roots or gate.cycle >= 0) for gate in gates]
    debounces["resets"] = [gate.resets for gate in gates]
    debounces["is_root"][roots] = 1
    made = table(max(len(conditions), 1), ConditionRow)
    for row, condition in zip(made, conditions, strict=False):
        slot = plan.slot(*condition.signal)
        row["slot"], row["row"] = slot, plan.slot_message[slot]
        row["low"], row["high"], row["counts"] = condition.low, condition.high, condition.counts
    return made, np.asarray(roots or [0], np.int32)


def fill_watches(cycles: Sequence[CycleWatch], vectors: Any, plan: DecodePlan) -> Any:
    """Fill what begins and ends the operation cycles, in order of the messages; returns the table."""
    asked = [
        (int(plan.slot_message[plan.slot(*condition.signal)]), begins, index, condition)
        for index, cycle in enumerate(cycles)
        for begins, condition in ((1, cycle.begins), (0, cycle.ends))
    ]
    # An end before a beginning: a cycle that one frame both ends and begins starts again.
    asked.sort(key=lambda entry: entry[:3])
    watches = table(max(len(asked), 1), Watch)
    for k, (row, begins, index, condition) in enumerate(asked):
        w = watches[k]
        w["cycle"], w["begins"] = index, begins
        w["slot"] = plan.slot(*condition.signal)
        w["bus"] = condition.signal.bus
        w["low"], w["high"], w["rise"] = condition.low, condition.high, condition.rise
        w["lowest"] = np.inf
        if vectors[row]["watches"] == 0:
            vectors[row]["first_watch"] = k
        vectors[row]["watches"] += 1
    return watches
