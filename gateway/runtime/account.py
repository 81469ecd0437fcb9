"""A gateway's account of itself: its monitors and servers, and at the end its results."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Protocol

from gateway.config.answer_bus import AnswerBus
from gateway.config.model import Config
from gateway.engine.core import Engine
from gateway.engine.depends.parts import Seen
from gateway.faults.catalogue import Catalogue, as_dict
from gateway.faults.memory import FaultMemory
from gateway.faults.recorder import Recorder
from gateway.faults.status import Status
from gateway.runtime.persistence import Persistence
from gateway.servers.identifiers import Identifiers
from gateway.servers.uds.extended_data import EXTENDED_DATA


def description(config: Config, catalogue: Catalogue, identifiers: Identifiers) -> dict[str, Any]:
    """Return what testers and other programs need to know: faults, identifiers, extended data."""
    return {
        "name": config.name,
        "faults": [as_dict(definition) for definition in catalogue],
        "identifiers": identifiers.describe(),
        "extended_data": [
            {"record": number, "name": kind.name, "length": kind.length} for number, kind in EXTENDED_DATA.items()
        ],
    }


def signal_slots(config: Config, engine: Engine) -> dict[str, int]:
    """Return mailbox slots of the signals by full name; with the bus if there are several."""
    buses = config.buses
    return {
        ("" if len(buses) == 1 else f"{buses[ref.bus].name}.") + f"{ref.message}.{ref.signal}": slot
        for slot, ref in enumerate(engine.plan.slot_names)
    }


class Counts(Protocol):
    """A part that counts."""

    def counters(self) -> dict[str, int]:
        """Return what it counted, by name."""


def counters(
    engine: Engine,
    speakers: Sequence[Counts],
    upkeep: Persistence,
    recorder: Recorder | None,
) -> dict[str, int]:
    """Return what was counted, by name: of frames, requests, security, the fault memory, and others' reports."""
    found = engine.counters()
    for name, count in (pair for each in speakers for pair in each.counters().items()):
        found[name] = found.get(name, 0) + count
    found["memory_not_stored"] = upkeep.not_stored
    found["memory_write_failures"] = upkeep.failures
    if recorder is not None:
        found["recordings_refused"] = recorder.refused
    return found


def bus_errors(config: Config, engine: Engine) -> dict[str, dict[str, int]]:
    """Return what each bus's controller said of errors, how often."""
    return {
        bus.name: {name: n for name, n in engine.error_counters(k).items() if n} for k, bus in enumerate(config.bus)
    }


def unread(config: Config, answers: Sequence[AnswerBus]) -> list[str]:
    """Return which signals of answers are not decoded, and which reads have no layout, one line each."""
    found = [text for bus in answers for text in bus.left_out]
    for ecus, of_bus in zip(config.answered.values(), answers, strict=True):
        for k, lengths in zip(ecus, of_bus.lengths, strict=True):
            ecu = config.ecu[k]
            names = [read.name for read in ecu.read if read.key not in lengths and read.pgn is None]
            found += [f"ecu[{k}]: no layout of {', '.join(names)}: answers are only counted"] if names else []
    return found


#: Why a test has no result in an operation cycle, for people.
NEVER_CAME, SWITCHED_OFF = "a message of theirs never came", "their monitor is switched off"
NOT_MET, TOO_LITTLE = "their conditions were not met for long enough", "too little came for a result"


def not_judged(
    engine: Engine, memory: FaultMemory, depends: Mapping[str, Sequence[Seen]], buses: Sequence[str]
) -> Iterator[str]:
    """Yield why, for each test without a result in this operation cycle.

    Args:
        engine: that has run.
        memory: has the status bytes.
        depends: fault id -> what its test sees.
        buses: names of the buses.
    """
    tables = engine.tables
    names = [f"message {buses[bus]}.{name}" for bus, name in engine.plan.message_names]
    silent = {name for name, row in zip(names, tables.vectors, strict=False) if row["arrived_ns"] < 0}
    off = {
        instance.name for instance, row in zip(engine.monitors, tables.handlers, strict=False) if row["off"]
    }  # fmt: skip
    for slot, row in zip(engine.faults, tables.debounces, strict=False):
        if not memory.status_now(slot.id) & Status.NOT_COMPLETED_THIS_CYCLE:
            continue
        if slot.id.partition(".")[0] in off:
            yield SWITCHED_OFF
        elif any(seen.component.name in silent for seen in depends.get(slot.id, ())):
            yield NEVER_CAME
        else:
            yield NOT_MET if row["conditions"] else TOO_LITTLE
