"""Locks: a client that changes something has the component for itself, and its session as long as it has the lock.

A lock is of the client whose token made it. It keeps the session alive (tester present); when it ends, the session is
the default one. Where this process is killed, the gateway ends the sessions of its testers, as their reader has gone.
"""

from __future__ import annotations

import asyncio
import contextlib
import secrets
from collections.abc import Awaitable, Callable
from dataclasses import dataclass

from gateway.servers.uds.nrc import Nrc
from gateway_serve.link import Refused
from gateway_serve.sovd.components import Component
from gateway_serve.sovd.errors import SovdError

#: Tester present is sent as often within the time of a session.
_OFTEN = 3
#: Refusals that say that the session is another one.
_SESSIONS = (Nrc.SERVICE_NOT_SUPPORTED_IN_SESSION, Nrc.SUB_FUNCTION_NOT_SUPPORTED_IN_SESSION)

#: Asks by UDS: takes the client, the ECU and the request; returns the positive response.
Ask = Callable[[str, str, bytes], Awaitable[bytes]]


@dataclass
class Lock:
    """One lock.

    Attributes:
        id: drawn at random.
        who: the client.
        component: that it has.
        until_s: when it ends, of the loop's clock.
        extended: whether the session is not the default one.
        level: security level that was unlocked.
        dtcs: whether the client has left the setting of DTCs on.
    """

    id: str
    who: str
    component: Component
    until_s: float
    extended: bool = False
    level: int = 0
    dtcs: bool = True

    def forget_session(self) -> None:
        """Take it that the session is over, and what it had set."""
        self.extended, self.level, self.dtcs = False, 0, True


class Locks:
    """The locks of all components.

    Args:
        ask: asks by UDS.
        s3_s: returns how long a session lasts without requests [s].
    """

    def __init__(self, ask: Ask, s3_s: Callable[[], float]) -> None:
        self._ask, self._s3_s = ask, s3_s
        self._held: dict[str, Lock] = {}
        self._work: set[asyncio.Task[None]] = set()

    def of(self, component: str) -> Lock | None:
        """Return the lock of a component, by its id."""
        lock = self._held.get(component)
        return None if lock is None or lock.until_s <= asyncio.get_running_loop().time() else lock

    def take(self, component: Component, who: str, seconds: int) -> Lock:
        """Lock a component.

        Raises:
            SovdError: it is locked.
        """
        if self.of(component.id) is not None:
            raise SovdError(409, "this component is locked")
        lock = Lock(secrets.token_urlsafe(9), who, component, 0.0)
        self.prolong(lock, seconds)
        self._held[component.id] = lock
        work = asyncio.create_task(self._keep(lock))
        self._work.add(work)
        work.add_done_callback(self._work.discard)
        return lock

    def prolong(self, lock: Lock, seconds: int) -> None:
        """Have a lock end so long after now [s]."""
        lock.until_s = asyncio.get_running_loop().time() + seconds

    async def release(self, lock: Lock) -> None:
        """End a lock, and its session."""
        if self._held.get(lock.component.id) is lock:
            del self._held[lock.component.id]
            if lock.extended:
                await self._say(lock, b"\x10\x01")

    def own(self, who: str, component: Component) -> Lock:
        """Return the lock that a client needs to change something.

        Raises:
            SovdError: it has none.
        """
        lock = self.of(component.id)
        if lock is None or lock.who != who:
            held = "it is another client's" if lock is not None else "there is none"
            raise SovdError(403, f"this needs a lock of the component, and {held}")
        return lock

    async def intervene(self, who: str, component: Component, request: bytes) -> bytes:
        """Ask for something that changes something, in an extended session, where one can be begun.

        Raises:
            SovdError: the client has no lock, or it is refused.
        """
        lock = self.own(who, component)
        begun = lock.extended
        await self._begin(lock)
        try:
            return await self._ask(who, component.ecu, request)
        except SovdError as error:
            if not begun or (error.parameters or {}).get("nrc") not in _SESSIONS:
                raise
        lock.forget_session()
        await self._begin(lock)
        return await self._ask(who, component.ecu, request)

    async def _begin(self, lock: Lock) -> None:
        if not lock.extended:
            with contextlib.suppress(SovdError):  # what is asked then may be allowed without it
                await self._ask(lock.who, lock.component.ecu, b"\x10\x03")
                lock.extended, lock.level = True, 0

    async def _keep(self, lock: Lock) -> None:
        loop = asyncio.get_running_loop()
        while self._held.get(lock.component.id) is lock:
            left_s = lock.until_s - loop.time()
            if left_s <= 0:
                await self.release(lock)
                return
            await asyncio.sleep(min(left_s, self._s3_s() / _OFTEN))
            if lock.extended and lock.until_s > loop.time():
                await self._say(lock, b"\x3e\x00")

    async def _say(self, lock: Lock, request: bytes) -> None:
        with contextlib.suppress(SovdError, Refused):  # its session is over by itself then
            await self._ask(lock.who, lock.component.ecu, request)
