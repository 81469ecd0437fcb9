"""What the handlers of the services see and change."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field

from gateway.faults.memory import FaultMemory
from gateway.servers.identifiers import Identifiers
from gateway.servers.tester_control import TesterControl
from gateway.servers.uds.params import SESSIONS, Access, UdsParams
from gateway.servers.uds.security import Security

DEFAULT = SESSIONS["default"]


@dataclass
class EventLogic:
    """Response on event (0x86): what it waits for and what it answers then.

    ``set_up`` is (status mask, service to respond to); ``until_ns`` the end of its window, None: for ever.
    """

    set_up: tuple[int, bytes] | None = None
    window: int = 0x02
    started: bool = False
    until_ns: int | None = None


@dataclass
class Context:
    """State of the server, and what it serves."""

    params: UdsParams
    memory: FaultMemory
    identifiers: Identifiers
    control: TesterControl
    security: Security
    now_ns: int = 0
    session: int = DEFAULT
    events: EventLogic = field(default_factory=EventLogic)
    routines_done: dict[int, bytes] = field(default_factory=dict)

    def enter(self, session: int) -> None:
        """Change the session: security locks, and the default session undoes what others had set."""
        self.security.lock()
        self.session = session
        if session == DEFAULT:
            self.control.set_dtcs(True)
            self.control.set_communication(receive=True, send=True)
            self.events.started = False
            self.routines_done.clear()


class Later:
    """An answer that takes its time: 0x78 now, and what ``work`` returns when there is time for it."""

    def __init__(self, work: Callable[[], bytes]) -> None:
        self.work = work


#: Takes the request, with its service identifier; returns what follows the response's.
Handler = Callable[[Context, bytes], "bytes | Later"]
#: Sub-functions of a service by number, with the sessions each is allowed in.
SubFunctions = Mapping[int, Collection[int]]

ANY_SESSION = frozenset(SESSIONS.values())
NOT_DEFAULT = ANY_SESSION - {DEFAULT}


@dataclass(frozen=True)
class Service:
    """One service.

    Attributes:
        sid: service identifier.
        name: as ISO 14229-1 calls it.
        handle: its handler.
        sub_functions: context -> its sub-functions; None: it has none.
        shortest: bytes of the shortest request.
        longest: bytes of the longest one, None: no limit.
        sessions: in which it is allowed.
        access: settings of the session and security that it needs, if they are configured.
        offered: whether there is anything to it in this configuration; else it is not supported.
    """

    sid: int
    name: str
    handle: Handler
    sub_functions: Callable[[Context], SubFunctions] | None = None
    shortest: int = 1
    longest: int | None = None
    sessions: Collection[int] = ANY_SESSION
    access: Callable[[UdsParams], Access] | None = None
    offered: Callable[[Context], bool] = lambda _: True
