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
from collections import Counter
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from ipaddress import ip_address
from pathlib import Path
from types import SimpleNamespace

import pytest
import warm
from amount import amount
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import NameOID
from hostile import PATIENCE_S, attacks, request, said, slow_clients, was_sent_away
from kernel_can import wait_for
from page_address import address_of
from processes import bus, gateway, process

from gateway_fdi.errors import InputError
from gateway_serve.app import MOST_VIEWERS
from gateway_serve.guard import is_loopback
from gateway_serve.server import MOST_CONNECTIONS, ServeSettings, rights_of

pytestmark = pytest.mark.system

ROOT = Path(__file__).parents[2]
PROGRAM = "from gateway.cli import main; main()"


class Served(tuple):
    """Address, port, control token, process identifier; and the process."""

    def __new__(cls, url, port, token, process):
        made = super().__new__(cls, (url, port, token, process.pid))
        made.process = process
        return made


@contextmanager
def server(folder, *options, program=PROGRAM):
    """The page of a gateway that does not run; yields address, port, control token, process identifier."""
    started = warm.Popen(
        [sys.executable, "-c", program, "serve", "--status", str(folder / "nobody"), "--port", "0", *map(str, options)],
        stderr=subprocess.PIPE, text=True, cwd=folder,
    )  # fmt: skip
    try:
        line = started.stderr.readline()
        assert "#control=" not in line, "it may go into a journal that others read"
        found = re.fullmatch(r"(https?://\S+?:(\d+)/)(?:#control=(\S+))?", address_of(line, folder))
        yield Served(found[1], int(found[2]), found[3], started)
        assert started.poll() is None, "it serves still"
    finally:
        started.terminate()
        assert started.wait(60) == 0
        started.stderr.close()


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    with server(tmp_path_factory.mktemp("hostile")) as found:
        yield found


def memory_of(pid):
    """What a process holds at present [kB]."""
    return int(re.search(r"VmRSS:\s+(\d+)", Path(f"/proc/{pid}/status").read_text())[1])


def sockets_of(pid):
    """How many sockets a process holds."""
    held = 0
    for entry in Path(f"/proc/{pid}/fd").iterdir():
        try:
            held += entry.readlink().name.startswith("socket:")
        except FileNotFoundError:
            pass  # closed meanwhile
    return held


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """A gateway that has a trouble code, and its page, where reading needs a token, too."""
    folder = tmp_path_factory.mktemp("site")
    reading, control = "reading-" + "r" * 20, "control-" + "c" * 20
    tokens = (
        "--read-token-file", token_file(folder, "read", reading),
        "--control-token-file", token_file(folder, "control", control),
    )  # fmt: skip
    with bus(folder) as uri:
        text = (ROOT / "gateway.toml").read_text().replace("loopback:127.0.0.1:29536", uri)
        (folder / "gateway.toml").write_text(text)
        with (
            process("run", "gateway.toml", "--status", "status", cwd=folder, ready="monitoring"),
            process("serve", "--status", "status", "--port", "0", *tokens, cwd=folder, ready="page:") as page,
        ):
            port = int(re.search(r":(\d+)/", page.said)[1])
            made = SimpleNamespace(folder=folder, pid=page.pid, port=port, reading=reading, control=control)
            wait_for(lambda: told(made)["entries"])
            yield made
            assert page.poll() is None, "it serves still"


def told(site):
    """What testers see, and what has been done to the gateway."""
    entries = json.loads(gateway("faults", "list", "gateway.toml", "--json", cwd=site.folder).stdout)
    interventions = json.loads(gateway("faults", "interventions", "gateway.toml", "--json", cwd=site.folder).stdout)
    return {"entries": entries, "interventions": interventions}


def status_of(site, path, token):
    data = request(site.port, path, Connection="close", Authorization=f"Bearer {token}")
    return said(site.port, data)[0]


def test_what_means_harm_is_refused_changes_nothing_and_others_are_served(site):
    seed = int(os.environ.get("GATEWAY_SEED", time.time_ns() % 10**6))
    print(f"seed {seed}")
    draw = random.Random(seed)
    drawn = attacks(site.port, draw, reading=site.reading, control=site.control)
    before = told(site)
    kinds = Counter()
    held = []

    def attack(count):
        for _ in range(count):
            kind, data, refusals = next(drawn)
            status, heard = said(site.port, data)
            assert status in refusals, (kind, status, data[:200])
            assert heard.count(b"HTTP/1.1 ") <= 1, (kind, "one answer", heard[:400])
            assert not [bad for bad in (site.control, site.reading, "root:", "Traceback") if bad.encode() in heard]
            kinds[kind, status] += 1
            held.append(memory_of(site.pid))

    attack(60)  # all kinds, twice
    with slow_clients(site.port, 20) as slow:
        attack(amount(940, 90, 30))
        assert [status_of(site, path, site.reading) for path in ("/", "/metrics")] == [200, 200]
        assert all(map(was_sent_away, slow)), "closed without a word"
    for (kind, status), count in sorted(kinds.items(), key=str):
        print(f"{kind:24} {status} {count:5}")
    print(f"memory {held[59]} kB, then {max(held)} kB at most")
    assert max(held) < held[59] + 32_000
    assert told(site) == before
    metrics = said(
        site.port, request(site.port, "/metrics", Connection="close", Authorization=f"Bearer {site.reading}")
    )[1]
    refused = re.search(rb"gateway_page_refused_total ([0-9.]+)", metrics)
    assert float(refused[1]) >= sum(count for (_, status), count in kinds.items() if status in (401, 403, 413, 421))


