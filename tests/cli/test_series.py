"""``gateway replay --signals``, ``--plot``, ``gateway plot``: what monitors compute over time."""

import csv
import json
import math

import numpy as np
import pyarrow.parquet as pq
import pytest
from command import command

from gateway.common import extras
from gateway_fdi.common.resources import shipped
from gateway_replay.series import files, gather
from gateway_replay.series.envelope import BUCKETS, Envelope
from gateway_replay.series.rows import RESULTS, Rows, Series

MOTOR, SIGNALS = shipped("configs/motor.toml"), shipped("configs/signals.toml")


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    """The drives of two scenarios, recorded."""
    folder, found = tmp_path_factory.mktemp("logs"), {}
    with pytest.MonkeyPatch.context() as patch:
        for name in ("motor_faults", "signals_faults"):
            found[name] = folder / f"{name}.log"

            class Quiet:
                @staticmethod
                def readouterr():
                    return type("Said", (), {"out": "", "err": ""})

            command(Quiet, patch, "simulate", name, "--bus", "inside", "--record", found[name])
    lines = found["motor_faults"].read_text().splitlines(keepends=True)
    found["motor_faults"].write_text("".join(lines[:2600]))  # 13 s: one DTC
    return found


def rows_of(path):
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def series(rows, kind, name):
    mine = [r for r in rows if r["kind"] == kind and r["name"] == name]
    return [int(r["t_ns"]) for r in mine], [float(r["value"] or "nan") for r in mine]


@pytest.mark.long
@pytest.mark.parametrize(("name", "config"), [("motor_faults", MOTOR), ("signals_faults", SIGNALS)])
def test_events_are_the_same_and_rows_are_those_of_the_trace(logs, tmp_path, capsys, monkeypatch, name, config):
    def events(*options):
        ended = command(capsys, monkeypatch, "replay", logs[name], "-c", config, "--json", *options)
        return ended, [e for e in ended.events if e["event"] not in ("summary", "log")]

    plain, before = events()
    watched, after = events("--signals", tmp_path / "out.csv")
    assert before == after
    assert len(before) >= 2
    first, second = plain.event("summary"), watched.event("summary")
    assert {k: first[k] for k in ("frames", "decoded", "events", "dtcs", "monitors", "counters")} == {
        k: second[k] for k in ("frames", "decoded", "events", "dtcs", "monitors", "counters")
    }
    rows = rows_of(tmp_path / "out.csv")
    assert [int(r["t_ns"]) for r in rows] == sorted(int(r["t_ns"]) for r in rows)
    told = [(e["t_ns"], e["dtc"], e["fault"].rpartition(".")[2]) for e in before if e["event"] == "dtc"]
    assert [(int(r["t_ns"]), *r["name"].split(" ")) for r in rows if r["kind"] == "dtc"] == told
    if name == "signals_faults":
        return
    _, steps = events("--only", "motor", "--trace")
    expected = {}
    for e in (e for e in steps if e["event"] == "step"):
        assert e["not_shown"] == 0
        expected[e["t_ns"]] = e["state"]["own"]["residual"][0]  # of several at one time the last
    held, at = [], iter(zip(*series(rows, "quantity", "residual of e1"), strict=True))
    following, now = next(at, None), math.nan
    for t in expected:
        while following and following[0] <= t:
            now, following = following[1], next(at, None)
        held.append(now)
    assert held == list(expected.values())
    assert len(set(held)) > 200
    reported = [(e["t_ns"], r) for e in steps if e["event"] == "step" for r in e.get("results", ())]
    for t, value in zip(*series(rows, "fault", "f_w"), strict=True):
        assert any(when == t and r["fault"] == "f_w" and r["value"] == value for when, r in reported)
    last = {(r["name"]): r["result"] for r in rows if r["kind"] == "fault" and r["monitor"] == "motor"}
    assert (last["f_w"], last["f_i"]) == ("failed", "passed")


@pytest.mark.long
def test_timers_are_looked_behind_each(logs, tmp_path, capsys, monkeypatch):
    """Samples by the clock at 2 ms between frames at 10 ms: a row for each, at the timer's own time."""
    text = MOTOR.read_text().replace('sample = "set"', "").replace("period_ms = 10.0", "period_ms = 2.0")
    (tmp_path / "clock.toml").write_text(text)
    command(
        capsys, monkeypatch, "replay", logs["motor_faults"], "-c", tmp_path / "clock.toml",
        "--signals", tmp_path / "out.csv",
    )  # fmt: skip
    t, _ = series(rows_of(tmp_path / "out.csv"), "quantity", "residual of e1_2")
    between = [x for x in t if x % 10_000_000 >= 1_000_000]
    assert len(between) > 4 * 600
    assert all(x % 2_000_000 == 0 for x in between)


