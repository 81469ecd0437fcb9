"""Frames to a target and back: on a bus in real time, or inside this process on a clock of its own."""

from __future__ import annotations

import select
import time
from importlib import import_module
from typing import NamedTuple, Protocol, cast

from gateway.bus.base import send_all
from gateway.bus.frames import empty, payload, put
from gateway.bus.uri import open_bus
from gateway_fdi.errors import InputError

#: Most frames taken at a time.
_BATCH = 256


class Heard(NamedTuple):
    """A frame of others: its stamp [ns], identifier with EXTENDED, payload."""

    t_ns: int
    can_id: int
    data: bytes


class Wire(Protocol):
    """The way to a target: what ``inside:MODULE:FUNCTION`` returns."""

    def now_ns(self) -> int:
        """Return the time [ns], by the clock that stamps frames."""

    def send(self, can_id: int, data: bytes) -> None:
        """Send a frame; the identifier has EXTENDED."""

    def wait(self, ns: int) -> list[Heard]:
        """Return frames as soon as some have come; none after this time."""

    def close(self) -> None:
        """End it."""


class BusWire:
    """A bus of this machine.

    Args:
        uri: as ``gateway run --bus`` takes it.

    Raises:
        InputError, UnsupportedError, BusError: as :func:`gateway.bus.uri.open_bus` does.
    """

    def __init__(self, uri: str) -> None:
        self._bus = open_bus(uri)
        self._frames = empty(_BATCH)

    def now_ns(self) -> int:
        """Return the wall clock, which stamps the frames, too [ns]."""
        return time.time_ns()

    def send(self, can_id: int, data: bytes) -> None:
        """Send a frame."""
        made = empty(1)
        put(made, 0, self.now_ns(), can_id, data)
        send_all(self._bus, made)

    def wait(self, ns: int) -> list[Heard]:
        """Return frames as soon as some have come; none after this time."""
        until = time.monotonic_ns() + ns
        while True:
            count = self._bus.receive(self._frames)
            if count:
                some = self._frames[:count]
                return [Heard(int(one["t_ns"]), int(one["can_id"]), payload(one)) for one in some]
            rest = until - time.monotonic_ns()
            if rest <= 0:
                return []
            select.select([self._bus.fileno()], [], [], rest / 1e9)

    def close(self) -> None:
        """Leave the bus."""
        self._bus.close()


def wire_of(uri: str) -> Wire:
    """Open the way to a target.

    Args:
        uri: of a bus, or ``inside:MODULE:FUNCTION[:ARGUMENT]``, which returns a :class:`Wire`.

    Raises:
        InputError: there is no such function; the errors of :class:`BusWire`.
    """
    kind, _, rest = uri.partition(":")
    if kind != "inside":
        return BusWire(uri)
    module, _, name = rest.partition(":")
    name, _, argument = name.partition(":")
    try:
        function = getattr(import_module(module), name)
    except (ImportError, AttributeError, ValueError) as error:
        raise InputError(f"inside:MODULE:FUNCTION names what makes a wire: {error}", key="target", value=uri) from error
    return cast(Wire, function(argument) if argument else function())
