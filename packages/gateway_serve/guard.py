"""The guard before the page: whose requests are answered, and which they may send.

- **Host** must be one that this server is known by: a page of another site that has its name pointed at this machine
  (DNS rebinding) is refused. **Origin**, where it is sent, must be the same.
- **Reading** needs no token on a loopback address, elsewhere the reading one; **changing** (clear, operation cycle)
  needs the control token everywhere: more users may open a loopback port than the status socket.
- **SOVD** (paths below /sovd) is guarded like the page: GET is reading, POST, PUT and DELETE are changing; its refusals
  are JSON. Further clients have a token of their own each, and are known by its name.
- Bodies, headers, time and connections are bounded; every refusal closes its connection.
"""

from __future__ import annotations

import asyncio
import contextlib
import hmac
import ipaddress
import re
from collections.abc import Awaitable, Callable, Mapping, MutableMapping
from dataclasses import dataclass, field
from typing import Any

from gateway.common.fence import Fence, Wall
from gateway_fdi.common.log import get_logger
from gateway_serve.sovd.errors import error_body

#: Largest body of a request [byte], and how long it may take [s].
BODY_BYTES, BODY_S = 16 << 10, 5.0
#: Longest time for one part of an answer [s].
SEND_S = 30.0
#: Name of the client that has the control token.
CONTROL = "control"
#: Methods of the page, and those that change something.
METHODS, CHANGING = ("GET", "HEAD", "POST"), ("POST", "PUT", "DELETE")
#: Most of a body that is thrown away before a refusal, so that a client which sends it all reads that [byte].
DRAIN_BYTES = 16 << 20
#: Longest path with its query [byte].
PATH_BYTES = 8 << 10
#: Type of refusals.
TEXT = b"text/plain; charset=utf-8"
#: Host and port in a Host header; an address of IPv6 stands in brackets.
_HOST = re.compile(
    r"(?:\[(?P<address>[0-9A-Fa-f:.]{2,45})\]|(?P<name>[A-Za-z0-9._~-]{1,1024}))(?::(?P<port>[0-9]{0,5}))?", re.ASCII
)
#: Largest headers together [byte], and how many at most.
HEAD_BYTES, MOST_HEADERS = 8 << 10, 100

log = get_logger(__name__)

Scope = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[MutableMapping[str, Any]]]
Send = Callable[[MutableMapping[str, Any]], Awaitable[None]]
App = Callable[[Scope, Receive, Send], Awaitable[None]]

