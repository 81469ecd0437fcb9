"""Parsed databases that are kept: the same messages, and parsed again whenever they may be others."""

import cantools
import pytest

from gateway.signals import database_cache
from gateway_fdi.common.resources import shipped
from gateway_fdi.jit import cache

DATABASE = shipped("dbc/vehicle.dbc")
#: As large as one that is kept: comments do not change it.
DATA = DATABASE.read_bytes() + b"\n" * database_cache.LEAST


@pytest.fixture
def messages(tmp_path, monkeypatch):
    """Return what reads a database, and counts how often it was parsed."""
    monkeypatch.setattr(cache, "folder", lambda: tmp_path)

    def parse():
        read.parsed += 1
        return cantools.database.load_file(DATABASE).messages

    def read(data=DATA, kind=".dbc"):
        return database_cache.messages_of(data, kind, parse)

    read.parsed = 0
    return read


def test_a_kept_database_decodes_as_the_parsed_one(messages):
    first, again = messages(), messages()
    assert messages.parsed == 1
    assert [one.name for one in again] == [one.name for one in first]
    for one, other in zip(first, again, strict=True):
        payload = bytes(range(1, one.length + 1))
        assert other.decode(payload, scaling=False) == one.decode(payload, scaling=False)


@pytest.mark.parametrize("what", ["bytes", "format", "damaged", "dialect", "version"])
def test_it_is_parsed_again_if_it_may_be_another(what, messages, tmp_path, monkeypatch):
    messages()
    if what == "damaged":
        (file,) = tmp_path.glob("*.parsed")
        file.write_bytes(file.read_bytes()[:-1])
    if what == "dialect":
        monkeypatch.setattr(database_cache, "source_of", lambda _: b"other")
    if what == "version":
        monkeypatch.setattr(database_cache, "version", lambda _: "0")
    messages(DATA + b"\n" if what == "bytes" else DATA, ".kcd" if what == "format" else ".dbc")
    assert messages.parsed == 2


def test_a_small_one_is_not_kept(messages, tmp_path):
    messages(b"x" * (database_cache.LEAST - 1))
    assert not [*tmp_path.iterdir()]
