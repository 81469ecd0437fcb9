"""Host headers: only those of RFC 9110 that name this server are answered."""

import asyncio
import ipaddress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway_serve.guard import Guard, Rights, host_name

OWN = frozenset({"127.0.0.1", "::1", "localhost", "gateway.example"})


def asked(*hosts):
    """Return the status with which a request with these Host headers is answered; 0: it reached the page."""
    told = []

    async def app(scope, receive, send):
        told.append({"status": 0})

    async def send(message):
        told.append(message)

    scope = {
        "type": "http", "method": "GET", "path": "/", "raw_path": b"/", "query_string": b"", "http_version": "1.1",
        "headers": [(b"host", host.encode("latin-1")) for host in hosts],
    }  # fmt: skip
    asyncio.run(Guard(app, Rights(OWN, "", "control"))(scope, None, send))
    return told[0]["status"]


@pytest.mark.parametrize(
    "host",
    ["127.0.0.1", "127.0.0.1:8808", "localhost:1", "LocalHost:65535", "gateway.example", "[::1]", "[::1]:8808",
     "[0:0:0:0:0:0:0:1]:8808", "localhost:"],
)  # fmt: skip
def test_a_name_of_this_server_is_answered_with_any_port(host):
    assert asked(host) == 0


@pytest.mark.evidence("Releases: Host")
@pytest.mark.parametrize(
    "host",
    ["127.0.0.1:8899/sovd?x", "127.0.0.1/", "127.0.0.1:8808@evil.example", "localhost:evil.example", "127.0.0.1:65536",
     "127.0.0.1:-1", "127.0.0.1:80 80", " 127.0.0.1", "127.0.0.1 ", "[::1", "::1", "[::1]x", "[::1]8808", "[::g]",
     "[127.0.0.1]", "[::1%25lo]", "[v1.x]", "user@127.0.0.1", "127.0.0.1#x", "127.0.0.1,evil.example", "localhost\x00",
     "local\u00dfhost", "", ":8808"],
)  # fmt: skip
def test_what_is_no_host_is_refused(host):
    assert asked(host) == 400


def test_other_names_and_none_or_two_are_refused():
    assert asked("evil.example:8808") == asked("[::2]") == asked("127.0.0.1.evil.example") == asked("a" * 300) == 421
    assert asked() == asked("127.0.0.1", "127.0.0.1") == 421


@pytest.mark.evidence("Releases: Host")
@given(st.text(max_size=20), st.text(max_size=20), st.sampled_from([*sorted(OWN - {"::1"}), "[::1]"]))
def test_a_name_with_anything_around_it_is_that_name_only_with_a_port(before, after, name):
    """Whatever stands around a name of this server: the whole header is the name, a colon and a number, or refused."""
    host = before + name + after
    port = after.removeprefix(":") if after.startswith(":") else None
    whole = not before and (after in ("", ":") or (port is not None and port.isascii() and port.isdecimal()))
    if host_name(host) in OWN:
        assert whole
        assert int(port or 0) <= 65535
    elif whole:
        assert len(port) > 5 or int(port) > 65535


@given(st.ip_addresses(), st.none() | st.integers(0, 65535))
def test_addresses_are_read_as_python_reads_them(address, port):
    text = f"[{address.exploded}]" if address.version == 6 else str(address)
    found = host_name(text if port is None else f"{text}:{port}")
    assert found is not None
    assert ipaddress.ip_address(found) == address
