"""What the faults of a monitor depend on: as its isolation knows it, or all that is connected."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from itertools import chain

from gateway.engine.depends.parts import CONNECTED, OWN, Network, Seen, component, strongest
from gateway.engine.instances import MonitorInstance
from gateway.engine.wiring import wire
from gateway.monitors.conformance import checked_faults, connections
from gateway.monitors.contract import Behind, Blame, Blames
from gateway.signals.tables import SignalRef
from gateway_fdi.diagnosis.system import Component
from gateway_fdi.errors import InputError, nearest


def of_monitor(m: MonitorInstance, network: Network) -> dict[str, tuple[Seen, ...]]:
    """Return what each fault of a monitor depends on, by the fault's name.

    Raises:
        InputError: its author's word on it is wrong: a fault that it does not have, a share that is none.
    """
    faults = [fault.name for fault in checked_faults(m.monitor, m.params)]
    inputs = inputs_of(m, network)
    known = _known(m, faults, inputs)
    count = Counter(one.part for blamed in known.values() for one in blamed if one.share == 1.0)
    found = {}
    for name in faults:
        if name in known:
            parts = (_blamed(m, one, inputs, network, count[one.part]) for one in known[name])
            seen = chain.from_iterable(parts)
        else:
            seen = chain(_connected(m, name, inputs, network, len(faults) - len(known)))
        found[name] = strongest(seen)
    return found


def inputs_of(m: MonitorInstance, network: Network) -> dict[str, SignalRef]:
    """Return the signals of a monitor by the names that it has for them."""
    numbers = {name: k for k, name in enumerate(network.names)}
    wired = wire(m, network.databases, numbers).inputs
    own = connections(m.monitor, m.params).inputs
    return {signal.name: ref for (_, signal), ref in zip(own, wired, strict=True) if signal is not None and ref}


def _is_blame(one: object) -> bool:
    return isinstance(one, Blame) and 0.0 < OWN * one.share <= 1.0


def _known(m: MonitorInstance, faults: Sequence[str], inputs: Mapping[str, SignalRef]) -> Mapping[str, Sequence[Blame]]:
    capability = m.monitor.capability(Blames)
    if capability is None:
        return {}
    given: object = capability.of(m.params)
    _check(m, "Blames", given, inputs, faults)
    assert isinstance(given, Mapping)
    return given


def _check(
    m: MonitorInstance, what: str, given: object, inputs: Mapping[str, SignalRef], faults: Sequence[str] | None = None
) -> None:
    """Raise InputError unless an author's word on whom faults, or tests, blame can be right."""
    key = f'monitor type "{m.monitor.type}".{what}.of'
    if not isinstance(given, Mapping):
        text = f"names of faults and what they blame, not {type(given).__name__}"
        raise InputError(text, file=m.monitor.file, key=key)
    for name, blamed in given.items():
        if faults is not None and name not in faults:
            text = f"the monitor has no such fault{nearest(str(name), faults)}"
            raise InputError(text, file=m.monitor.file, key=key, value=name)
        if not isinstance(blamed, tuple | list) or not all(map(_is_blame, blamed)):
            text = "a tuple of Blame, each with a share above 0, at most 1.1"
            raise InputError(text, file=m.monitor.file, key=f"{key}.{name}", value=blamed)
        for one in blamed:
            if not one.kind and one.part not in inputs:
                text = f"no such signal is connected; a part of another kind says which{nearest(one.part, inputs)}"
                raise InputError(text, file=m.monitor.file, key=f"{key}.{name}", value=one.part)


def part_of(m: MonitorInstance, part: str, kind: str, inputs: Mapping[str, SignalRef], network: Network) -> Component:
    """Return the component that a monitor calls a part of some kind; "": a connected signal."""
    ref = inputs.get(part)
    if not kind:
        return network.signal(inputs[part])
    if kind in ("message", "frozen") and ref is not None:
        return (network.message if kind == "message" else network.frozen)(ref.bus, ref.message)
    if ref is not None:
        return component(kind, network.names[ref.bus], ref.message, ref.signal)
    return component(kind, m.name, part)


def of_tests(m: MonitorInstance, network: Network) -> dict[str, tuple[Seen, ...]]:
    """Return what the tests depend on that a monitor's faults are made of, by the tests' names.

    Raises:
        InputError: its author's word on it is wrong.
    """
    capability = m.monitor.capability(Behind)
    if capability is None:
        return {}
    inputs = inputs_of(m, network)
    given = capability.of(m.params)
    _check(m, "Behind", given, inputs)
    return {
        name: strongest(chain.from_iterable(_blamed(m, one, inputs, network, 1) for one in blamed))
        for name, blamed in given.items()
    }


def _blamed(
    m: MonitorInstance, one: Blame, inputs: Mapping[str, SignalRef], network: Network, count: int
) -> Iterator[Seen]:
    power = OWN * one.share / (max(count, 1) if one.share == 1.0 else 1)
    if one.kind:
        yield Seen(part_of(m, one.part, one.kind, inputs, network), power, "as the monitor says")
    else:
        yield from network.behind(inputs[one.part], power)


def _connected(
    m: MonitorInstance, fault: str, inputs: Mapping[str, SignalRef], network: Network, count: int
) -> Iterator[Seen]:
    for ref in inputs.values():
        yield from network.behind(ref, CONNECTED / max(count, 1))
    own = (m.name, fault) if m.part else (m.name,)
    yield Seen(component("model", *own), OWN / max(count, 1), "taken for granted")
