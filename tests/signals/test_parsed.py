"""Databases that are kept as they were parsed: the same messages, parsed again where they cannot be used."""

import pickle
from pathlib import Path

import pytest

from gateway.signals import parsed
from gateway.signals.database import load_database
from gateway_fdi.common import progress
from gateway_fdi.jit import cache

ROOT = Path(__file__).parents[2]
DATABASES = sorted([*ROOT.glob("dbc/**/*.dbc"), *ROOT.glob("examples/**/*.dbc")])


@pytest.fixture
def said(tmp_path, monkeypatch):
    """A cache of one's own, for databases of any size; what is said."""
    lines = []
    monkeypatch.setenv("GATEWAY_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setattr(cache, "_said", set())
    monkeypatch.setattr(parsed, "LEAST", 0)
    monkeypatch.setattr(progress, "say", lines.append)
    return lines


@pytest.fixture
def parses(monkeypatch):
    """How many databases were parsed."""
    import cantools

    done = []
    load = cantools.database.load_file
    monkeypatch.setattr(cantools.database, "load_file", lambda *a, **more: done.append(a) or load(*a, **more))
    return done


def contents(thing, depth=0):
    """All that a database says."""
    if thing is None or isinstance(thing, (str, int, float)):
        return repr(thing)
    if isinstance(thing, dict):
        return {repr(key): contents(value, depth) for key, value in thing.items()}
    if isinstance(thing, (list, tuple)):
        return [contents(each, depth) for each in thing]
    if hasattr(thing, "__dict__") and depth < 6:
        return {name: contents(value, depth + 1) for name, value in sorted(vars(thing).items())}
    return type(thing).__name__


def test_a_kept_database_is_the_one_that_was_parsed(said, parses):
    first = [contents(list(load_database([path]))) for path in DATABASES]
    count = len(parses)
    again = [contents(list(load_database([path]))) for path in DATABASES]
    assert len(parses) == count > 0
    assert again == first
    assert not said


def test_of_another_content_or_version_it_is_parsed(said, parses, tmp_path, monkeypatch):
    path = tmp_path / "a.dbc"
    path.write_bytes(DATABASES[0].read_bytes())
    load_database([path])
    path.write_bytes(path.read_bytes() + b"\n")
    load_database([path])
    monkeypatch.setattr(parsed, "version", lambda package: "another")
    load_database([path])
    assert len(parses) == 3


@pytest.mark.parametrize("body", [b"", b"no pickle", pickle.dumps([])[:-1], b"cgateway\nnothing\n."])
def test_a_kept_file_that_is_no_good_is_told_and_made_again(said, parses, tmp_path, body):
    load_database([DATABASES[0]])
    (kept,) = (tmp_path / "cache" / "kernels").glob("database-*")
    whole = kept.read_bytes()
    kept.write_bytes(cache._framed(body) if body else whole[:-1])
    assert len(load_database([DATABASES[0]]))
    assert len(parses) == 2
    assert len(said) == 1, said
    assert "parsed again" in said[0]
    assert kept.read_bytes()[:100] == whole[:100]
