"""The page's server against those who mean harm: refused, and the next one is served as before."""

import json
import os
import random
import re
import socket
import ssl
import subprocess
import sys
import time
import urllib.error
import urllib.request
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from ipaddress import ip_address

import pytest
from amount import amount
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import NameOID

from gateway.errors import InputError
from gateway.serve.guard import BODY_BYTES, is_loopback
from gateway.serve.server import HEAD_S, ServeSettings, rights_of

pytestmark = pytest.mark.system

COMMAND = [sys.executable, "-c", "from gateway.cli import main; main()", "serve"]
PATIENCE_S = 120.0


@contextmanager
def server(folder, *options):
    """The page of a gateway that does not run; yields address, port and control token."""
    started = subprocess.Popen(
        [*COMMAND, "--status", str(folder / "nobody"), "--port", "0", *map(str, options)],
        stderr=subprocess.PIPE, text=True, cwd=folder,
    )  # fmt: skip
    try:
        line = started.stderr.readline()
        found = re.search(r"page: (https?://\S+?:(\d+)/)(?:#control=(\S+))?", line)
        assert found, line
        yield found[1], int(found[2]), found[3]
        assert started.poll() is None, "it serves still"
    finally:
        started.terminate()
        assert started.wait(60) == 0
        started.stderr.close()


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    with server(tmp_path_factory.mktemp("hostile")) as found:
        yield found


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


def request(port, path="/", method="GET", body=b"", *, host=None, version="1.1", **headers):
    lines = [f"{method} {path} HTTP/{version}"]
    if host != "":
        lines.append(f"Host: {host or f'127.0.0.1:{port}'}")
    lines += [f"{name.replace('_', '-')}: {value}" for name, value in headers.items()]
    return ("\r\n".join(lines) + "\r\n\r\n").encode("latin-1", "replace") + body


#: Parts of paths that lead elsewhere.
UP = ("..", "%2e%2e", "..%2f", "%2e%2e%2f", "..\\", "%5c..", "....//", "%00", "%c0%ae%c0%ae", "//", "%252e%252e")


def attacks(port, draw):
    """Yield requests of which none may be answered with 200, endlessly, by kind."""
    end = {"Connection": "close"}
    secrets = ("etc/passwd", "faults.sqlite", "gateway.toml", "proc/self/environ", "server.py", "app.py")
    while True:
        climb = "/".join(draw.choice(UP) for _ in range(draw.randrange(1, 9)))
        place = draw.choice(("/static/", "/bokeh/", "/", "/api/recording/", "/api/"))
        yield "traversal", request(port, f"{place}{climb}/{draw.choice(secrets)}", **end)
        host = draw.choice(
            ("evil.example", "127.0.0.1.evil.example", "evil.example:80", "", "[::2]", "0x7f.1", "a" * 300)
        )
        yield "host", request(port, host=host, **end)
        origin = draw.choice(
            ("http://evil.example", "null", f"https://127.0.0.1:{port}", "http://127.0.0.1:1", "file://")
        )
        yield "origin", request(port, "/api/stream", Origin=origin, **end)
        yield "site", request(port, "/api/stream", Sec_Fetch_Site=draw.choice(("cross-site", "same-site")), **end)
        json_ = {"Content-Type": "application/json", **end}
        token = "".join(draw.choices("abcdefXYZ019_-", k=draw.randrange(0, 60)))
        yield "no token", request(
            port, draw.choice(("/api/clear", "/api/cycle", "/api/settings")), "POST", b"{}",
            Content_Length=2, Authorization=f"Bearer {token}", **json_,
        )  # fmt: skip
        size = draw.choice((BODY_BYTES + 1, 10**7, 10**12, -1))
        yield (
            "body",
            request(port, "/api/clear", "POST", b"x" * min(max(size, 0), 200_000), Content_Length=size, **json_),
        )
        chunks = b"".join(b"4000\r\n" + b"y" * 0x4000 + b"\r\n" for _ in range(8))
        yield "chunks", request(port, "/api/clear", "POST", chunks, Transfer_Encoding="chunked", **json_)
        yield (
            "form",
            request(
                port,
                "/api/clear",
                "POST",
                b"a=b",
                Content_Length=3,
                Content_Type="application/x-www-form-urlencoded",
                **end,
            ),
        )
        yield "get with body", request(port, "/", "GET", b"x" * 100, Content_Length=100, **end)
        method = draw.choice(("PUT", "DELETE", "OPTIONS", "TRACE", "CONNECT", "PATCH", "BREW"))
        yield "method", request(port, draw.choice(("/", "/api/clear")), method, **end)
        yield "long path", request(port, "/" + "a" * draw.choice((3000, 70_000)), **end)
        yield "long header", request(port, X_Long="b" * draw.choice((20_000, 300_000)), **end)
        yield "two hosts", request(port, **end).replace(b"\r\n\r\n", b"\r\nHost: evil.example\r\n\r\n")
        yield "noise", bytes(draw.randrange(256) for _ in range(draw.randrange(1, 400))) + b"\r\n\r\n"
        yield "smuggled", request(
            port, "/api/clear", "POST", b"0\r\n\r\nGET /api/stream HTTP/1.1\r\n\r\n",
            Transfer_Encoding="chunked", Content_Length=3, **json_,
        )  # fmt: skip


