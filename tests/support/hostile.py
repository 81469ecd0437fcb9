"""Requests to a page's server that mean harm, by kind, each with the answers that refuse it.

Used by tests and by bench/page.py.
"""

import json
import re
import socket
from contextlib import contextmanager
from typing import NamedTuple

from gateway_serve.guard import BODY_BYTES, MOST_HEADERS

#: Waits for what hangs only.
PATIENCE_S = 120.0
#: Parts of paths that lead elsewhere.
UP = ("..", "%2e%2e", "..%2f", "%2e%2e%2f", "..\\", "%5c..", "....//", "%00", "%c0%ae%c0%ae", "//", "%252e%252e")
SECRETS = ("etc/passwd", "faults.sqlite", "gateway.toml", "proc/self/environ", "server.py", "app.py")
CHANGES = ("/api/clear", "/api/cycle", "/api/settings")
#: What a TLS client says first, and an HTTP/2 one.
OTHER_PROTOCOLS = (b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03" + b"\x5a" * 64, b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n")
#: What is no HTTP/1.1.
MALFORMED = (
    b"GET\r\n\r\n",
    b"GET / HTTP/1.1\nHost\n\n",
    b" GET / HTTP/1.1\r\n\r\n",
    b"GET / HTTP/1.1\r\n: x\r\n\r\n",
    b"GET / HTTP/1.1\r\nA b: c\r\n\r\n",
    b"GET /\x00 HTTP/1.1\r\n\r\n",
    b"GET / HTTP/1.1\r\nX: \x00\r\n\r\n",
)
#: What is no command, said by who has the right to give one.
WRONG_JSON = (
    *(("/api/clear", text) for text in ("[]", "{", '"clear"', "[" * 9000, "1e999", '{"id": 1}', '{"do": "cycle"}')),
    *(("/api/clear", json.dumps({"dtc": dtc})) for dtc in (5, "P9999-99", "FFFFFF", "x" * 9000, "a\nb", "", [], {})),
    ("/api/cycle", '{"number": 1}'),
    *(("/api/settings", text) for text in ('{"dtcs": "false"}', '{"receive": 0}', '{"send": null}')),
)


class Attack(NamedTuple):
    """One request.

    Attributes:
        kind: what is tried.
        data: that is sent.
        refusals: statuses that refuse it; None: the connection is closed without a word.
    """

    kind: str
    data: bytes
    refusals: frozenset


def request(port, path="/", method="GET", body=b"", *, host=None, version="1.1", **headers):
    """Return the bytes of a request; ``host`` "": without that header."""
    lines = [f"{method} {path} HTTP/{version}"]
    if host != "":
        lines.append(f"Host: {host or f'127.0.0.1:{port}'}")
    lines += [f"{name.replace('_', '-')}: {value}" for name, value in headers.items()]
    return ("\r\n".join(lines) + "\r\n\r\n").encode("latin-1", "replace") + body


def said(port, data, *, patience_s=PATIENCE_S):
    """Send bytes; returns the status of the answer and all that came; None: the connection was closed."""
    with socket.create_connection(("127.0.0.1", port), timeout=patience_s) as connection:
        try:
            connection.sendall(data)
        except OSError:
            pass  # refused before all was sent
        heard = b""
        try:
            while part := connection.recv(65536):
                heard += part
        except ConnectionResetError:
            pass
    found = re.match(rb"HTTP/1\.1 (\d+)", heard)
    return (int(found[1]) if found else None), heard


@contextmanager
def slow_clients(port, count):
    """Clients that begin a request, and say no more."""
    opened = []
    try:
        for k in range(count):
            connection = socket.create_connection(("127.0.0.1", port), timeout=PATIENCE_S)
            opened.append(connection)
            connection.sendall(request(port)[: 3 + k % 20])
        yield opened
    finally:
        for connection in opened:
            connection.close()


def was_sent_away(connection):
    """Tell whether the server has closed a connection; waits until it does."""
    try:
        return connection.recv(100) == b""
    except ConnectionResetError:
        return True


def attacks(port, draw, *, reading="", control=""):
    """Yield attacks, endlessly, all kinds in turn.

    Args:
        port: of the server.
        draw: a random.Random.
        reading: the token that may read, where one is needed.
        control: the token that may change: what has it, and is wrong in itself, is refused as well.
    """
    may_read = {"Authorization": f"Bearer {reading}"} if reading else {}
    may_change = {"Authorization": f"Bearer {control}"} if control else {}
    while True:
        for kind, data, *refusals in (
            *_of_paths(port, draw, may_read),
            *_of_strangers(port, draw, may_read),
            *_of_rights(port, draw, reading, control),
            *_of_bodies(port, draw, may_change),
            *_of_shape(port, draw, may_read),
        ):
            yield Attack(kind, data, frozenset(refusals))


def _of_paths(port, draw, may_read):
    end = {"Connection": "close", **may_read}
    climb = "/".join(draw.choice(UP) for _ in range(draw.randrange(1, 9)))
    place = draw.choice(("/static/", "/bokeh/", "/", "/api/recording/", "/api/"))
    yield "traversal", request(port, f"{place}{climb}/{draw.choice(SECRETS)}", **end), 404
    target = draw.choice(
        ("//evil.example/", "http://evil.example/", "*", "/static", "/api/recording/P0336-39/" + "9" * 1000)
    )
    yield "target", request(port, target, **end), 400, 404
    yield "long path", request(port, "/" + "a" * draw.choice((10_000, 70_000)), **end), 400, 414


