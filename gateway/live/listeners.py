"""Several doors as one: status socket, report socket, DoIP, for a loop that waits for one descriptor.

Here is the second wall: each door keeps an exception to the peer that it came of; one that comes through all the same
costs the door its turn. A door that fails again and again rests between its turns, then it is closed and opened again.
"""

from __future__ import annotations

from selectors import EVENT_READ
from typing import Any, Protocol

from gateway.bus.frames import Frames
from gateway.common.fence import Fence
from gateway.host.waiting import NONE, Selector
from gateway.live.loop import Door
from gateway.runtime.app import Gateway
from gateway_fdi.common.log import get_logger

#: First and longest rest of a door after a turn that failed [s]; turns in a row that fail before it is opened again.
FIRST_REST_S, LONGEST_REST_S, MOST_FAILURES = 0.1, 10.0, 5

#: Name of the call that makes the status socket: of its path, the gateway, how the buses do, and most readers.
STATUS_SOCKET = "status_socket"

log = get_logger(__name__)


class OpenDoor(Door, Protocol):
    """A door that can be opened again; ``name`` is that of its exceptions."""

    name: str

    def restart(self) -> None:
        """End all connections, and listen again. Raises GatewayError: it cannot now."""


class TableDoor(OpenDoor, Protocol):
    """A door that a table of the configuration asks for; it stays over a reload, where it fits."""

    def fits(self, params: Any) -> bool:
        """Return whether it can be that of another configuration."""

    def replace(self, gateway: Gateway, params: Any) -> None:
        """Belong to another gateway from now on."""

    def close(self) -> None:
        """Close it."""


class StatusDoor(OpenDoor, Protocol):
    """The socket on which the daemon shows what it does."""

    def report(self, event: dict[str, Any]) -> None:
        """Show an event of the JSON contract to all readers."""

    def replace(self, gateway: Gateway) -> None:
        """Show another gateway from now on."""

    def close(self) -> None:
        """Close it."""


class _Place:
    """A door, the turns in a row that failed, and until when it rests; ``fd``: watched, NONE: not."""

    def __init__(self, door: OpenDoor) -> None:
        self.door, self.fd = door, NONE
        self.failures, self.rests_until_s = 0, 0.0


class Listeners:
    """The doors that are open now.

    Args:
        fence: counts what the second wall catches.
    """

    def __init__(self, fence: Fence | None = None) -> None:
        self._fence = fence or Fence()
        self._selector = Selector()
        self._open: list[_Place] = []

    def add(self, door: OpenDoor) -> None:
        """Open one more."""
        self._open.append(_Place(door))
        self._watch(self._open[-1])

    def remove(self, door: OpenDoor) -> None:
        """Take one out, which is closed after that."""
        (place,) = [each for each in self._open if each.door is door]
        self._forget(place)
        self._open.remove(place)

    def _watch(self, place: _Place) -> None:
        place.fd = place.door.fileno()
        if place.fd != NONE:
            self._selector.register(place.fd, EVENT_READ, place)

    def _forget(self, place: _Place) -> None:
        if place.fd != NONE:
            self._selector.unregister(place.fd)
            place.fd = NONE

    def fileno(self) -> int:
        """Return a descriptor that is readable when a client wants something of any; NONE: they must be asked."""
        return self._selector.fileno()

    def listening(self) -> bool:
        """Return whether a watcher is there who is shown the time, or a door that must be asked."""
        return any(place.fd == NONE or place.door.listening() for place in self._open)

    def on_frames(self, frames: Frames) -> None:
        """Take what came from the buses, or goes there."""
        for place in self._open:
            try:
                place.door.on_frames(frames)
            except Exception as error:
                self._fence.note(place.door.name, error, "frames", second=True)

    def turn(self, now_s: float, *, wanted: bool) -> None:
        """Do what is due, without waiting; ``wanted``: whether the descriptor was readable."""
        asked = {id(key.data) for key, _ in self._selector.select(0)} if wanted else set()
        for place in list(self._open):
            if now_s < place.rests_until_s:
                continue
            try:
                if place.failures:
                    self._go_on(place)
                place.door.turn(now_s, wanted=id(place) in asked or place.fd == NONE or bool(place.failures))
            except Exception as error:
                self._rest(place, error, now_s)
            else:
                place.failures = 0

    def _go_on(self, place: _Place) -> None:
        """Have a door go on after a rest; one that has failed again and again is opened again."""
        if place.failures >= MOST_FAILURES:
            place.door.restart()
            log.warning("a door was opened again", door=place.door.name)
        if place.fd == NONE:
            self._watch(place)

    def _rest(self, place: _Place, error: Exception, now_s: float) -> None:
        """Give a door no turn for a while: it would keep the loop busy."""
        self._fence.note(place.door.name, error, "the whole door", second=True)
        self._forget(place)
        place.failures += 1
        place.rests_until_s = now_s + min(FIRST_REST_S * 2 ** (place.failures - 1), LONGEST_REST_S)

    def close(self) -> None:
        """Forget them; they are closed by whom they belong to."""
        self._selector.close()
