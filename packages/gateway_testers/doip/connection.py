"""One tester's TCP connection, without its socket."""

from __future__ import annotations

from dataclasses import dataclass, field

from gateway.servers.uds.server import UdsServer
from gateway_testers.doip.codec import VERSIONS, Kind, Message, Splitter, packed

#: Unsent bytes at which a connection is not heard, and at which it is sent away [byte].
ENOUGH_BYTES, MOST_BYTES = 256 << 10, 4 << 20


@dataclass(eq=False)
class Connection:
    """One.

    Attributes:
        peer: IP address of the tester.
        secure: whether it came by TLS.
        heard_ns: when the last message came or went.
        splitter: cuts what comes.
        certificate: common name of the tester's certificate, "": none.
        out: bytes to send.
        ends: whether it is to be closed when ``out`` was sent.
        source: address of the tester; None: routing is not activated.
        version: of the protocol that the tester speaks.
        server: of the tester's own session.
        check_ends_ns: when the alive check is over; None: there is none.
        asks: an activation that waits for alive checks of ``rivals``.
        rivals: connections of which one may give way to it.
        more: whether whole messages may wait in the splitter.
    """

    peer: str
    secure: bool
    heard_ns: int
    splitter: Splitter
    certificate: str = ""
    out: bytearray = field(default_factory=bytearray)
    ends: bool = False
    source: int | None = None
    version: int = VERSIONS[-1]
    server: UdsServer | None = None
    check_ends_ns: int | None = None
    asks: Message | None = None
    rivals: set[Connection] = field(default_factory=set)
    more: bool = False

    def __str__(self) -> str:
        """Return its name."""
        return self.name

    def put(self, kind: Kind, body: bytes) -> None:
        """Send a message, if there is still someone to take it."""
        if not self.ends:
            self.out += packed(kind, body, self.version)

    @property
    def stuck(self) -> bool:
        """Whether its answers have no room: it is not served until it takes some."""
        return len(self.out) >= ENOUGH_BYTES

    @property
    def hungry(self) -> bool:
        """Whether more of it is to be read: its answers have room, and nothing of it waits."""
        return not (self.ends or self.more or self.asks is not None or self.stuck)

    @property
    def name(self) -> str:
        """Its transport and peer, for people."""
        return f"doip{' tls' if self.secure else ''} {self.peer}"