#: Of every answer. Nothing is loaded from elsewhere, nothing is evaluated, no other page may frame it.
HEADERS = {
    "content-security-policy": (
        "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data:; "
        "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "x-content-type-options": "nosniff",
    "x-frame-options": "DENY",
    "referrer-policy": "no-referrer",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "permissions-policy": "camera=(), microphone=(), geolocation=()",
    "cache-control": "no-store",
}


@dataclass(frozen=True)
class Rights:
    """Rights of the page's users.

    Attributes:
        hosts: names that this server is known by, without port, in lower case.
        read_token: for reading; "": anybody may.
        control_token: for changing.
        secure: whether it is reached by TLS.
        clients: further tokens for changing, by the names of the clients that have them.
    """

    hosts: frozenset[str]
    read_token: str
    control_token: str
    secure: bool = False
    clients: Mapping[str, str] = field(default_factory=dict)

    def who(self, token: str) -> str:
        """Return the name of the client that a token for changing is of; "": it is none."""
        known = {CONTROL: self.control_token, **self.clients}
        return next((name for name, own in known.items() if own and _same(token, own)), "")


def is_loopback(host: str) -> bool:
    """Return whether an address is one that no other machine can reach."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return False


class Guard:
    """Refuses what may not be; the rest goes to the application.

    Args:
        app: the application.
        rights: of the users.
        on_refused: told of each request that was refused: its status.
        wall: around each request; None: one of its own.
    """

    def __init__(
        self,
        app: App,
        rights: Rights,
        on_refused: Callable[[int], None] = lambda status: None,
        wall: Wall | None = None,
    ) -> None:
        self._app, self._rights, self._on_refused = app, rights, on_refused
        self._wall = wall or Fence().wall("page")

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request; an exception ends it, with the status 500 where it has no answer yet."""
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        if scope["type"] != "http":
            return
        begun = False

        async def checked(message: MutableMapping[str, Any]) -> None:
            nonlocal begun
            begun = True
            await send(message)

        try:
            await self._answer(scope, receive, checked)
        except SlowReader:
            log.warning("a client does not read its answer, sent away", path=scope["path"][:80])
        except Exception as error:
            client = scope.get("client") or ("",)
            self._wall.caught(error, f"{client[0]}, {scope['method']} {scope['path']}")
            if not begun:
                await _refuse(send, 500, "an internal error", sovd=_is_sovd(scope))

    async def _answer(self, scope: Scope, receive: Receive, send: Send) -> None:
        headers = [(name.decode("latin-1"), value.decode("latin-1")) for name, value in scope["headers"]]
        scope["gateway.who"] = self._rights.who(_token_of(headers))
        wrong = self._wrong(scope, headers)
        body = b""
        if wrong is None and scope["method"] in CHANGING:
            try:
                body = await asyncio.wait_for(_body(receive), BODY_S)
            except TimeoutError:
                wrong = (408, "the request took too long")
            except _TooLargeError:
                wrong = (413, "the request is too large")
        if wrong is not None:
            self._on_refused(wrong[0])
            if _is_sovd(scope):
                with contextlib.suppress(TimeoutError, _TooLargeError):
                    await asyncio.wait_for(_body(receive, DRAIN_BYTES, keep=False), BODY_S)
            await _refuse(send, *wrong, sovd=_is_sovd(scope))
            return
        await self._app(scope, _given(body, receive), _guarded(send, self._rights))

    def _wrong(self, scope: Scope, headers: list[tuple[str, str]]) -> tuple[int, str] | None:
        """Return what is wrong with a request: status and text."""
        hosts = [value for name, value in headers if name == "host"]
        names = [host_name(host) for host in hosts]
        if None in names:
            return 400, "this is no host"
        if len(names) != 1 or names[0] not in self._rights.hosts:
            return 421, "this is not a name of this server"
        origins = [value for name, value in headers if name == "origin"]
        own = f"{'https' if self._rights.secure else 'http'}://{hosts[0].lower()}"
        if any(origin.lower() != own for origin in origins):
            return 403, "a page of another origin may not ask"
        if any(name == "sec-fetch-site" and value not in ("same-origin", "none") for name, value in headers):
            return 403, "a page of another site may not ask"
        return self._wrong_shape(scope, headers) or self._wrong_right(scope, headers)

    def _wrong_shape(self, scope: Scope, headers: list[tuple[str, str]]) -> tuple[int, str] | None:
        if scope["http_version"] not in ("1.0", "1.1"):
            return 505, "HTTP/1.1"
        if len(scope["raw_path"]) + len(scope["query_string"]) > PATH_BYTES:
            return 414, "the path is too long"
        if len(headers) > MOST_HEADERS or sum(len(name) + len(value) for name, value in headers) > HEAD_BYTES:
            return 431, "the headers are too large"
        if any(name == "upgrade" and "websocket" in value.lower() for name, value in headers):
            return 400, "no websockets here"
        lengths = [value for name, value in headers if name == "content-length"]
        chunked = any(name == "transfer-encoding" for name, _ in headers)
        if scope["method"] in ("GET", "HEAD"):
            return (400, "no body here") if chunked or any(value != "0" for value in lengths) else None
        if scope["method"] not in (CHANGING if _is_sovd(scope) else METHODS):
            return None if _is_sovd(scope) else (405, ", ".join(METHODS))  # each of its resources knows its methods
        if lengths and (not lengths[0].isdigit() or int(lengths[0]) > BODY_BYTES):
            return 413, "the request is too large"
        if _is_sovd(scope) and not chunked and all(value == "0" for value in lengths):
            return None  # an intervention without a body; a page of another site cannot send its token
        kinds = [value.partition(";")[0].strip().lower() for name, value in headers if name == "content-type"]
        return None if kinds == ["application/json"] else (415, "application/json")

    def _wrong_right(self, scope: Scope, headers: list[tuple[str, str]]) -> tuple[int, str] | None:
        path: str = scope["path"]
        changes = scope["method"] in CHANGING
        if not changes and not path.startswith(("/api/", "/metrics")) and not _is_sovd(scope):
            return None  # the page itself: it is the same everywhere, and says nothing of this gateway
        who = scope["gateway.who"]
        if changes:  # the page can override rules of access; clients of SOVD cannot
            may = bool(who) if _is_sovd(scope) else who == CONTROL
            return None if may else (401, "the control token is needed")
        may_read = not self._rights.read_token or _same(_token_of(headers), self._rights.read_token) or bool(who)
        return None if may_read else (401, "a token is needed")


class _TooLargeError(Exception):
    """More came than is allowed."""


class SlowReader(Exception):
    """The reader does not take the answer."""


def _is_sovd(scope: Scope) -> bool:
    return scope["path"] == "/sovd" or str(scope["path"]).startswith("/sovd/")


def _token_of(headers: list[tuple[str, str]]) -> str:
    given = [value for name, value in headers if name == "authorization"]
    return given[0][7:] if len(given) == 1 and given[0][:7].lower() == "bearer " else ""


def _same(one: str, other: str) -> bool:
    return hmac.compare_digest(one.encode(), other.encode())


def host_name(value: str) -> str | None:
    """Return the name in a Host header, in lower case, an IP address in its shortest form; None: it is no such header.

    ``host [ ":" port ]`` (RFC 9110, 7.2; RFC 3986, 3.2.2 and 3.2.3), but what no server here is called: names with
    percent signs or sub-delimiters, and IPvFuture. Any port will do: who forwards one (ssh -L) asks for another than
    this server's, and pages of other origins are known by Origin.
    """
    found = _HOST.fullmatch(value)
    if found is None or int(found["port"] or 0) > 0xFFFF:
        return None
    if found["address"] is None:
        return found["name"].lower()
    try:
        return str(ipaddress.IPv6Address(found["address"]))
    except ValueError:
        return None


async def _body(receive: Receive, most: int = BODY_BYTES, *, keep: bool = True) -> bytes:
    body, size = b"", 0
    while True:
        message = dict(await receive())
        if message["type"] != "http.request":
            return body
        part = bytes(message.get("body", b""))
        size += len(part)
        if size > most:
            raise _TooLargeError
        body += part if keep else b""
        if not message.get("more_body"):
            return body


def _given(body: bytes, receive: Receive) -> Receive:
    """Return what hands out a body that was read already, then what comes after it (the end of the connection)."""
    told = False

    async def given() -> MutableMapping[str, Any]:
        nonlocal told
        if told:
            return await receive()
        told = True
        return {"type": "http.request", "body": body, "more_body": False}

    return given


def _guarded(send: Send, rights: Rights) -> Send:
    more = [(name.encode(), value.encode()) for name, value in HEADERS.items()]
    if rights.secure:
        more.append((b"strict-transport-security", b"max-age=31536000"))

    async def guarded(message: MutableMapping[str, Any]) -> None:
        if message["type"] == "http.response.start":
            own = {name.lower() for name, _ in message["headers"]}
            message["headers"] = [*message["headers"], *(pair for pair in more if pair[0] not in own)]
        try:
            await asyncio.wait_for(send(message), SEND_S)
        except TimeoutError as error:
            raise SlowReader from error

    return guarded


async def _refuse(send: Send, status: int, text: str, *, sovd: bool) -> None:
    data, kind = (error_body(status, text), b"application/json") if sovd else (text.encode() + b"\n", TEXT)
    headers = [(b"content-type", kind), (b"content-length", str(len(data)).encode())]
    headers += [(b"connection", b"close"), *((n.encode(), v.encode()) for n, v in HEADERS.items())]
    if status == 405:
        headers.append((b"allow", text.encode()))
    if status == 401:
        headers.append((b"www-authenticate", b"Bearer"))
    await send({"type": "http.response.start", "status": status, "headers": headers})
    await send({"type": "http.response.body", "body": data})
