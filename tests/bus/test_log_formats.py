"""Formats of logs: of several that know one the binary one reads it, else the one of the lowest rank."""

import sys

import pytest

from gateway.bus.log_format import CANDUMP, OTHERS, LogFormat, formats
from gateway.bus.logs import LogReader, is_format, open_writer
from gateway_fdi.errors import InputError

CSV = "timestamp,arbitration_id,extended,remote,error,dlc,data\n"
ASC = "date Mon Nov 30 00:00:00 2026\nbase hex  timestamps absolute\n"


def test_the_core_has_its_own_and_those_of_the_door():
    assert list(formats())[-1] == ".log"
    assert formats()[".log"] is CANDUMP
    assert len(formats()) == 7
    assert all(isinstance(each, LogFormat) for each in formats().values())


def test_formats_that_cannot_be_used_concern_their_own_logs_only(tmp_path, monkeypatch):
    monkeypatch.setattr(OTHERS, "_known", {})
    monkeypatch.setitem(sys.modules, "gateway_logs.formats", None)
    (tmp_path / "a.log").write_text("(1.000000) can0 123#00\n")
    assert sum(map(len, LogReader(tmp_path / "a.log"))) == 1
    (tmp_path / "a.csv").write_text(CSV)
    with pytest.raises(InputError, match=r"gateway_logs\.formats cannot be imported"):
        LogReader(tmp_path / "a.csv")
    with pytest.raises(InputError, match=r"gateway_logs\.formats cannot be imported"):
        open_writer(tmp_path / "b.csv")
    assert is_format(".csv"), "of a folder it is one, and its error is told"


def test_lines_in_a_binary_log_are_none_of_a_text(tmp_path):
    path = tmp_path / "a.csv"
    path.write_bytes(b"LOGG" + f"\n{CSV}".encode() + bytes(200))
    assert LogReader(path).formats == ["Vector BLF"]


def test_the_lowest_rank_reads_a_log_that_two_know(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text(ASC + CSV)
    assert LogReader(path).formats == ["Vector ASC"]
    path.rename(tmp_path / "a.csv")
    assert LogReader(tmp_path / "a.csv").formats == ["CSV"], "the suffix decides between them"


@pytest.mark.parametrize("suffix", [".mf4", ".parquet"])
def test_a_format_whose_package_is_missing_is_told_before_any_work(tmp_path, monkeypatch, suffix):
    for package in ("asammdf", "pyarrow"):
        monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(InputError, match=rf"\[{suffix[1:]}\]"):
        open_writer(tmp_path / f"a{suffix}")
    assert not list(tmp_path.iterdir())
