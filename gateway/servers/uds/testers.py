"""Makes a server for each tester, whatever transport it comes by: a session of its own, and one memory for all."""

from __future__ import annotations

from gateway.faults.memory import FaultMemory
from gateway.isotp.edges import MOST_SHORT
from gateway.servers.authority import Authority
from gateway.servers.identifiers import Identifiers
from gateway.servers.uds.authentication import Authentication
from gateway.servers.uds.context import Context
from gateway.servers.uds.params import UdsParams
from gateway.servers.uds.security import Security
from gateway.servers.uds.server import UdsServer


class Testers:
    """The testers of one gateway.

    Args:
        memory: the fault memory, which also counts wrong keys and certificates.
        identifiers: the data identifiers.
        authority: judges what they ask for.
        security: of the configuration's levels.
        authentication: of the configuration's roots.
        trace_did: data identifier of what testers did.
    """

    def __init__(
        self,
        memory: FaultMemory,
        identifiers: Identifiers,
        authority: Authority,
        security: Security,
        authentication: Authentication,
        trace_did: int | None,
    ) -> None:
        for attempts in (*security.attempts, *authentication.attempts):
            attempts.keep_in(memory.attempts, memory.keep_attempts)
        self._memory, self._identifiers, self._authority = memory, identifiers, authority
        self._security, self._authentication, self._trace_did = security, authentication, trace_did
        self._all: list[Context] = []

    def server(self, params: UdsParams, bus: str, *, longest: int = MOST_SHORT) -> UdsServer:
        """Return the server of one more tester.

        Args:
            params: with its address.
            bus: name of the bus, or of another transport and the peer.
            longest: response [byte].
        """
        made = Context(
            params,
            self._memory,
            self._identifiers,
            self._authority.control,
            self._security.beside(),
            self._authentication.beside(),
            self._authority,
            bus,
            self._trace_did,
            self._all,
            longest,
        )
        self._all.append(made)
        return UdsServer(made)
