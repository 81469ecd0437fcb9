"""Data that the handlers of the services see and change."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field

from gateway.faults.interventions import DONE, Intervention
from gateway.faults.memory import FaultMemory
from gateway.isotp.edges import MOST_SHORT
from gateway.servers.access import SESSIONS, Need
from gateway.servers.authority import Asker, Authority, Holder, Refusal
from gateway.servers.identifiers import Identifiers
from gateway.servers.tester_control import TesterControl
from gateway.servers.uds.authentication import Authentication
from gateway.servers.uds.nrc import NegativeError, Nrc
from gateway.servers.uds.params import UdsParams
from gateway.servers.uds.security import Security

DEFAULT = SESSIONS["default"]


@dataclass
class EventLogic:
    """Response on event (0x86): its event and its answer.

    ``set_up`` is (status mask, service to respond to); ``until_ns`` the end of its window, None: for ever.
    """

    set_up: tuple[int, bytes] | None = None
    window: int = 0x02
    started: bool = False
    until_ns: int | None = None


@dataclass
class Context:
    """State of the server, and the data it serves."""

    params: UdsParams
    memory: FaultMemory
    identifiers: Identifiers
    control: TesterControl
    security: Security
    authentication: Authentication
    authority: Authority
    bus: str = ""
    trace_did: int | None = None  # data identifier of what testers did
    testers: list[Context] = field(default_factory=list)  # of all addresses, this one too
    longest: int = MOST_SHORT  # bytes of a response that the transport carries
    now_ns: int = 0
    session: int = DEFAULT
    events: EventLogic = field(default_factory=EventLogic)
    routines_done: dict[int, bytes] = field(default_factory=dict)
    asked_by: int = 0  # identifier of the latest request
    asked_in: tuple[int, int, str] = (DEFAULT, 0, "")  # session, unlocked security level and role when it came
    need: Need = field(default_factory=Need)  # of the request that is served now
    holder: Holder = field(init=False)  # lasting actions of the tester at this address

    def __post_init__(self) -> None:
        self.holder = self.authority.holder(self.name, lambda action: self.note(action, protocol="gateway"))

    @property
    def name(self) -> str:
        """Internal name of the tester at this address."""
        return f"{self.bus}:{self.params.request:X}"

    @property
    def asker(self) -> Asker:
        """The tester, as rules of access look at it."""
        return Asker(self.session, self.security.unlocked, self.authentication.role)

    def check_security(self) -> None:
        """Refuse the request that is served now, if it needs a role or a security level that the tester has not.

        Raises:
            NegativeError: it does.
        """
        _refuse(self.authority.security_refusal(self.need, self.asker))

    def check_conditions(self) -> None:
        """Refuse the request that is served now, if its conditions are not met; the last check of all.

        Raises:
            NegativeError: they are not.
        """
        _refuse(self.authority.conditions_refusal(self.need))

    def note(
        self, action: str, request: bytes = b"", outcome: int = DONE, *, protocol: str = "uds", to: str = ""
    ) -> None:
        """Keep and tell what the tester did, or was refused; ``to``: the ECU that it was meant for."""
        session, level, role = self.asked_in
        bus = f"{self.bus} to {to}" if to else self.bus
        by = Intervention(0, protocol, bus, self.asked_by, action, request, outcome, session, level, role)
        self.control.note(by)

    def enter(self, session: int) -> None:
        """Change the session: security locks, and the default session undoes what others had set."""
        self.security.lock()
        self.authentication.end()
        self.session = session
        if session == DEFAULT:
            self.holder.end()
            self.events.started = False
            self.routines_done.clear()

    def leave(self) -> None:
        """End all that is the tester's: it has gone, and its address with it."""
        self.enter(DEFAULT)
        self.authority.leave(self.holder)
        self.testers.remove(self)


def _refuse(refusal: Refusal) -> None:
    if refusal:
        raise NegativeError(Nrc(refusal))


class Later:
    """An answer that takes its time: 0x78 now, and the result of ``work`` when there is time for it."""

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
        action: whose rule of access it goes by, "": anybody may.
        undoes: whether a request only undoes such an intervention; it needs the session, and nothing else.
        traced: whether a request is an intervention, which is kept and told.
        late: whether its handler checks the security, after what the standard checks before.
        offered: whether there is anything to it in this configuration; else it is not supported.
    """

    sid: int
    name: str
    handle: Handler
    sub_functions: Callable[[Context], SubFunctions] | None = None
    shortest: int = 1
    longest: int | None = None
    sessions: Collection[int] = ANY_SESSION
    action: str = ""
    undoes: Callable[[bytes], bool] = lambda _: False
    late: bool = False
    traced: Callable[[bytes], bool] = lambda _: False
    offered: Callable[[Context], bool] = lambda _: True
