"""``gateway doctor LOG`` and ``gateway convert log``: what a log holds, and what of it is lost."""

import json

from command import command

LOG = "(1700000000.000001) can0 123#11\n(1700000000.5) can1 12345678##3AABB T\nbroken\n(1700000001.0) can0 123#R4\n"


def test_doctor_says_what_a_log_holds(tmp_path, capsys, monkeypatch):
    (tmp_path / "a.log").write_text(LOG)
    said = command(capsys, monkeypatch, "doctor", tmp_path / "a.log", "--json")
    assert said.code == 2, "a line is damaged"
    facts = json.loads(said.out.splitlines()[0])
    assert (facts["formats"], facts["frames"]) == (["candump"], 3)
    first, second = facts["channels"]
    assert (first["channel"], first["received"], first["sent"], first["kinds"]["remote"]) == ("can0", 2, 0, 1)
    assert (first["first_ns"], first["last_ns"]) == (1_700_000_000_000_001_000, 1_700_000_001_000_000_000)
    assert (second["sent"], second["kinds"]["fd"], second["kinds"]["brs"], second["kinds"]["extended"]) == (1, 1, 1, 1)
    (passed,) = facts["passed_over"]
    assert (passed["count"], passed["line"], passed["first"], passed["damaged"]) == (1, 3, "broken", True)
    assert "a.log:3" in said.err


def test_what_a_format_cannot_hold_is_told_with_2(tmp_path, capsys, monkeypatch):
    (tmp_path / "a.log").write_text(LOG.replace("broken\n", ""))
    whole = command(capsys, monkeypatch, "convert", "log", tmp_path / "a.log", tmp_path / "a.asc")
    assert whole.code == 0
    said = command(capsys, monkeypatch, "convert", "log", tmp_path / "a.log", tmp_path / "a.csv")
    assert said.code == 2
    for text in ("the channel (1 frames)", "the direction (sent) (1 frames)", "flags of CAN FD (1 frames)"):
        assert text in said.err
    assert len((tmp_path / "a.csv").read_text().splitlines()) == 4, "all frames are there"
    wrong = command(capsys, monkeypatch, "convert", "log", tmp_path / "a.log", tmp_path / "b.asc", "--zone", "Nowhere")
    assert wrong.code == 2
    assert "time zone" in wrong.err
