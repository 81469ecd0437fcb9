"""What checks of messages depend on, and the health of buses."""

from __future__ import annotations

from collections.abc import Iterator

from gateway.engine.checks.communication import CheckInstance
from gateway.engine.checks.kinds import KIND_OF
from gateway.engine.depends.parts import Network, Seen, component

#: Probability that a message is missing, if the ECU is dead that sends some of those whose sender nobody names.
_UNNAMED = 0.05
#: Probability that a second sender is seen: all of 164 that were put beside the senders of two cars. Where only frames
#: that repeat the content before are counted, 116 of 117 that repeat something, 1 of 43 that send something new.
_SECOND, _CHANGED = 0.99, 0.6
#: Fault of a bus -> probability that it fails if the bus is at fault.
_HEALTH = {"bus_off": 0.5, "bus_passive": 0.5, "bus_errors": 0.5, "bus_lost": 0.9, "bus_silent": 0.99}


def of_check(check: CheckInstance, fault: str, network: Network) -> Iterator[Seen]:
    """Yield what a check of a message depends on."""
    name = check.params.message
    message = network.message(check.bus, name)
    powers = KIND_OF[fault].powers
    if powers is None:
        yield Seen(component("model", network.names[check.bus], name, "checksum"), 0.9, "its rule, as configured")
        return
    if fault in ("early", "second_sender"):
        most = check.params.most
        power = _CHANGED if most is not None and most.repeats else _SECOND
        yield Seen(network.second_sender(check.bus, name), power, "another one sends it, too")
    if fault == "counter":
        yield Seen(network.frozen(check.bus, name), 0.999, "its counter stands, too")
    of_message, of_sender = powers
    yield Seen(message, of_message, "the message itself")
    for sender in network.senders(check.bus, name):
        yield Seen(sender, of_sender, f"sends {name}")
    if fault == "timeout" and not network.senders(check.bus, name):
        yield Seen(network.unnamed(check.bus), _UNNAMED, f"may send {name}")


def of_bus(bus: int, fault: str, network: Network) -> Iterator[Seen]:
    """Yield what the health of a bus depends on."""
    if fault in _HEALTH:
        yield Seen(network.bus(bus), _HEALTH[fault], "the bus itself")
    elif fault == "unknown":
        yield Seen(component("stranger", network.names[bus]), 0.9, "a sender that does not belong to the bus")
    else:
        yield Seen(component("gateway", "queues"), 0.9, "the gateway did not read in time")
