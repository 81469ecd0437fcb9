"""Subscriptions of clients: which resource, how often or on which change, and until when."""

from __future__ import annotations

import asyncio
import secrets
from dataclasses import dataclass, field
from typing import Literal

from gateway_serve.sovd.errors import SovdError

#: Subscriptions at a time.
MOST = 32


@dataclass
class Subscription:
    """One.

    Attributes:
        kind: "cyclic-subscriptions" or "triggers".
        who: the client that made it.
        resource: its address.
        every_s: how often it is looked at [s].
        until_s: when it ends, of the loop's clock.
        interval: "fast", "normal" or "slow"; of a trigger "fast".
        condition: of a trigger: "OnChange", "EnterRange" or "LeaveRange".
        bounds: of a range: lower and upper.
        id: drawn at random.
        open: whether somebody listens.
    """

    kind: str
    who: str
    resource: str
    every_s: float
    until_s: float
    interval: Literal["fast", "normal", "slow"] = "fast"
    condition: str = ""
    bounds: tuple[float, float] = (0.0, 0.0)
    id: str = field(default_factory=lambda: secrets.token_urlsafe(9))
    open: bool = False


class Subscriptions:
    """All that have not ended."""

    def __init__(self) -> None:
        self._all: dict[str, Subscription] = {}

    def all(self) -> list[Subscription]:
        """Return them, the oldest first."""
        now_s = asyncio.get_running_loop().time()
        self._all = {key: each for key, each in self._all.items() if each.until_s > now_s}
        return list(self._all.values())

    def add(self, one: Subscription) -> None:
        """Keep one more.

        Raises:
            SovdError: there are too many.
        """
        if len(self.all()) >= MOST:
            raise SovdError(409, f"there are {MOST} subscriptions already")
        self._all[one.id] = one

    def remove(self, one: Subscription) -> None:
        """End one; its stream ends, too."""
        one.until_s = 0.0
        self._all.pop(one.id, None)