def _of_strangers(port, draw, may_read):
    end = {"Connection": "close", **may_read}
    host = draw.choice(("evil.example", "127.0.0.1.evil.example", "evil.example:80", "[::2]", "0x7f.1", "a" * 300))
    yield "host", request(port, host=host, **end), 421
    yield "no host", request(port, host="", **end), 400
    yield "two hosts", request(port, **end).replace(b"\r\n\r\n", b"\r\nHost: evil.example\r\n\r\n"), 400
    origin = draw.choice(("http://evil.example", "null", f"https://127.0.0.1:{port}", "http://127.0.0.1:1", "file://"))
    yield "origin", request(port, "/api/stream", Origin=origin, **end), 403
    yield "site", request(port, "/api/stream", Sec_Fetch_Site=draw.choice(("cross-site", "same-site")), **end), 403


def _of_rights(port, draw, reading, control):
    end = {"Content_Length": 2, "Content_Type": "application/json", "Connection": "close"}
    token = "".join(draw.choices("abcdefXYZ019_-", k=draw.randrange(0, 60)))
    wrong = draw.choice(
        (f"Bearer {token}", f"Bearer {control[:-1]}", f"Basic {control}", f"Bearer {control}x", control, "Bearer")
    )
    yield "no right to change", request(port, draw.choice(CHANGES), "POST", b"{}", Authorization=wrong, **end), 401
    yield "no token", request(port, draw.choice(CHANGES), "POST", b"{}", **end), 401
    if reading:
        held = f"Bearer {reading}"
        yield (
            "reading is not changing",
            request(port, draw.choice(CHANGES), "POST", b"{}", Authorization=held, **end),
            401,
        )
        place = draw.choice(("/metrics", "/api/stream", "/api/history?faults=0", "/api/recording/P0336-39/1"))
        yield "no right to read", request(port, place, Connection="close", Authorization=wrong), 401


def _of_bodies(port, draw, may_change):
    """What comes with the right to change, and is wrong in itself."""
    end = {"Content_Type": "application/json", "Connection": "close", **may_change}
    size = draw.choice((BODY_BYTES + 1, 10**7, 10**12))
    yield "body", request(port, "/api/clear", "POST", b"x" * min(size, 200_000), Content_Length=size, **end), 413, None
    yield (
        "length",
        request(port, "/api/clear", "POST", b"{}", Content_Length=draw.choice((-1, "2, 3", "x", "+2")), **end),
        400,
    )
    chunks = b"".join(b"4000\r\n" + b"y" * 0x4000 + b"\r\n" for _ in range(8))
    yield "chunks", request(port, "/api/clear", "POST", chunks, Transfer_Encoding="chunked", **end), 413, None
    form = {**end, "Content_Type": "application/x-www-form-urlencoded"}
    yield "form", request(port, "/api/clear", "POST", b"a=b", Content_Length=3, **form), 415
    yield "get with body", request(port, "/", "GET", b"x" * 100, Content_Length=100, **end), 400
    path, text = draw.choice(WRONG_JSON)
    yield "json", request(port, path, "POST", text.encode(), Content_Length=len(text), **end), 400, 409
    yield "smuggled", request(
        port, "/api/clear", "POST", b"0\r\n\r\nGET /api/stream HTTP/1.1\r\n\r\n",
        Transfer_Encoding="chunked", Content_Length=3, **{**end, "Authorization": "Bearer x"},
    ), 400, 401  # fmt: skip


def _of_shape(port, draw, may_read):
    end = {"Connection": "close", **may_read}
    method = draw.choice(("PUT", "DELETE", "OPTIONS", "TRACE", "PATCH", "BREW", "get", "HEAD" * 100, "PROPFIND"))
    yield "method", request(port, draw.choice(("/", "/api/clear")), method, **end), 400, 405
    yield "proxy", request(port, draw.choice(("/", "evil.example:443")), "CONNECT", **end), 400, 405
    yield "long header", request(port, X_Long="b" * draw.choice((9000, 20_000, 300_000)), **end), 400, 431, None
    many = {f"X{k}": "1" for k in range(draw.choice((MOST_HEADERS, 1000, 20_000)))}
    yield "many headers", request(port, **many, **end), 400, 431, None
    key = {"Sec_WebSocket_Key": "dGhlIHNhbXBsZSBub25jZQ==", "Sec_WebSocket_Version": 13}
    yield "websocket", request(
        port, draw.choice(("/", "/api/stream")), Upgrade="websocket", Connection="Upgrade, close", **key, **may_read
    ), 400  # fmt: skip
    yield "version", request(port, version=draw.choice(("0.9", "2.0", "3.0", "3", "1.1.1", "x")), **end), 400, 505
    yield "other protocol", draw.choice(OTHER_PROTOCOLS) + b"\r\n\r\n", 400, 421, None
    yield "malformed", draw.choice(MALFORMED), 400
    yield "noise", bytes(draw.randrange(256) for _ in range(draw.randrange(1, 400))) + b"\r\n\r\n", 400, None
