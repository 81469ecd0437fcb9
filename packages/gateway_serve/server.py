"""The server: uvicorn, with connections that do not say what they want closed."""

from __future__ import annotations

import asyncio
import contextlib
import os
import re
import secrets
import signal
import socket
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import uvicorn
from uvicorn.protocols.http.h11_impl import H11Protocol

from gateway.host.process import ENDS, open_to_others
from gateway.host.sockets import reuse
from gateway_fdi.errors import GatewayError, InputError
from gateway_serve.app import Page
from gateway_serve.guard import CONTROL, Guard, Rights, host_name, is_loopback
from gateway_serve.hub import Hub

#: A connection that has sent no request within this time [s] is closed.
HEAD_S = 10.0
#: Name of a client.
_CLIENT = re.compile(r"[A-Za-z0-9_-]{1,20}")
#: Connections at a time.
MOST_CONNECTIONS = 128
#: Most that the kernel keeps of an answer that is not read; by default it keeps megabytes of each connection.
SEND_BYTES = 128 << 10
#: A connection that reads nothing when the server ends is cut after this time [s]; before uvicorn cancels its task,
#: with a traceback.
CUT_S = 0.5


@dataclass(frozen=True)
class ServeSettings:
    """Where the page is served.

    Attributes:
        socket: the daemon's status socket.
        host: address that is listened at.
        port: 0: any that is free.
        names: further names that this server is known by.
        read_token_file, control_token_file: files of the tokens; further lines of the second are clients of SOVD, a
            name and a token each.
        certificate, key: PEM files for TLS.
        parent: end when this process is not the parent any more; None: do not look.
    """

    socket: Path
    host: str = "127.0.0.1"
    port: int = 8808
    names: tuple[str, ...] = ()
    read_token_file: Path | None = None
    control_token_file: Path | None = None
    certificate: Path | None = None
    key: Path | None = None
    parent: int | None = None


class _Protocol(H11Protocol):
    """HTTP/1.1, where a client that is silent for long, or sends its request slowly, is sent away.

    Where there are too many connections the one that has been silent for longest goes: hoarded connections block no
    other.
    """

    _silent: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        self._arm()
        if len(self.connections) > MOST_CONNECTIONS:
            self._make_room()

    def _make_room(self) -> None:
        silent = [each for each in self.connections if isinstance(each, _Protocol) and each.is_silent]
        oldest = min(silent, key=lambda each: each.since_s)  # this one is silent itself
        self.connections.discard(oldest)  # the transport says that it is gone in the loop's next round only
        oldest.transport.abort()

    def on_response_complete(self) -> None:
        super().on_response_complete()
        self._arm()

    def connection_lost(self, exc: Exception | None) -> None:
        if self._silent is not None:
            self._silent.cancel()
        super().connection_lost(exc)

    def _arm(self) -> None:
        if self._silent is not None:
            self._silent.cancel()
        self.since_s = self.loop.time()
        self._silent = self.loop.call_later(HEAD_S, self._look)

    @property
    def is_silent(self) -> bool:
        """Whether no request of it is being answered."""
        return self.cycle is None or self.cycle.response_complete

    def _look(self) -> None:
        """Cut connections that are silent, or closed but still waiting for a peer that reads nothing."""
        if self.is_silent or self.transport.is_closing():
            self.transport.abort()
        else:
            self._silent = self.loop.call_later(HEAD_S, self._look)


def rights_of(settings: ServeSettings) -> Rights:
    """Return who may what.

    Raises:
        InputError: an address that others can reach without tokens and TLS; a token file that is no good.
    """
    local = is_loopback(settings.host)
    if (settings.certificate is None) != (settings.key is None):
        raise InputError("certificate and key go together", key="--cert, --key")
    if not local:
        for name, given in (("--read-token-file", settings.read_token_file), ("--cert", settings.certificate)):
            if given is None:
                raise InputError(
                    f"an address that other machines can reach needs tokens and TLS; give {name}",
                    key="--host",
                    value=settings.host,
                )
    read, _ = _tokens(settings.read_token_file)
    control, clients = _tokens(settings.control_token_file)
    control = control or (secrets.token_urlsafe(24) if local else "")
    every = [read, control, *clients.values()]
    if any(every.count(each) > 1 for each in every if each):
        raise InputError("reading and changing are two rights: two tokens, all different", key="--control-token-file")
    names = {_name(settings.host, "--host"), *(_name(name, "--name") for name in settings.names)}
    if local:
        names |= {"localhost", "127.0.0.1", "::1"}
    names -= {"0.0.0.0", "::"}  # noqa: S104 - these are no names
    if not names:
        raise InputError("listening everywhere needs the names that this server is known by", key="--name")
    return Rights(frozenset(names), read, control, secure=settings.certificate is not None, clients=clients)


def _name(text: str, key: str) -> str:
    """Return a name of this server as the Host header is compared with it.

    Raises:
        InputError: no Host header can say it.
    """
    found = host_name(f"[{text}]" if ":" in text and not text.startswith("[") else text)
    if found is None:
        raise InputError("a host name or an IP address, without a port", key=key, value=text)
    return found


