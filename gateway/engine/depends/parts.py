"""Components by name, and the way of a value to its test: sender, message, signal."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

from gateway.engine.checks.bus_sleep import NOBODY
from gateway.j1939.frame import NULL
from gateway.signals.database import Database
from gateway.signals.tables import SignalRef
from gateway_fdi.diagnosis.system import Component
from gateway_fdi.errors import InputError

#: Probability that a test fails if the part that it is there for is at fault: of all faults of a monitor that blame it,
#: one does.
OWN = 0.9
#: Likewise of a connected signal, where the monitor does not say what it sees: its pass clears little.
CONNECTED = 0.3
#: Of a fault of the message that carries the value, and of its sender: few of their faults make values wrong that
#: arrive, and pass all checks.
OF_MESSAGE, OF_SENDER = 0.02, 0.02
#: Of a second sender of the message: values of both come in turn, so that no failure lasts (0 of 46 that were
#: put beside the senders of two cars).
OF_SECOND = 0.02


class Seen(NamedTuple):
    """That a test sees a component.

    Attributes:
        component: with its kind.
        power: probability that the test fails if it alone is faulty.
        why: how that is known, for people.
        via: name of the one component whose error it sees then, as of a message the signal; "": several, or itself.
    """

    component: Component
    power: float
    why: str
    via: str = ""


def component(kind: str, *path: str) -> Component:
    """Return a component by its kind, and the names on the way to it."""
    return Component(f"{kind} {'.'.join(path)}", kind)


class Network:
    """Buses with their databases.

    Args:
        names: of the buses.
        databases: of each bus.
        protections: signals that are checksums and counters of their messages.
        limited: messages (bus, name) of which a second sender is told.
    """

    def __init__(
        self,
        names: Sequence[str],
        databases: Mapping[int, Database],
        protections: Collection[SignalRef] = (),
        limited: Collection[tuple[int, str]] = (),
    ) -> None:
        self.names, self.databases, self._protections = tuple(names), databases, frozenset(protections)
        self._limited = frozenset(limited)

    def bus(self, bus: int) -> Component:
        """Return a bus."""
        return component("bus", self.names[bus])

    def senders(self, bus: int, message: str) -> list[Component]:
        """Return the ECUs that send a message, by the database; none: it does not say."""
        try:
            found = self.databases[bus].message(message).senders
        except InputError:  # of a monitor's own message, from another database
            return []
        named = [component("ecu", self.names[bus], name) for name in found if name not in NOBODY]
        return named or self._by_address(bus, message)

    def _by_address(self, bus: int, message: str) -> list[Component]:
        """Return the ECU that has the source address of a J1939 message."""
        found = self.databases[bus].message(message)
        address = found.frame_id & 0xFF
        known = found.protocol == "j1939" and address < NULL
        return [component("ecu", self.names[bus], f"0x{address:02X}")] if known else []

    def unnamed(self, bus: int) -> Component:
        """Return an ECU that no database names."""
        return component("ecu", self.names[bus], "unnamed")

    def second_sender(self, bus: int, message: str) -> Component:
        """Return what sends a message beside its own sender."""
        return component("second sender", self.names[bus], message)

    def frozen(self, bus: int, message: str) -> Component:
        """Return a message as it fails where its sender repeats one payload; it is told as the message."""
        return replace(component("frozen", self.names[bus], message), of=self.message(bus, message).name)

    def message(self, bus: int, message: str) -> Component:
        """Return a message."""
        return component("message", self.names[bus], message)

    def signal(self, ref: SignalRef) -> Component:
        """Return a signal: its value, what measures or computes it; a protection is wrong as its message is."""
        if ref in self._protections:
            return self.message(ref.bus, ref.message)
        return component("signal", self.names[ref.bus], ref.message, ref.signal)

    def behind(self, ref: SignalRef, power: float) -> Iterator[Seen]:
        """Yield a signal that a test sees with some power, with what is on the way from it to the test."""
        own = self.signal(ref)
        yield Seen(own, power, "what it measures")
        yield Seen(self.message(ref.bus, ref.message), OF_MESSAGE * power, f"carries {ref.signal}", own.name)
        for sender in self.senders(ref.bus, ref.message):
            yield Seen(sender, OF_SENDER * power, f"sends {ref.message}", own.name)
        if (ref.bus, ref.message) in self._limited:
            second = self.second_sender(ref.bus, ref.message)
            yield Seen(second, OF_SECOND * power, "another one sends it, too", own.name)


def strongest(seen: Iterable[Seen]) -> tuple[Seen, ...]:
    """Return each component once, as it is seen best, the best first."""
    best: dict[str, Seen] = {}
    for one in seen:
        known = best.get(one.component.name, one)
        stronger = one if one.power > known.power else known
        best[one.component.name] = stronger._replace(via=one.via if one.via == known.via else "")
    return tuple(sorted(best.values(), key=lambda one: -one.power))
