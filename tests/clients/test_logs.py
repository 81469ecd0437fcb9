"""Answers in logs that no gateway is fed: gateway decode, and faults that are put into them."""

import json

import pyarrow.parquet as pq
import pytest
from asked_log import recorded
from command import command


def column(folder, message, name):
    return [
        value
        for file in sorted(folder.rglob(f"{message}/**/*.parquet"))
        for value in pq.read_table(file)[name].to_pylist()
    ]


@pytest.mark.long
@pytest.mark.parametrize("way", ["--config", "--ecu"])
def test_answers_in_a_log_are_decoded(way, tmp_path, capsys, monkeypatch):
    file, log, said = recorded(tmp_path)
    (tmp_path / "other.dbc").write_text('VERSION ""\nBU_: A\nBO_ 291 Other: 2 A\n')
    more = ["--database", tmp_path / "other.dbc"] if way == "--ecu" else []
    ended = command(capsys, monkeypatch, "decode", log, "--out", tmp_path / "lake", way, file, *more, "--json")
    assert ended.code == 0, ended.err
    told = json.loads(ended.out)
    lake = tmp_path / "lake"
    cells = [data for did, data in said if did == b"\x21\x01"]
    assert len(cells) > 100
    decoded = column(lake, "Cells", "First")
    assert decoded == pytest.approx([int.from_bytes(data[:2], "big") * 0.001 for data in cells[: len(decoded)]])
    assert len(cells) - len(decoded) in (0, 1)  # one may be under way at the end
    edges = [int.from_bytes(data[55:63], "little") for data in cells]
    assert column(lake, "Cells_2", "Edge") == edges[: len(decoded)]
    assert len(column(lake, "Cells_3", "Last")) == len(decoded)
    speeds = column(lake, "Speed", "Speed")
    assert told["answers"] == 3 * len(decoded) + len(speeds)
    assert any(
        note.startswith(f"ECU battery: {len(decoded) + len(speeds)} answers decoded, 0 ") for note in told["notes"]
    )


@pytest.mark.long
def test_faults_are_put_into_answers(tmp_path, capsys, monkeypatch):
    file, log, _ = recorded(tmp_path)
    out = tmp_path / "judged.toml"
    monitor = '[[monitor]]\nname = "cells"\ntype = "signal"\nbus = "answers:obd"\n'
    monitor += 'signal = [{ signal = "Cells.First", plausible = [2.9, 4.3] }]\n'
    checked = 'check = [{ message = "Speed", timeout_ms = 1000.0, length = false }]\n'
    out.write_text(file.read_text() + checked + monitor)

    def faults(*inject):
        arguments = [part for text in inject for part in ("--inject", text)]
        ended = command(capsys, monkeypatch, "replay", log, "-c", out, "--json", *arguments)
        assert ended.code == 0, ended.err
        events = [json.loads(line) for line in ended.out.splitlines()]
        begun = next(event["t_ns"] for event in events if "t_ns" in event)
        notes = next(event["notes"] for event in events if event["event"] == "log")
        set_ = {e["fault"]: (e["t_ns"] - begun) / 1e9 for e in events if e["event"] == "dtc" and e["status"] & 1}
        return set_, notes

    assert faults()[0] == {}
    set_, notes = faults("offset answers:obd.Cells.First=2 @5")
    assert list(set_) == ["cells.First.high"]
    assert set_["cells.First.high"] > 5
    assert any("--inject" in note and not note.endswith(" 0 frames") for note in notes)
    assert list(faults("drop Speed @8..12")[0]) == ["answers:obd.Speed.timeout"]
