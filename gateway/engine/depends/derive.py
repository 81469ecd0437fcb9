"""What all faults of an engine depend on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

from gateway.engine.checks.bus_health import BusInstance
from gateway.engine.checks.communication import CheckInstance
from gateway.engine.depends.communication import of_bus, of_check
from gateway.engine.depends.configured import configured
from gateway.engine.depends.monitors import of_monitor
from gateway.engine.depends.params import DiagnosisParams
from gateway.engine.depends.parts import Network, Seen, component, strongest
from gateway.engine.depends.residuals import Read, residuals
from gateway.engine.depends.underlying_tests import Tests, behind
from gateway.engine.instances import FaultSlot, MonitorInstance
from gateway.signals.database import Database
from gateway.signals.tables import SignalRef


class Dependences(NamedTuple):
    """What tests depend on.

    Attributes:
        seen: fault id -> what its test sees, the component that it sees best first.
        read: fault id -> what reads its residual, of those that have one.
        behind: tests that faults are made of.
    """

    seen: dict[str, tuple[Seen, ...]]
    read: dict[str, Read]
    behind: tuple[Tests, ...]


def dependences(
    faults: Sequence[FaultSlot],
    databases: Sequence[Database],
    monitors: Sequence[MonitorInstance],
    checks: Sequence[CheckInstance],
    buses: Sequence[BusInstance],
    params: DiagnosisParams,
) -> Dependences:
    """Return what each fault's test depends on.

    Args:
        faults: of the engine.
        databases: of each bus.
        monitors: as the engine has them.
        checks: of messages.
        buses: in the order of their indices.
        params: what the configuration says of it.

    Raises:
        InputError, InputErrors: what a monitor's author or the configuration says of it is wrong.
    """
    protections = {
        SignalRef(check.bus, check.params.message, part.signal)
        for check in checks
        for part in (check.params.counter, check.params.crc, check.params.checksum)
        if part is not None and part.signal is not None
    }
    limited = {(check.bus, check.params.message) for check in checks if check.params.most is not None}
    network = Network([bus.name for bus in buses], dict(enumerate(databases)), protections, limited)
    found: dict[str, tuple[Seen, ...]] = {}
    for m in monitors:
        found |= {f"{m.name}.{name}": seen for name, seen in of_monitor(m, network).items()}
    of_message = {check.name: check for check in checks}
    number = {bus.name: k for k, bus in enumerate(buses)}
    for slot in faults:
        owner, _, name = slot.id.rpartition(".")
        if slot.id in found:
            continue
        if owner in of_message:
            found[slot.id] = strongest(of_check(of_message[owner], name, network))
        elif owner in number:
            found[slot.id] = strongest(of_bus(number[owner], name, network))
        else:  # of the gateway itself, or reported by another process
            found[slot.id] = (Seen(component("reported", owner, name), 0.9, "nothing more is known of it"),)
    tests = behind(monitors, network)
    every = {slot.id: found[slot.id] for slot in faults}
    whole = configured(every | {name: seen for one in tests for name, seen in one.seen.items()}, params, network)
    return Dependences(
        {fault: whole[fault] for fault in every},
        residuals(monitors, network),
        tuple(replace(one, seen={name: whole[name] for name in one.seen}) for one in tests),
    )
