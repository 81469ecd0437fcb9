"""Servers of other packages: by a table [[server]], beside ours; errors of the table, and of the server."""

import pytest
from rig import Rig, write_config

from gateway.config.load import load_config
from gateway.engine.checks.kinds import KINDS
from gateway.servers.types import SERVERS
from gateway_commands.configuration_schema import schema
from gateway_fdi.common.resources import shipped
from gateway_fdi.errors import InputError, InputErrors

TABLE = """
[[server]]
name = "bench"
type = "workshop.server:SERVER"
request = 0x6A0
response = 0x6A1
"""


@pytest.fixture
def file(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(shipped("examples") / "workshop")
    monkeypatch.setenv("GATEWAY_TRUST", "all")
    return write_config(tmp_path, extra=TABLE)


def test_a_server_of_another_package_answers_from_the_memory(file):
    rig = Rig(file)
    assert rig.feed((0x6A0, b"")) == [(0x6A1, b"\0")]
    rig.fail(1)
    rig.fail(2)
    found = rig.feed((0x6A0, b""))
    assert found == [(0x6A1, b"\x02" + bytes.fromhex("500111900211"))], "C1001-11, B1002-11"
    assert rig.gateway.summary(1.0)["counters"]["bench_answers"] == 2
    other = Rig(file)
    other.gateway.succeed(rig.gateway)
    assert len(other.feed((0x6A0, b""))) == 1, "after a reload, too"
    other.close()


def test_its_identifiers_belong_to_its_bus(file):
    file.write_text(file.read_text().replace("health = { watched = false }", 'health = { unknown = "tell" }'))
    rig = Rig(file)
    for _ in range(50):
        rig.feed((0x6A1, b"\0"), (0x6A2, b"\0"))
    rig.wait(2000)
    told = {event["sensor"] for event in rig.events if event["event"] == "security"}
    assert told == {"b.6A2"}
    rig.close()


@pytest.mark.parametrize(
    ("old", "new", "key", "said"),
    [
        ('"workshop.server:SERVER"', '"workshp"', "server[0].type", "the types are"),
        ('"workshop.server:SERVER"', '"workshop.server:Params"', "server[0].type", "no ServerType"),
        ("request = 0x6A0", "request = 0xFFFF", "server[0].request", "2047"),
        ("request = 0x6A0", "requst = 0x6A0", "server[0].requst", "request"),
        ("request = 0x6A0", 'request = 0x6A0\nbus = "can7"', "server[0].bus", "the buses are b"),
        ("health =", "listen_only = true\nhealth =", "server[0]", "only listened to"),
    ],
)
def test_a_wrong_table_is_told_by_its_key(file, old, new, key, said):
    file.write_text(file.read_text().replace(old, new))
    with pytest.raises((InputError, InputErrors)) as wrong:
        load_config(file)
    assert key in str(wrong.value)
    assert said in str(wrong.value)


def test_a_server_that_fails_is_counted_and_ends_no_gateway(file, monkeypatch, caught):
    rig = Rig(file)
    with monkeypatch.context() as broken:
        broken.setattr("workshop.server.put", lambda *_, **__: 1 / 0)
        assert rig.feed((0x6A0, b"")) == []
    assert [door for door, *_ in caught] == ["workshop"]
    rig.wait(200)  # it rests
    assert len(rig.feed((0x6A0, b""))) == 1
    rig.close()


def test_the_schema_has_the_keys_of_each_type(file, monkeypatch):
    from workshop.server import SERVER

    monkeypatch.setattr(type(SERVERS), "described", lambda self: {"workshop": SERVER} if self is SERVERS else {})
    (mine, other) = schema()["$defs"]["ServerConfig"]["anyOf"]
    assert mine["properties"]["type"] == {"const": "workshop"}
    assert mine["required"] == ["type", "request", "response"]
    assert other["properties"]["type"]["pattern"] == ":"


def test_frames_of_another_length_are_an_event_of_security_and_so_are_five_kinds(file):
    rig = Rig(file)
    rig.fail(1)
    told = [event for event in rig.events if event["event"] == "security"]
    assert [(event["sensor"], event["kind"]) for event in told] == [("b.M1", "length")]
    assert {name for kind in KINDS for name in kind.foreign} == {"length", "mac", "freshness", "early", "second_sender"}
    rig.close()
