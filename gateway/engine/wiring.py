"""What monitors are connected to: the signals of the buses that their inputs stand for."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from gateway.engine.instances import MonitorInstance
from gateway.errors import InputError, nearest
from gateway.monitors.conformance import connections
from gateway.monitors.contract import Signal
from gateway.signals.database import Database
from gateway.signals.tables import SignalRef


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


def wire(m: MonitorInstance, databases: Mapping[int, Database], buses: Mapping[str, int]) -> Wired:
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
                raise InputError(f"the monitor has no such signal{nearest(name, known)}", value=name)
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
