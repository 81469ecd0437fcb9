"""What all faults of an engine depend on."""

from __future__ import annotations

from collections.abc import Sequence

from gateway.engine.checks.bus_health import BusInstance
from gateway.engine.checks.communication import CheckInstance
from gateway.engine.depends.communication import of_bus, of_check
from gateway.engine.depends.monitors import of_monitor
from gateway.engine.depends.parts import Network, Seen, component, strongest
from gateway.engine.instances import FaultSlot, MonitorInstance
from gateway.signals.database import Database


def dependences(
    faults: Sequence[FaultSlot],
    databases: Sequence[Database],
    monitors: Sequence[MonitorInstance],
    checks: Sequence[CheckInstance],
    buses: Sequence[BusInstance],
) -> dict[str, tuple[Seen, ...]]:
    """Return what each fault's test sees, the component that it sees best first, by the fault's id.

    Args:
        faults: of the engine.
        databases: of each bus.
        monitors: as the engine has them.
        checks: of messages.
        buses: in the order of their indices.

    Raises:
        InputError: what a monitor's author says of it is wrong.
    """
    network = Network([bus.name for bus in buses], dict(enumerate(databases)))
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
    return {slot.id: found[slot.id] for slot in faults}
