"""Wires of a bench's frames: nothing but this process, or real buses in real time."""

from __future__ import annotations

import select
import time
from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np

from gateway.bus.base import Bus, send_all
from gateway.bus.frames import Frames, empty
from gateway.bus.uri import open_bus, parse_uri
from gateway_fdi.errors import BusError, InputError, UnsupportedError, named

#: A step that is later than this [s] stops the bench's clock for as long: a test is not to fail because a machine is
#: busy.
LATE_S = 0.02
#: How long frames that were sent are waited for, where the bench hears itself [s].
PATIENCE_S = 10.0


class Wires(Protocol):
    """Frames go in as the virtual ECUs send them, and come out as the gateway gets them."""

    def carry(self, frames: Frames, until_ns: int) -> Frames:
        """Send frames, let time pass until ``until_ns`` of the bench's clock; returns what arrived, in its order."""

    def send(self, frames: Frames) -> None:
        """Send what the gateway sends."""

    def close(self) -> None:
        """Close what is open."""


class Inside:
    """Frames arrive as they were sent, when they were sent; time costs nothing."""

    def carry(self, frames: Frames, until_ns: int) -> Frames:
        """Return the frames."""
        return frames

    def send(self, frames: Frames) -> None:
        """Do nothing: no others are there."""

    def close(self) -> None:
        """Nothing is open."""


class Outside:
    """Real buses: virtual ECUs send on them, the gateway hears what is on them, real ECUs and testers take part.

    Each bus is opened twice, once for the ECUs, once for the gateway. A bus that can be opened once only (most
    adapters) is
    shared: the gateway then gets the ECUs' frames when they are sent.

    Args:
        uris: of the buses, in the configuration's order.

    Raises:
        InputError, BusError: a bus that cannot be opened.
    """

    def __init__(self, uris: Sequence[str]) -> None:
        self._ours: list[Bus] = []
        self._ecus: list[Bus | None] = []
        self._begun, self._until_ns, self._last_ns = 0.0, 0, 0
        try:
            for index, uri in enumerate(uris):
                self._ours.append(open_bus(uri, index))
                self._ecus.append(_second(uri, index))
        except BaseException:
            self.close()
            raise
        self._begun = time.monotonic()
        self._batch = empty(1024)

    def carry(self, frames: Frames, until_ns: int) -> Frames:
        """Send frames when their time has come, and take what arrives until then.

        Frames are stamped with the bench's time when they arrive, none after this step: the buses of adapters have
        clocks of their own.

        Raises:
            BusError: a bus is gone, or takes nothing.
        """
        self._until_ns = until_ns
        late = time.monotonic() - self._begun - until_ns / 1e9
        if late > LATE_S:
            self._begun += late
        arrived: list[Frames] = []
        while (rest := self._begun + until_ns / 1e9 - time.monotonic()) > 0:
            arrived += self._heard(rest)
        for index, ecu in enumerate(self._ecus):
            mine = frames[frames["bus"] == index]
            if len(mine):
                send_all(ecu or self._ours[index], mine)
                if ecu is None:
                    arrived.append(self._stamped(mine.copy()))
        missing = sum(len(frames[frames["bus"] == k]) for k, ecu in enumerate(self._ecus) if ecu is not None)
        arrived += self._back(missing)
        return np.concatenate([empty(0), *arrived])

    def _back(self, missing: int) -> list[Frames]:
        """Wait for at least this number of frames: the ECUs' frames are to be judged in this step."""
        found: list[Frames] = []
        limit = time.monotonic() + PATIENCE_S
        while missing > 0:
            parts = self._heard(0.05)
            missing -= sum(len(part) for part in parts)
            found += parts
            if time.monotonic() > limit:
                raise BusError(f"{self._ours[0].uri}: frames that were sent did not arrive")
        return found

    def _heard(self, timeout_s: float) -> list[Frames]:
        ready, _, _ = select.select([bus.fileno() for bus in self._ours], [], [], timeout_s)
        found = []
        for bus in self._ours:
            count = len(self._batch) if bus.fileno() in ready else 0
            while count == len(self._batch):
                count = bus.receive(self._batch)
                found.append(self._stamped(self._batch[:count].copy()))
        return [part for part in found if len(part)]

    def _stamped(self, frames: Frames) -> Frames:
        """Return frames stamped with the bench's time, which does not go back."""
        now = min(round((time.monotonic() - self._begun) * 1e9), self._until_ns)
        now = max(now, self._last_ns, 1)
        frames["t_ns"] = self._last_ns = now
        return frames

    def send(self, frames: Frames) -> None:
        """Send what the gateway sends.

        Raises:
            BusError: the bus is gone, or takes nothing.
        """
        for index, bus in enumerate(self._ours):
            mine = frames[frames["bus"] == index]
            if len(mine):
                send_all(bus, mine)

    def close(self) -> None:
        """Close all buses."""
        for bus in (*self._ours, *self._ecus):
            if bus is not None:
                bus.close()
        self._ours, self._ecus = [], []


def _second(uri: str, index: int) -> Bus | None:
    """Return the ECUs' own end of a bus, None where it can be opened once only."""
    try:
        bus = open_bus(uri, index)
    except UnsupportedError:
        raise
    except (BusError, InputError):
        return None
    bus.set_filters([0x1FFFFFFF | 0x80000000])  # virtual ECUs listen by the gateway's end
    return bus


def uris_of(given: Sequence[str], buses: Mapping[str, int]) -> list[str]:
    """Return the URI of each bus, in the configuration's order.

    Args:
        given: ``URI``, or ``NAME=URI`` for each of several buses.
        buses: name -> index.

    Raises:
        InputError: no URI, a bus that is not there, or one without a URI.
    """
    found: dict[str, str] = {}
    for text in given:
        name, equals, uri = text.partition("=")
        if not equals or ":" in name:  # a URI's own options have a =, too
            if len(buses) > 1:
                names = ", ".join(buses)
                raise InputError(f"NAME=URI for each: the buses are {names}", key="--gateway-bus", value=text)
            name, uri = next(iter(buses)), text
        if name not in buses:
            raise InputError(named("the buses are", name, buses), key="--gateway-bus", value=name)
        parse_uri(uri)
        found[name] = uri
    missing = [name for name in buses if name not in found]
    if missing:
        raise InputError(f"no URI for {', '.join(missing)}", key="--gateway-bus")
    return [found[name] for name in buses]
