"""Several doors as one: status socket, report socket, DoIP, for a loop that waits for one descriptor."""

from __future__ import annotations

from selectors import EVENT_READ
from typing import Any, Protocol

from gateway.bus.frames import Frames
from gateway.host.waiting import NONE, Selector
from gateway.live.loop import Door
from gateway.runtime.app import Gateway


class TableDoor(Door, Protocol):
    """A door that a table of the configuration asks for; it stays over a reload, where it fits."""

    def fits(self, params: Any) -> bool:
        """Return whether it can be that of another configuration."""

    def replace(self, gateway: Gateway, params: Any) -> None:
        """Belong to another gateway from now on."""

    def close(self) -> None:
        """Close it."""


class Doors:
    """The doors that are open now."""

    def __init__(self) -> None:
        self._selector = Selector()
        self._open: list[Door] = []

    def add(self, door: Door) -> None:
        """Open one more."""
        if door.fileno() != NONE:
            self._selector.register(door.fileno(), EVENT_READ, door)
        self._open.append(door)

    def remove(self, door: Door) -> None:
        """Take one out, which is closed after that."""
        if door.fileno() != NONE:
            self._selector.unregister(door.fileno())
        self._open.remove(door)

    def fileno(self) -> int:
        """Return a descriptor that is readable when a client wants something of any; NONE: they must be asked."""
        return self._selector.fileno()

    def listening(self) -> bool:
        """Return whether a watcher is there who is shown the time, or a door that must be asked."""
        return any(door.fileno() == NONE or door.listening() for door in self._open)

    def on_frames(self, frames: Frames) -> None:
        """Take what came from the buses, or goes there."""
        for door in self._open:
            door.on_frames(frames)

    def turn(self, now_s: float, *, wanted: bool) -> None:
        """Do what is due, without waiting; ``wanted``: whether the descriptor was readable."""
        asked = {id(key.data) for key, _ in self._selector.select(0)} if wanted else set()
        for door in list(self._open):
            door.turn(now_s, wanted=id(door) in asked or door.fileno() == NONE)

    def close(self) -> None:
        """Forget them; they are closed by whom they belong to."""
        self._selector.close()