def test_what_means_harm_is_refused_and_others_are_served(page):
    url, port, token = page
    seed = int(os.environ.get("GATEWAY_SEED", time.time_ns() % 10**6))
    print(f"seed {seed}")
    drawn = attacks(port, random.Random(seed))
    slow = [socket.create_connection(("127.0.0.1", port), timeout=PATIENCE_S) for _ in range(20)]
    for k, connection in enumerate(slow):
        connection.sendall(request(port)[: 3 + k])  # and then nothing
    begun = time.monotonic()
    for _ in range(amount(1000, 200, 45)):
        kind, data = next(drawn)
        status, heard = said(port, data)
        assert status is None or 400 <= status < 500, (kind, status, data[:200])
        assert token.encode() not in heard
        assert b"root:" not in heard
        assert b"Traceback" not in heard
    with urllib.request.urlopen(url) as answer:
        assert b"<title>gateway</title>" in answer.read()
        policy = answer.headers["content-security-policy"]
        assert "script-src 'self'" in policy
        assert "unsafe-eval" not in policy
        assert answer.headers["x-content-type-options"] == "nosniff"
    for connection in slow:
        with connection:
            try:
                assert connection.recv(100) == b"", "closed without a word"
            except ConnectionResetError:
                pass
    print(f"slow ones were sent away after {time.monotonic() - begun:.1f} s, asked for {HEAD_S}")


def test_a_right_request_without_a_daemon_says_so(page):
    url, _, token = page
    ask = urllib.request.Request(
        f"{url}api/clear", b"{}", {"content-type": "application/json", "authorization": f"Bearer {token}"}
    )
    with pytest.raises(urllib.error.HTTPError) as error:
        urllib.request.urlopen(ask)
    assert error.value.code == 409
    assert "does not run" in error.value.read().decode()
    with urllib.request.urlopen(f"{url}metrics") as answer:
        assert b"gateway_up 0.0" in answer.read()


def certificate(folder):
    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "gateway test")])
    now = datetime.now(UTC)
    made = (
        x509.CertificateBuilder().subject_name(name).issuer_name(name).public_key(key.public_key())
        .serial_number(1).not_valid_before(now - timedelta(days=1)).not_valid_after(now + timedelta(days=1))
        .add_extension(x509.SubjectAlternativeName([x509.IPAddress(ip_address("127.0.0.1"))]), critical=False)
        .sign(key, hashes.SHA256())
    )  # fmt: skip
    (folder / "cert.pem").write_bytes(made.public_bytes(serialization.Encoding.PEM))
    (folder / "key.pem").write_bytes(
        key.private_bytes(serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption())
    )
    return folder / "cert.pem", folder / "key.pem"


