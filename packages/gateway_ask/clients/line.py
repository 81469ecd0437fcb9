"""The line to one ECU, as those see it that pass requests of testers on."""

from __future__ import annotations

from collections.abc import Callable

from gateway_ask.clients.ecu import EcuClient
from gateway_ask.clients.forwarded_requests import Done, ForwardedRequests, is_quiet


class Line:
    """One line.

    Args:
        client: of the ECU.
        may_ask: whether a bus may be asked now.
        plan: has the clients look again at what is due.
    """

    def __init__(self, client: EcuClient, may_ask: Callable[[int], bool], plan: Callable[[], None]) -> None:
        self._client, self._may_ask, self._plan = client, may_ask, plan
        self.name = client.params.name

    @property
    def part_ms(self) -> int:
        """How long a request may wait behind one that is under way, and for the least time after it [ms]."""
        return round(self._client.params.p2_ms + self._client.waiting.apart_ns / 1e6)

    @property
    def is_open(self) -> bool:
        """Whether the ECU can be reached now: its bus lives, and may be asked."""
        return self._may_ask(self._client.bus)

    def ask(self, request: bytes, owner: object, done: Done) -> bool:
        """Have a request sent; returns whether there is room for it.

        Args:
            request: at most 4095 bytes.
            owner: the tester.
            done: takes each answer; None: none comes any more.
        """
        taken = self._client.waiting.put(ForwardedRequests(request, owner, done))
        self._plan()
        return taken

    def forget(self, owner: object) -> None:
        """Take out what a tester that has gone had asked."""
        self._client.waiting.forget(owner)

    def is_quiet(self, request: bytes) -> bool:
        """Return whether no good answer comes to a request."""
        return is_quiet(request)
