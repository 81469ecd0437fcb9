"""Frame logs in Parquet: ours read by others, others' read by us, mistakes in columns named."""

import datetime

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from duck import ask
from typer.testing import CliRunner

from gateway.bus.frames import BRS, ERROR, ESI, EXTENDED, FD, FD_LENGTHS, OWN, REMOTE, empty
from gateway.bus.log_source import CutOffError
from gateway.bus.logs import LogReader, open_writer
from gateway.cli import app
from gateway_fdi.errors import InputError
from gateway_logs.corpus import find

SEED = 410
BEGIN_NS = 1_700_000_000 * 10**9


def some_frames(count, seed=SEED):
    """Return frames of all kinds on three buses."""
    rng = np.random.default_rng(seed)
    frames = empty(count)
    frames["t_ns"] = BEGIN_NS + np.cumsum(rng.integers(0, 10**6, count))
    frames["bus"] = rng.integers(0, 3, count)
    for frame in frames:
        extended, kind = rng.random() < 0.5, rng.integers(0, 5)
        frame["can_id"] = int(rng.integers(2**29)) | EXTENDED if extended else int(rng.integers(2**11))
        frame["flags"] = OWN if rng.random() < 0.2 else 0
        if kind == 0:
            frame["can_id"] |= REMOTE
            continue
        if kind == 1:
            frame["can_id"] = ERROR | int(rng.integers(2**9))
        size = int(rng.integers(9))
        if kind == 2:
            frame["flags"] |= FD | int(rng.choice([0, BRS, ESI, BRS | ESI]))
            size = int(rng.choice(FD_LENGTHS))
        frame["length"] = size
        frame["data"][:size] = np.frombuffer(rng.bytes(size), np.uint8)
    return frames


def written(path, frames, interfaces=None):
    with open_writer(path, interfaces=interfaces) as writer:
        for first in range(0, len(frames), 300):
            writer.write(frames[first : first + 300])
    return path


def all_of(path, **how):
    parts = list(LogReader(path, **how))
    return np.concatenate(parts) if parts else empty(0)


@pytest.mark.parametrize("chunk", [1, 7, 1000])
def test_frames_of_all_kinds_go_and_come(tmp_path, chunk):
    frames = some_frames(1000)
    path = written(tmp_path / "a.parquet", frames, {0: "vcan0", 1: "body"})
    again = all_of(path, chunk=chunk, channels={"vcan0": 0, "body": 1, "can2": 2})
    np.testing.assert_array_equal(again, frames)
    reader = LogReader(path)
    assert sum(map(len, reader)) == 1000
    assert reader.seen == {"vcan0": (frames["bus"] == 0).sum(), "body": (frames["bus"] == 1).sum(),
                           "can2": (frames["bus"] == 2).sum()}  # fmt: skip
    assert np.array_equal(all_of(path, channels={"body": 0})["t_ns"], frames["t_ns"][frames["bus"] == 1])


def test_nothing_is_a_log_too(tmp_path):
    written(tmp_path / "a.parquet", empty(0))
    assert len(all_of(tmp_path / "a.parquet")) == 0


def test_others_read_it(tmp_path):
    frames = some_frames(500)
    path = written(tmp_path / "a.parquet", frames)
    rows = ask(f"select epoch_ns(t), id, extended, fd, channel, hex(data), remote from '{path}'")
    for frame, row in zip(frames, rows, strict=True):
        assert tuple(row) == (
            frame["t_ns"], frame["can_id"] & 0x1FFFFFFF, bool(frame["can_id"] & EXTENDED), bool(frame["flags"] & FD),
            f"can{frame['bus']}", bytes(frame["data"][: frame["length"]]).hex().upper(), bool(frame["can_id"] & REMOTE),
        )  # fmt: skip


LOOSE = {
    "t": pa.array([datetime.datetime(2023, 11, 14, 22, 13, 20, 5, datetime.UTC)] * 3, pa.timestamp("us", "UTC")),
    "id": pa.array([1, 0x800, 2], pa.int64()),
    "data": pa.array([b"\1\2", b"", bytes(range(12))], pa.large_binary()),
}


