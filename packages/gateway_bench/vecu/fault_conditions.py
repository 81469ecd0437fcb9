"""Faults of a plant by a condition, where its frames are made beforehand: when it holds is found out first.

The condition is of what is on the bus without these faults, as that of a signal's fault is. A fault is there once for
each time that the condition holds.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from inspect import get_annotations

import numpy as np

from gateway.bus.frames import EXTENDED, Frames
from gateway.signals.database import Database
from gateway_bench.vecu.conditions import Condition
from gateway_bench.vecu.contract import EcuFault
from gateway_bench.vecu.message_faults import MessageFault
from gateway_bench.vecu.registry import VIRTUAL_ECUS
from gateway_bench.vecu.scenario import Scenario
from gateway_fdi.errors import InputError, under

#: Place in the scenario, fault.
Placed = tuple[int, EcuFault]


def plant_faults(scenario: Scenario) -> tuple[list[Placed], list[Placed]]:
    """Return the faults of plants: those that can be put in at once, and those that wait for their condition.

    Raises:
        InputError: one that cannot have a condition.
    """
    types = {ecu.name: ecu.type for ecu in scenario.ecu}
    ready: list[Placed] = []
    waiting: list[Placed] = []
    for place, fault in enumerate(scenario.fault):
        if isinstance(fault, MessageFault):
            continue
        fields = type(fault).model_fields
        if fault.when is None or _minds(type(fault)):
            ready.append((place, fault))
            continue
        if VIRTUAL_ECUS[types[fault.ecu]].begin is not None or not {"from_s", "to_s"} <= fields.keys():
            text = f"a fault {fault.kind} of an ECU of type {types[fault.ecu]} goes by time only"
            raise InputError(text, key=f"fault[{place}].when", value=fault.when)
        waiting.append((place, fault))
    return ready, waiting


def _minds(model: type[EcuFault]) -> bool:
    """Return whether an ECU that hears sees to the condition itself: its model declares it again."""
    declaring = [each for each in model.__mro__ if "when" in get_annotations(each)]
    return declaring[0] is not EcuFault


def resolved(
    waiting: Sequence[Placed], buses: Mapping[str, int], frames: Frames, databases: Mapping[int, Database]
) -> list[Placed]:
    """Return faults by time that stand for those by a condition.

    Args:
        waiting: place in the scenario, fault.
        buses: name of an ECU -> index of its bus.
        frames: of all ECUs whose frames are made beforehand, without these faults, in order of time.
        databases: of the buses.

    Raises:
        InputError: a condition that is none, or of signals that none of these ECUs sends.
    """
    found: list[Placed] = []
    for place, fault in waiting:
        key, text, bus = f"fault[{place}].when", str(fault.when), buses[fault.ecu]
        with under(key, text):
            condition = Condition(text, bus, databases[bus])
        there = set(frames["can_id"][frames["bus"] == bus].tolist())
        for name in condition.messages:
            message = databases[bus].message(name)
            if message.frame_id | (EXTENDED if message.is_extended_frame else 0) not in there:
                why = f"no virtual ECU sends {name} without listening: this plant's faults go by values known before"
                raise InputError(why, key=key, value=text)
        condition.take(frames)
        found += [(place, part) for part in _parts(fault, condition.spans())]
    return found


def _parts(fault: EcuFault, spans: Sequence[tuple[int, int | None]]) -> list[EcuFault]:
    """Return a fault by time for each span of time [ns] in which a fault's condition holds."""
    begin = getattr(fault, "from_s", None) or 0.0
    last = getattr(fault, "to_s", None)
    parts = []
    for first_ns, end_ns in spans:
        from_s = max(begin, first_ns * 1e-9)
        to_s = min(np.inf if last is None else last, np.inf if end_ns is None else end_ns * 1e-9)
        if from_s < to_s:
            times = {"from_s": from_s, "to_s": None if np.isinf(to_s) else to_s, "when": None}
            parts.append(fault.model_copy(update=times))
    return parts