def test_who_hoards_connections_keeps_nobody_out(site):
    """More than there may be, all silent: those that have been silent for longest go."""
    own = sockets_of(site.pid)
    with slow_clients(site.port, 4 * MOST_CONNECTIONS) as hoarded:
        assert status_of(site, "/", site.reading) == 200
        assert sockets_of(site.pid) <= own + MOST_CONNECTIONS
        assert all(map(was_sent_away, hoarded)), "in the end all of them"
    wait_for(lambda: sockets_of(site.pid) <= own)


def test_streams_that_nobody_reads_take_bounded_memory_and_no_more_than_their_places(site):
    ask = request(site.port, "/api/stream", Authorization=f"Bearer {site.reading}")

    def begun():
        connection = socket.create_connection(("127.0.0.1", site.port), timeout=PATIENCE_S)
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        connection.sendall(ask)
        return connection, connection.recv(12)

    opened = []
    try:
        for _ in range(MOST_VIEWERS + 5):
            opened.append(begun())
        assert Counter(head for _, head in opened) == {b"HTTP/1.1 200": MOST_VIEWERS, b"HTTP/1.1 503": 5}
        assert status_of(site, "/metrics", site.reading) == 200
    finally:
        for connection, _ in opened:
            connection.close()

    def is_free_again():
        connection, head = begun()
        connection.close()
        return head == b"HTTP/1.1 200"

    wait_for(is_free_again)


def test_a_signal_with_pages_open_ends_them_and_logs_nothing(tmp_path):
    opened = []
    try:
        with server(tmp_path) as served:
            for _ in range(3):
                connection = socket.create_connection(("127.0.0.1", served[1]), timeout=PATIENCE_S)
                connection.sendall(request(served[1], "/api/stream"))
                assert connection.recv(12) == b"HTTP/1.1 200"
                opened.append(connection)
            log = served.process.stderr
            os.set_blocking(log.fileno(), True)
            served.process.terminate()
            assert log.read() == "", "no traceback of a page that was open"
            for connection in opened:
                assert read_to_end(connection).endswith(b"0\r\n\r\n"), "the stream has ended, and was not cut"
            assert served.process.wait(60) == 0
            served.process.poll = lambda: None  # it was to end
    finally:
        for connection in opened:
            connection.close()


def read_to_end(connection):
    """Return all that comes."""
    parts = []
    while part := connection.recv(1 << 16):
        parts.append(part)
    return b"".join(parts)


def test_who_does_not_read_an_answer_is_sent_away(tmp_path):
    """All connections that there may be, each with a file of a megabyte that is not read; with short times."""
    program = (
        "import gateway_serve.guard as guard, gateway_serve.server as server; guard.SEND_S = server.HEAD_S = 1.0;"
        "from gateway.cli import main; main()"
    )
    with server(tmp_path, program=program) as (_, port, _, pid):
        assert said(port, request(port, Connection="close"))[0] == 200
        own = sockets_of(pid)
        ask = request(port, "/bokeh/bokeh.min.js")
        opened = []
        try:
            for _ in range(MOST_CONNECTIONS):
                connection = socket.socket()
                connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
                connection.connect(("127.0.0.1", port))
                connection.sendall(ask)
                opened.append(connection)
            wait_for(lambda: sockets_of(pid) <= own)
            assert said(port, request(port, Connection="close"))[0] == 200
        finally:
            for connection in opened:
                connection.close()


def test_a_body_that_does_not_come_is_not_waited_for(site):
    ask = request(
        site.port, "/api/clear", "POST", b'{"dtc"', Content_Length=20, Content_Type="application/json",
        Authorization=f"Bearer {site.control}",
    )  # fmt: skip
    assert said(site.port, ask)[0] == 408


def test_a_page_says_what_others_may_do_with_it(page):
    with urllib.request.urlopen(page[0]) as answer:
        assert b"<title>gateway</title>" in answer.read()
        policy = answer.headers["content-security-policy"]
        assert "script-src 'self'" in policy
        assert "unsafe-eval" not in policy
        assert answer.headers["x-content-type-options"] == "nosniff"


def test_a_right_request_without_a_daemon_says_so(page):
    url, _, token, _ = page
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
    with server(tmp_path, *options) as (url, _, shown, _):
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