def test_other_types_of_columns(tmp_path):
    """Three columns are enough; seconds to nanoseconds, lists, fixed sizes, dictionaries, numbers of channels."""
    path = tmp_path / "a.parquet"
    pq.write_table(pa.table(LOOSE), path)
    first = all_of(path)
    assert first["t_ns"].tolist() == [BEGIN_NS + 5000] * 3
    assert first["can_id"].tolist() == [1, 0x800 | EXTENDED, 2]
    assert first["length"].tolist() == [2, 0, 12]
    assert first["flags"].tolist() == [0, 0, FD]
    assert LogReader(path).seen == {}
    others = {
        "t": LOOSE["t"].cast(pa.int64()).to_numpy() * 1000,
        "id": pa.array([1, 0x800, 2], pa.uint16()),
        "data": pa.array([[1, 2], [], list(range(12))], pa.list_(pa.uint8())),
        "channel": pa.array([3, None, 7], pa.int8()),
        "unknown": pa.array([1, 2, 3]),
    }
    pq.write_table(pa.table(others), path)
    np.testing.assert_array_equal(all_of(path), first)
    np.testing.assert_array_equal(all_of(path, chunk=1), first)
    reader = LogReader(path, channels={"3": 0, "none": 1})
    assert [len(batch) for batch in reader] == [2]
    assert reader.seen == {"3": 1, "none": 1, "7": 1}
    pq.write_table(pa.table(LOOSE | {"data": pa.array([b"\1\2"] * 3, pa.binary(2))}), path)
    assert all_of(path, chunk=2)["data"][:, :3].tolist() == [[1, 2, 0]] * 3


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"id": None, "can_id": LOOSE["id"]}, r"id: no such column; .* has t, id, data, it has .*did you mean can_id"),
        ({"data": None}, r"a\.parquet: data: no such column"),
        ({"t": pa.array([1.0, 2.0, 3.0])}, r"a\.parquet: t = 'double': this column is a timestamp, or int64 nanosec"),
        ({"fd": pa.array([0, 1, 0])}, r"a\.parquet: fd = 'int64': this column is boolean"),
        ({"id": pa.array([1, None, 2])}, r"a\.parquet: id: no value in row 1"),
        ({"id": pa.array([1, 2, -4])}, r"a\.parquet: id = -4: no identifier, in row 2"),
        ({"data": pa.array([b"", b"", bytes(65)])}, r"a\.parquet: data = 65: a payload above 64 bytes, in row 2"),
        ({"t": pa.array([10**12] * 3, pa.timestamp("s"))}, r"a\.parquet: t: .*out of bounds"),
    ],
)  # fmt: skip
def test_mistakes_are_named(tmp_path, change, text):
    path = tmp_path / "a.parquet"
    columns = {name: column for name, column in (LOOSE | change).items() if column is not None}
    pq.write_table(pa.table(columns), path)
    with pytest.raises(InputError, match=text):
        all_of(path)


def test_a_file_without_its_end(tmp_path):
    path = written(tmp_path / "a.parquet", some_frames(200))
    whole = path.read_bytes()
    for cut in (0, 3, len(whole) // 2, len(whole) - 1):
        path.write_bytes(whole[:cut])
        with pytest.raises(
            CutOffError if cut in (0, len(whole) // 2, len(whole) - 1) else InputError, match=r"a\.parq"
        ):
            all_of(path)
    path.write_bytes(b"nonsense")
    with pytest.raises(InputError, match="not a Parquet file"):
        all_of(path)


def test_a_pattern_takes_tables_of_frames_only(tmp_path):
    (tmp_path / "logs" / "A").mkdir(parents=True)
    written(tmp_path / "logs" / "A" / "a.parquet", some_frames(3))
    pq.write_table(pa.table({"t": [1], "Speed": [2.0]}), tmp_path / "logs" / "A" / "signals.parquet")
    assert [one.path.name for one in find([tmp_path / "logs"])] == ["a.parquet"]
    assert [one.name for one in find([str(tmp_path / "logs" / "**")])] == ["a"]
    (named,) = find([tmp_path / "logs" / "A" / "signals.parquet"])
    with pytest.raises(InputError, match=r"signals\.parquet: id: no such column"):
        all_of(named.path)


def convert(*words):
    return CliRunner().invoke(app, ["convert", "log", *map(str, words)])


def test_any_log_becomes_parquet_and_back(tmp_path):
    frames = some_frames(400)
    source = written(tmp_path / "a.log", frames, {0: "vcan0", 1: "body", 2: "can2"})
    ended = convert(source, tmp_path / "a.parquet")
    assert ended.exit_code == 0, ended.output
    assert "400 frames" in ended.output
    assert convert(tmp_path / "a.parquet", tmp_path / "b.log").exit_code == 0
    assert (tmp_path / "b.log").read_text() == source.read_text()
    assert convert(source, tmp_path / "a.blf").exit_code == 0
    assert convert(tmp_path / "a.blf", tmp_path / "c.parquet", "--json").exit_code == 0
    assert LogReader(tmp_path / "c.parquet").seen == {}
    reader = LogReader(tmp_path / "c.parquet")
    assert sum(map(len, reader)) == 400
    assert set(reader.seen) == {"0", "1", "2"}


def test_what_a_damaged_log_holds_is_converted_and_told(tmp_path):
    source = written(tmp_path / "a.log", some_frames(50))
    source.write_text(source.read_text() + "nonsense\n")
    ended = convert(source, tmp_path / "a.parquet")
    assert "a.log:51" in str(ended.exception)
    assert len(all_of(tmp_path / "a.parquet")) == 50
    assert "not converted into itself" in str(convert(source, source).exception)