def _tokens(file: Path | None) -> tuple[str, dict[str, str]]:
    """Return the token of a file, and those of further lines by the names before them."""
    if file is None:
        return "", {}
    try:
        first, *more = file.read_text(encoding="ascii").strip().splitlines() or [""]
        shared = open_to_others(file)
    except (OSError, ValueError) as error:
        raise InputError(f"no token can be read here: {error}", file=file) from error
    if shared:
        raise InputError("others can read this token: chmod 600", file=file)
    clients: dict[str, str] = {}
    for each in filter(None, more):
        name, _, token = each.strip().partition(" ")
        if not _CLIENT.fullmatch(name) or name in (CONTROL, *clients):
            text = "a further line is NAME TOKEN; a name has 1 to 20 letters, digits, _ and -"
            raise InputError(text, file=file, value=name)
        clients[name] = token.strip()
    for token in (first.strip(), *clients.values()):
        if len(token) < 16 or not token.isprintable() or " " in token:
            raise InputError("a token is one word of 16 characters or more", file=file)
    return first.strip(), clients


def open_socket(settings: ServeSettings) -> socket.socket:
    """Return a socket that listens at the address.

    Raises:
        InputError: it cannot be.
    """
    host = settings.host.strip("[]")
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    made = socket.socket(family, socket.SOCK_STREAM)
    reuse(made)
    made.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BYTES)  # handed down to each connection
    try:
        made.bind((host, settings.port))
        made.listen(64)  # from here on who comes waits until the server is there
    except OSError as error:
        made.close()
        raise InputError(f"{error.strerror or error}", key="--host, --port", value=f"{host}:{settings.port}") from error
    return made


def url_of(settings: ServeSettings, rights: Rights, port: int) -> str:
    """Return the address of the page."""
    host = f"[{settings.host}]" if ":" in settings.host and "[" not in settings.host else settings.host
    return f"{'https' if rights.secure else 'http'}://{host}:{port}/"


def url_with_token(settings: ServeSettings, rights: Rights, url: str) -> str | None:
    """Return the address with the control token after its #, where no server sees it; None: the token is of a file."""
    return f"{url}#control={rights.control_token}" if rights.control_token and not settings.control_token_file else None


@contextlib.contextmanager
def kept_address(settings: ServeSettings, address: str) -> Iterator[Path]:
    """Keep an address with its token in a file beside the status socket, for this user only, while the page is served.

    Raises:
        InputError: it cannot be written.
    """
    file = settings.socket.with_name(f"{settings.socket.name}.page")
    try:
        made, name = tempfile.mkstemp(prefix=f"{file.name}-", dir=file.parent)  # mode 0600, and nobody's before
        try:
            with os.fdopen(made, "w", encoding="ascii") as out:
                out.write(f"{address}\n")
            Path(name).replace(file)
        except OSError:
            Path(name).unlink()
            raise
    except OSError as error:
        text = f"the control token cannot be kept here ({error.strerror or error}); give one by --control-token-file"
        raise InputError(text, file=file) from error
    try:
        yield file
    finally:
        with contextlib.suppress(OSError):
            if file.read_text(encoding="ascii").strip() == address:  # else it is another page's by now
                file.unlink()


class _Server(uvicorn.Server):
    """Ends, too, when who started it is gone; streams, which never end by themselves, end with it.

    Args:
        config: uvicorn's.
        hub: has the streams.
        parent: process that has started it; None: do not look.
    """

    def __init__(self, config: uvicorn.Config, hub: Hub, parent: int | None) -> None:
        super().__init__(config)
        self._hub, self._parent = hub, parent
        self._looked = 0.0

    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        """End in good order at a signal; uvicorn's own would raise them again, and end with their code."""
        before = {number: signal.signal(number, self.handle_exit) for number in ENDS}
        try:
            yield
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        self._hub.end()
        asyncio.get_running_loop().call_later(CUT_S, self._cut)
        await super().shutdown(sockets)

    def _cut(self) -> None:
        for connection in list(self.server_state.connections):
            connection.transport.abort()

    async def on_tick(self, counter: int) -> bool:
        if self._parent is not None and counter % 10 == 0 and os.getppid() != self._parent:
            self.should_exit = True
        return await super().on_tick(counter)


def serve(settings: ServeSettings, rights: Rights, listener: socket.socket) -> None:
    """Serve until a signal comes.

    Raises:
        GatewayError: it cannot: a certificate that is none, ...
    """
    more: dict[str, Any] = {}
    if settings.certificate is not None:
        more = {"ssl_certfile": settings.certificate, "ssl_keyfile": settings.key}
    hub = Hub(settings.socket)
    config = uvicorn.Config(
        Guard(Page(hub).app(), rights, hub.on_refused, hub.fence.wall("page")),
        http=_Protocol,
        loop="asyncio",
        ws="none",
        lifespan="on",
        log_config=None,
        log_level="error",  # not a line for each request that is none
        access_log=False,
        server_header=False,
        proxy_headers=False,
        limit_concurrency=MOST_CONNECTIONS + 1,  # then none is silent
        timeout_keep_alive=5,
        timeout_graceful_shutdown=1,
        h11_max_incomplete_event_size=16 << 10,
        **more,
    )
    try:
        _Server(config, hub, settings.parent).run(sockets=[listener])
    except OSError as error:
        raise GatewayError(f"the page cannot be served: {error}") from error
