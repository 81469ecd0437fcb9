"""Connections of monitors: the signals of the buses that their inputs stand for."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import NamedTuple

from pydantic import BaseModel

from gateway.engine.instances import MonitorInstance
from gateway.monitors.conformance import connections, samplings_of
from gateway.monitors.contract import Signal
from gateway.monitors.sampling import Sampling
from gateway.signals.database import Database
from gateway.signals.tables import SignalRef
from gateway_fdi.common.tomlfile import key_path
from gateway_fdi.errors import Gathered, InputError, nearest, under


class Wired(NamedTuple):
    """Inputs that a monitor wants from the buses, as the user names them.

    Attributes:
        triggers: messages (bus, name) that step it.
        inputs: the signal of each number of its inputs, None: nothing.
        optional: messages that need not come.
        takes_nan: whether it steps with messages whose values are not valid.
        fields: of the inputs, of each of these numbers.
        samplings: how its frames become samples; none: each frame steps it.
        counters: the frame counters for that.
    """

    triggers: set[tuple[int, str]]
    inputs: list[SignalRef | None]
    optional: set[tuple[int, str]]
    takes_nan: bool
    fields: list[str]
    samplings: tuple[Sampling, ...]
    counters: tuple[SignalRef, ...]


def wire(m: MonitorInstance, databases: Mapping[int, Database], buses: Mapping[str, int]) -> Wired:
    """Find what a monitor is connected to.

    Raises:
        InputError, InputErrors: a signal or message that is not there, another unit, a name that the monitor does not
            know.
    """
    connected = connections(m.monitor, m.params)
    samplings = samplings_of(m.monitor, m.params)
    counters = [Signal(name, spare=sampling.spare) for sampling in samplings for name in sampling.counters]
    known = {signal.name for _, signal in connected.inputs if signal is not None} | {each.name for each in counters}
    inputs: list[SignalRef | None] = []
    places: dict[str, tuple[int, str]] = {}  # default name of a message -> where it is
    triggers: set[tuple[int, str]] = set()
    optional: set[tuple[int, str]] = set()
    key = m.key or f'monitor "{m.name}"'
    wrong = Gathered()
    for name in m.signals:
        if name not in known:
            text = f"the monitor has no such signal{nearest(name, known)}"
            with wrong:
                raise InputError(text, key=f"{key}.signals", value=name)
    wrong.check()
    for _, signal in connected.inputs:
        place: SignalRef | None = None
        with wrong:
            place = None if signal is None else _wanted(m, signal, databases, buses, key)
        inputs.append(place)
        if signal is None or place is None:
            continue
        message = signal.name.rpartition(".")[0]
        places[message] = (place.bus, place.message)
        if signal.optional:
            optional.add((place.bus, place.message))
        if signal.triggers:
            triggers.add((place.bus, place.message))
    places_of_counters: list[SignalRef] = []
    for signal in counters:
        with wrong:
            place = _wanted(m, signal, databases, buses, key)
            places_of_counters += [] if place is None else [place]
    wrong.check()
    triggers |= {places.get(name, (m.bus, name)) for name in connected.messages}
    for bus, name in triggers:
        own = written(m.params, name)
        with under(f"{key}.{own}" if own else key, name):
            databases[bus].message(name)
    given = [signal for _, signal in connected.inputs if signal is not None]
    takes_nan = bool(given) and all(signal.may_be_nan for signal in given)
    names = [name.partition("[")[0] for name, _ in connected.inputs]
    return Wired(triggers, inputs, optional, takes_nan, names, samplings, tuple(places_of_counters))


def _wanted(
    m: MonitorInstance, signal: Signal, databases: Mapping[int, Database], buses: Mapping[str, int], key: str
) -> SignalRef | None:
    """Return the signal that an input stands for; None: it is a spare one, without a name and without a sender."""
    try:
        return _found(m, signal, databases, buses, key)
    except InputError:
        if not signal.spare or signal.name in m.signals:
            raise
    return None


def _found(
    m: MonitorInstance, signal: Signal, databases: Mapping[int, Database], buses: Mapping[str, int], key: str
) -> SignalRef:
    """Return the signal that an input stands for.

    Raises:
        InputError: it is not there, or has another unit; the key is where the configuration says it, or can.
    """
    asked = m.signals.get(signal.name, signal.name)
    own = None if signal.name in m.signals else written(m.params, signal.name)
    mapping = f'signals."{signal.name}"'
    with under(f"{key}.{own or mapping}", asked):
        place = _split(asked, m.bus, buses)
        told = databases[place.bus].signal(place.message, place.signal).unit or ""
        if signal.unit is not None and signal.unit != told:
            raise InputError(f'its unit is "{told}" in the database, the plant wants "{signal.unit}"')
    return place


def written(params: BaseModel, text: str) -> str | None:
    """Return the key of the parameters, ``input[0].signal``, that has a text; None: it is of none of them."""

    def look(value: object, place: tuple[int | str, ...]) -> tuple[int | str, ...] | None:
        if value == text:
            return place
        inside: Iterable[tuple[int | str, object]] = ()
        if isinstance(value, BaseModel):
            inside = ((name, getattr(value, name)) for name in value.model_fields_set)
        elif isinstance(value, tuple):
            inside = enumerate(value)
        return next((found for name, one in inside if (found := look(one, (*place, name)))), None)

    found = look(params, ())
    return key_path(found) if found else None


def _split(reference: str, bus: int, buses: Mapping[str, int]) -> SignalRef:
    """Read ``Message.Signal`` of a bus, or ``bus.Message.Signal``."""
    parts = reference.split(".")
    if len(parts) == 3 and parts[0] in buses:
        return SignalRef(buses[parts[0]], parts[1], parts[2])
    if len(parts) == 3:
        text = f"the buses are {', '.join(buses)}{nearest(parts[0], buses)}"
        raise InputError(text, value=reference)
    if len(parts) != 2:
        raise InputError('a signal is named "Message.Signal"', value=reference)
    return SignalRef(bus, parts[0], parts[1])
