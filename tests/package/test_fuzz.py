"""A short run of scripts/fuzz: every parser of bytes from outside, the same inputs each time."""

import importlib.machinery
import importlib.util
import sys
from pathlib import Path

import parsers
import pytest
from amount import amount

from gateway_ask.answers.databases import read_cdd
from gateway_fdi.errors import InputError

ROOT = Path(__file__).parents[2]
#: Seconds to load: what reads MF4 is another's, and has a test of its own.
SLOW = ("log.mf4",)


@pytest.fixture(scope="module")
def fuzz():
    loader = importlib.machinery.SourceFileLoader("fuzz_script", str(ROOT / "scripts" / "fuzz"))
    made = importlib.util.module_from_spec(importlib.util.spec_from_loader("fuzz_script", loader))
    before = list(sys.path)
    loader.exec_module(made)
    sys.path[:] = before
    return made.fuzz


CASES = [name for name in parsers.TARGETS if name not in SLOW]


@pytest.mark.evidence("Bounded: parsers")
@pytest.mark.parametrize("name", CASES)
def test_no_parser_fails_by_what_comes(fuzz, name):
    count, wrong = fuzz(name, "65", seconds=0, inputs=amount(5_000, 8, 6), keep=None)
    assert count >= 6
    assert wrong == []


def test_a_text_of_cdd_that_is_no_xml_is_refused(tmp_path):
    """Found by scripts/fuzz: cantools reads it by another encoding, and what is read beside it had its own error."""
    with parsers.opened("layouts.cdd", tmp_path) as target:
        target.feed(target.samples[0].replace(b"Torque", b"Torqu\xe9"))
        with pytest.raises(InputError, match=r"given\.cdd: not a good \.cdd file"):
            read_cdd(tmp_path / "given.cdd", None)


def test_an_interface_that_two_readers_cut_at_different_places_is_not_read_for_ever(fuzz, tmp_path):
    """Found by scripts/fuzz: the kernel ends a word at any control byte, Python at some; the line was asked again."""
    with parsers.opened("log.log", tmp_path) as target:
        target.feed(target.samples[0])
        with fuzz.__globals__["bounded"]():
            target.feed(target.samples[0].replace(b"can0 11E", b"c\x18an0 11E"))


def test_what_never_ends_is_a_bug_too(fuzz, monkeypatch):
    def feed(data):
        while True:
            pass

    monkeypatch.setitem(fuzz.__globals__, "LONGEST_S", 0.02)
    monkeypatch.setitem(parsers.TARGETS, "bad", lambda folder, stack: parsers.Target((), feed))
    monkeypatch.setitem(fuzz.__globals__, "drawn", lambda draw, samples: b"")
    count, wrong = fuzz("bad", "1", seconds=0, inputs=1, keep=None)
    assert count == len(wrong) == 1
    assert "TimeoutError" in wrong[0]


def test_a_parser_that_fails_is_found_and_its_input_kept(fuzz, tmp_path, monkeypatch):
    def feed(data):
        if b"\xff" in data:
            raise TypeError("a bug")

    monkeypatch.setitem(parsers.TARGETS, "bad", lambda folder, stack: parsers.Target((b"abc", b'{"a": 1}'), feed))
    count, wrong = fuzz("bad", "1", seconds=0, inputs=2000, keep=tmp_path / "kept")
    assert count < 2000
    assert len(wrong) == 5, "then it is enough"
    assert "TypeError: a bug" in wrong[0]
    kept = list((tmp_path / "kept").iterdir())
    assert 1 <= len(kept) <= 5
    assert all(b"\xff" in file.read_bytes() for file in kept)
    with pytest.raises(TypeError), parsers.opened("bad", tmp_path) as target:
        target.feed(kept[0].read_bytes())