def token_file(folder, name, text):
    file = folder / name
    file.write_text(text)
    file.chmod(0o600)
    return file


def test_with_tokens_and_tls_reading_and_changing_are_two_rights(tmp_path):
    cert, key = certificate(tmp_path)
    read, control = "reading-" + "r" * 20, "control-" + "c" * 20
    options = (
        "--cert", cert, "--key", key, "--read-token-file", token_file(tmp_path, "read", read),
        "--control-token-file", token_file(tmp_path, "control", control),
    )  # fmt: skip
    context = ssl.create_default_context(cafile=cert)
    with server(tmp_path, *options) as (url, _, shown):
        assert url.startswith("https:")
        assert shown is None, "a token of a file is not said"

        def status(path, token, *, post=False):
            headers = {"content-type": "application/json"} | ({"authorization": f"Bearer {token}"} if token else {})
            asked = urllib.request.Request(url + path, b"{}" if post else None, headers)
            try:
                with urllib.request.urlopen(asked, context=context) as answer:
                    return answer.status
            except urllib.error.HTTPError as error:
                return error.code

        assert status("", "") == 200, "the page itself says nothing"
        assert [status("metrics", token) for token in ("", "x", read, control)] == [401, 401, 200, 200]
        assert [status("api/history", token) for token in ("", "x", read)] == [401, 401, 200]
        assert [status("api/clear", token, post=True) for token in ("", read, control)] == [401, 401, 409]


def settings(tmp_path, **more):
    return ServeSettings(tmp_path / "status", **more)


def test_an_address_that_others_reach_needs_tokens_and_tls(tmp_path):
    cert, key = certificate(tmp_path)
    good = token_file(tmp_path, "good", "t" * 20)
    with pytest.raises(InputError, match="--read-token-file"):
        rights_of(settings(tmp_path, host="192.0.2.1"))
    with pytest.raises(InputError, match="--cert"):
        rights_of(settings(tmp_path, host="192.0.2.1", read_token_file=good))
    outside = rights_of(settings(tmp_path, host="192.0.2.1", read_token_file=good, certificate=cert, key=key))
    assert outside.control_token == "", "nobody may change anything"
    with pytest.raises(InputError, match="--name"):
        rights_of(settings(tmp_path, host="0.0.0.0", read_token_file=good, certificate=cert, key=key))
    with pytest.raises(InputError, match="go together"):
        rights_of(settings(tmp_path, certificate=cert))
    with pytest.raises(InputError, match="two rights"):
        rights_of(settings(tmp_path, read_token_file=good, control_token_file=good))
    for name, text, wrong in (("short", "abc", "16 characters"), ("words", "a b " * 9, "one word")):
        with pytest.raises(InputError, match=wrong):
            rights_of(settings(tmp_path, read_token_file=token_file(tmp_path, name, text)))
    good.chmod(0o644)
    with pytest.raises(InputError, match="chmod 600"):
        rights_of(settings(tmp_path, read_token_file=good))
    with pytest.raises(InputError, match="no token can be read"):
        rights_of(settings(tmp_path, read_token_file=tmp_path / "none"))
    local = rights_of(settings(tmp_path))
    assert len(local.control_token) >= 30
    assert json.dumps(sorted(local.hosts)) == '["127.0.0.1", "::1", "localhost"]'


@pytest.mark.parametrize(
    ("host", "loopback"),
    [("127.0.0.1", True), ("127.5.5.5", True), ("::1", True), ("[::1]", True), ("localhost", True),
     ("0.0.0.0", False), ("192.168.1.2", False), ("localhost.example", False), ("", False)],
)  # fmt: skip
def test_what_is_loopback(host, loopback):
    assert is_loopback(host) == loopback