@pytest.mark.long
def test_parquet_is_csv_in_row_groups(logs, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(gather, "GROUP", 1000)
    out = [tmp_path / "out.csv", tmp_path / "out.parquet"]
    for path in out:
        ended = command(
            capsys, monkeypatch, "replay", logs["motor_faults"], "-c", MOTOR, "--signals", path,
            "--signal", "Sensors.Speed", "--signal", "Drive.Voltage",
        )  # fmt: skip
        assert f"series: {path}" in " ".join(ended.out.split())
    table = pq.ParquetFile(out[1])
    assert table.num_row_groups > 5
    assert max(table.metadata.row_group(k).num_rows for k in range(table.num_row_groups)) <= 1000
    rows, same = rows_of(out[0]), table.read().to_pylist()
    assert len(rows) == len(same) > 6000
    for a, b in zip(rows, same, strict=True):
        expected = {k: v for k, v in a.items() if k not in ("t_ns", "value", "limit")}
        expected |= {"t_ns": int(a["t_ns"])} | {k: float(a[k]) if a[k] else None for k in ("value", "limit")}
        assert b == expected
    t, speed = series(rows, "signal", "Sensors.Speed")
    assert 110 < min(v for v in speed if v == v) < max(v for v in speed if v == v) < 170  # noqa: PLR0124
    assert len(t) > 800
    read = [x for x, _ in files.read_series(out[1], key="SERIES")]
    assert sum(map(len, read)) == len(rows)


@pytest.mark.long
def test_pictures(logs, tmp_path, capsys, monkeypatch):
    text = {}
    for k, options in enumerate(((), ("--only", "motor"))):
        path = tmp_path / f"{k}.svg"
        command(
            capsys, monkeypatch, "replay", logs["motor_faults"], "-c", MOTOR, "--plot", path,
            "--signals", tmp_path / "out.csv", *options,
        )  # fmt: skip
        text[path] = path.read_text()
        assert text[path].count("<path") > 20
    again = tmp_path / "again.svg"
    ended = command(capsys, monkeypatch, "plot", tmp_path / "out.csv", "-o", again, "--only", "T over J of e5")
    assert ended.code == 0
    assert f"drawn: {again}" in ended.out
    assert 0 < again.read_text().count("<path") < text[path].count("<path")
    wrong = command(capsys, monkeypatch, "plot", tmp_path / "out.csv", "-o", again, "--only", "T over J of e9")
    assert wrong.code == 2
    assert "did you mean T over J of e" in wrong.err
    assert len(wrong.err) < 200
    as_told = command(capsys, monkeypatch, "plot", tmp_path / "out.csv", "-o", again, "--only", "motor.T over J of e5")
    assert as_told.code == 0, as_told.err


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--signals", "out.txt"), r"--signals = 'out.txt': series are .parquet or .csv"),
        (("--signals", "nowhere/out.csv"), "--signals = 'nowhere/out.csv': cannot be written: No such file"),
        (("--plot", "out.txt"), "--plot = 'out.txt': a picture is .svg, .png, .pdf"),
        (("--signal", "Sensors.Speed"), "--signal = 'Sensors.Speed': goes with --signals or --plot"),
        (("--signals", "out.csv", "--signal", "Sensors.Sped"), "--signal = 'Sensors.Sped'.*did you mean"),
    ],
)
def test_mistakes(logs, tmp_path, capsys, monkeypatch, options, said):
    monkeypatch.chdir(tmp_path)
    ended = command(capsys, monkeypatch, "replay", logs["motor_faults"], "-c", MOTOR, *options)
    assert ended.code == 2
    assert len(ended.err.strip().splitlines()) == 1
    import re

    assert re.search(said, ended.err), ended.err


def test_without_pyarrow_it_says_what_to_install(logs, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(extras, "find_spec", lambda name: None if name == "pyarrow" else object())
    ended = command(
        capsys, monkeypatch, "replay", logs["motor_faults"], "-c", MOTOR, "--signals", tmp_path / "out.parquet"
    )
    assert ended.code == 2
    assert "pip install '.[parquet]'" in ended.err


@pytest.mark.parametrize("content", ["a,b\n1,2\n", "", "t_ns,monitor,kind,name,value,limit,result,unit\n1,2\n"])
def test_other_files_are_refused(tmp_path, capsys, monkeypatch, content):
    (tmp_path / "x.csv").write_text(content)
    (tmp_path / "x.parquet").write_text(content)
    for name in ("x.csv", "x.parquet", "none.csv"):
        ended = command(capsys, monkeypatch, "plot", tmp_path / name, "-o", tmp_path / "x.svg")
        assert ended.code == 2
        assert "no file of series" in ended.err


def test_an_envelope_is_bounded_and_loses_no_extreme():
    """A million rows with one outlier: it is there, and everything is in few buckets."""
    rng = np.random.default_rng(7)
    values = rng.normal(size=1_000_000)
    values[765_432] = 99.0
    envelope, one = Envelope(), Series("m", "quantity", "r")
    for begin in range(0, len(values), 50_000):
        part = values[begin : begin + 50_000]
        n = len(part)
        rows = Rows(
            np.arange(begin, begin + n) * 1000, np.zeros(n, np.int32), part, np.full(n, 3.0),
            np.where(part > 50, RESULTS.index("failed"), 0).astype(np.int8),
        )  # fmt: skip
        envelope.write(rows, [one])
        assert len(envelope.traces[one].t_ns) <= 2 * BUCKETS
    trace = envelope.traces[one]
    assert len(trace.t_ns) > BUCKETS / 2
    assert trace.high.max() == 99.0
    assert trace.low.min() == values.min()
    (at,) = np.flatnonzero(trace.failed)
    assert trace.t_ns[at] <= 765_432_000 < trace.t_ns[at + 1]
    assert json.dumps(trace.limit.tolist()).count("3.0") == len(trace.t_ns)


def test_the_limit_of_a_bucket_is_its_last_one():
    count = 40 * BUCKETS
    times = np.arange(count) * 1000
    rows = Rows(
        times, np.zeros(count, np.int32), np.zeros(count), np.arange(count, dtype=float), np.zeros(count, np.int8)
    )
    envelope, one = Envelope(), Series("m", "quantity", "r")
    envelope.write(rows, [one])
    trace = envelope.traces[one]
    ends = np.append(np.searchsorted(times, trace.t_ns[1:]), count) - 1
    assert trace.limit.tolist() == ends.tolist()
    assert len(trace.limit) < count
