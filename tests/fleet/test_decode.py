"""``gateway decode``: tables of signals, with cantools as the oracle and DuckDB as a reader."""

import math
import re
import struct
from datetime import UTC, datetime
from pathlib import Path

import cantools
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from amount import examples
from cantools.database.errors import DecodeError
from duck import ask
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from oracle import said
from random_messages import messages
from typer.testing import CliRunner

from gateway.bus.frames import ERROR, EXTENDED, REMOTE, empty, put
from gateway.bus.logs import open_writer
from gateway.cli import app
from gateway.signals.database import Database, load_database
from gateway_fdi.errors import InputError, InputErrors
from gateway_logs.corpus import find
from gateway_logs.decode.parquet_tables import Lake

S = 10**9
BEGIN_NS = 1_700_000_000 * S


def bits(value):
    return struct.pack("<d", value) if isinstance(value, float) else value


@settings(max_examples=examples(40), deadline=None, suppress_health_check=list(HealthCheck))
@given(messages(), st.data())
def test_tables_equal_cantools_bit_for_bit(tmp_path_factory, message, data):
    folder = tmp_path_factory.mktemp("lake")
    lake = Lake(folder, [Database([(message, None)])], numbers=True)
    can_id = message.frame_id | (EXTENDED if message.is_extended_frame else 0)
    sizes = st.sampled_from([message.length, message.length, 64])
    bodies = data.draw(st.lists(sizes.flatmap(lambda n: st.binary(min_size=n, max_size=n)), min_size=1, max_size=8))
    if message.length and data.draw(st.booleans()):
        bodies.append(bytes(message.length - 1))
    frames = empty(len(bodies))
    for k, body in enumerate(bodies):
        put(frames, k, BEGIN_NS + k, can_id, body)
    tables = lake.begin("car", "a")
    tables.add(frames)
    written = tables.finish()
    expected = []
    for k, body in enumerate(bodies):
        try:
            expected.append((BEGIN_NS + k, message.decode(body, decode_choices=False, allow_truncated=True)))
        except DecodeError:  # a multiplexer selects nothing; what else there is cantools does not say
            expected.append((BEGIN_NS + k, {name: each[-1] for name, each in said(message, body).items()}))
    assert written.rows == len(expected)
    short = sum(len(body) < message.length for body in bodies)
    assert sum(each.count for each in written.short.values()) == short
    rows = pq.read_table(written.files[0]) if written.files else None
    for k, (t_ns, values) in enumerate(expected):
        assert rows["t"][k].value == t_ns
        for name in (signal.name for signal in message.signals):
            found = rows[name][k].as_py()
            if name not in values:
                assert found is None
                continue
            column, value = rows.schema.field(name).type, values[name]
            if column == pa.float64():
                if isinstance(value, float) and math.isnan(value):
                    assert math.isnan(found)
                elif (
                    isinstance(value, int) and abs(value) > 2**53
                ):  # cantools adds before it rounds, a float has to after
                    assert abs(int(found) - value) <= abs(value) // 2**52
                else:
                    assert bits(found) == bits(float(value))
            else:
                assert found == value, "whole numbers stay whole"


#: Of docs/fleet.md.
(QUERY,) = re.findall(
    r"```sql\n(-- in lake.*?)```",
    (Path(__file__).resolve().parents[2] / "docs" / "fleet.md").read_text(encoding="utf-8"),
    re.DOTALL,
)
DBC = """VERSION ""
NS_ :
BS_:
BU_: A
BO_ 256 Gear: 8 A
 SG_ Lever : 0|3@1+ (1,0) [0|5] "" A
 SG_ Speed : 8|16@1+ (0.01,0) [0|655.35] "km/h" A
 SG_ Odometer : 24|32@1+ (1,0) [0|0] "km" A
 SG_ Big : 56|8@1- (2,-3) [0|0] "" A
BO_ 2566844416 Muxed: 8 A
 SG_ Which M : 0|2@1+ (1,0) [0|3] "" A
 SG_ Left m0 : 8|16@1- (1,0) [0|0] "" A
 SG_ Right m1 : 8|16@1+ (0.5,0) [0|0] "V" A
VAL_ 256 Lever 0 "P" 1 "R" 2 "N" 3 "D" 4 "S" 5 "M" ;
VAL_ 256 Speed 65535 "SNA" ;
"""


@pytest.fixture
def car(tmp_path):
    """A database and a log of two days with gear, multiplexed, short, foreign, remote and error frames."""
    (tmp_path / "car.dbc").write_text(DBC)
    midnight = 1_700_006_400 * S
    frames = empty(10)
    muxed = 2566844416 & 0x1FFFFFFF | EXTENDED
    put(frames, 0, midnight - S, 256, struct.pack("<BHIb", 3, 12_345, 4_000_000_000, -128))
    put(frames, 1, midnight - 1, muxed, b"\x00\xfe\xff" + bytes(5))
    put(frames, 2, midnight, muxed, b"\x01\xfe\xff" + bytes(5))
    put(frames, 3, midnight + 1, muxed, b"\x02\xfe\xff" + bytes(5))
    put(frames, 4, midnight + 2, 256, struct.pack("<BHIb", 7, 65_535, 0, 127))
    put(frames, 5, midnight + 3, 256, b"\x01")
    put(frames, 6, midnight + 4, 0x7FF, b"\x01")
    put(frames, 7, midnight + 5, 256 | REMOTE, b"")
    put(frames, 8, midnight + 6, 256 | ERROR, bytes(8))
    put(frames, 9, midnight + 7, 256, struct.pack("<BHIb", 0, 0, 0, 0))
    (tmp_path / "logs" / "A" / "trip").mkdir(parents=True)
    with open_writer(tmp_path / "logs" / "A" / "trip" / "1.log") as writer:
        writer.write(frames)
    return tmp_path


def run(*words):
    return CliRunner().invoke(app, ["decode", *map(str, words)])


def test_a_table_a_message_and_a_file_a_day(car):
    lake = car / "lake"
    ended = run(car / "logs", "-d", car / "car.dbc", "--out", lake)
    assert ended.exit_code == 0, ended.exception
    paths = sorted(str(path.parent.relative_to(lake)) for path in lake.rglob("*.parquet"))
    assert paths == ["A/Gear/2023/11/14", "A/Gear/2023/11/15", "A/Muxed/2023/11/14", "A/Muxed/2023/11/15"]
    assert not list(lake.rglob(".*"))
    gear = pq.read_table(next((lake / "A/Gear/2023/11/15").iterdir())).to_pydict()
    assert gear["Lever"] == ["7", "R", "P"], "a value without a name is its number"
    assert gear["Speed"] == [655.35, None, 0.0], "a measure whose database names one value stays a number"
    assert gear["Big"] == [251, None, -3], "one frame ends before it"
    first = pq.read_table(next((lake / "A/Gear/2023/11/14").iterdir()))
    assert first.schema.types == [
        pa.timestamp("ns", "UTC"), pa.dictionary(pa.int32(), pa.string()), pa.float64(), pa.int64(), pa.int64(),
    ]  # fmt: skip
    assert first.schema.field("Speed").metadata[b"unit"] == b"km/h"
    assert first["t"][0].as_py() == datetime(2023, 11, 14, 23, 59, 59, tzinfo=UTC)
    assert first["Odometer"][0].as_py() == 4_000_000_000
    muxed = pq.read_table(next((lake / "A/Muxed/2023/11/15").iterdir())).to_pydict()
    assert muxed["Left"] == [None, None]
    assert muxed["Right"] == [32767.0, None], "a value that selects neither"


def test_what_is_left_out_is_told(car):
    ended = run(car / "logs", "-d", car / "car.dbc", "--out", car / "lake", "--json")
    assert ended.exit_code == 0
    assert (
        "1 frames of Gear are shorter than the database says, 1 bytes: not in them Speed, Odometer, Big" in ended.output
    )
    assert "1 frames of Muxed have a multiplexer value that the database does not describe" in ended.output
    assert "3 of 10 frames are of no message of the database" in ended.output


def test_the_same_log_again_writes_the_same_files(car):
    for _ in range(2):
        assert run(car / "logs" / "**", "-d", car / "car.dbc", "--out", car / "lake").exit_code == 0
    assert len(list((car / "lake").rglob("*.parquet"))) == 4
    assert ask(QUERY.replace("lake/", f"{car}/lake/"))[-1][1] == 655.35
    answer = ask(f"select max(Speed), count(*) from '{car}/lake/A/Gear/**/*.parquet'")
    assert answer == [(655.35, 4)]


def test_a_damaged_log_gives_what_it_holds_and_is_told(car):
    path = car / "logs" / "A" / "trip" / "1.log"
    path.write_bytes(path.read_bytes() + b"nonsense\n")
    ended = run(path, "-d", car / "car.dbc", "--out", car / "lake")
    assert isinstance(ended.exception, InputErrors)
    assert "1.log:11" in str(ended.exception)
    assert len(list((car / "lake").rglob("*.parquet"))) == 4


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["none.log", "-d", "car.dbc"], "No such file"),
        (["logs/*.xyz", "-d", "car.dbc"], "no logs here"),
        (["logs", "-d", "car.dbc", "--config", "car.toml"], "either databases or a configuration"),
        (["logs", "-d", "car.dbc", "--map", "a=b"], "goes with --config"),
        (["car.dbc", "-d", "car.dbc"], "a log is one of"),
    ],
)
def test_mistakes(words, text, car, monkeypatch):
    monkeypatch.chdir(car)
    ended = run(*words, "--out", "lake")
    assert isinstance(ended.exception, InputError), ended.output
    assert text in str(ended.exception)


def test_tables_do_not_depend_on_batches(car):
    """Long logs are written group by group: rows are the same, whatever the batches were."""
    database = load_database([car / "car.dbc"])
    rng = np.random.default_rng(7)
    frames = empty(3000)
    for k in range(len(frames)):
        put(frames, k, BEGIN_NS + k * S, 256, rng.bytes(8))
    found = []
    for size in (3000, 7):
        lake = Lake(car / f"lake{size}", [database])
        tables = lake.begin("A", "x")
        for first in range(0, len(frames), size):
            tables.add(frames[first : first + size])
        found.append(pq.read_table(tables.finish().files[0]))
    assert found[0].equals(found[1].unify_dictionaries()) or found[0].to_pydict() == found[1].to_pydict()
    message = cantools.database.load_file(car / "car.dbc").get_message_by_name("Gear")
    for k in range(0, 3000, 211):
        expected = message.decode(bytes(frames["data"][k, :8]))
        assert found[0]["Speed"][k].as_py() == float(int.from_bytes(bytes(frames["data"][k, 1:3]), "little") * 0.01)
        assert found[0]["Lever"][k].as_py() == str(expected["Lever"])


def test_logs_and_whose_they_are(tmp_path):
    for name in ("a/1.log", "a/s/2.blf", "b/3.log.gz", "b/notes.txt", "c/frames-000001-20250101T000000Z.log",
                 "c/frames-000002-20250101T000100Z.log", ".hidden/4.log"):  # fmt: skip
        path = tmp_path / "logs" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"")
    for pattern in ("logs", "logs/**"):
        found = {str(r.path.relative_to(tmp_path / "logs")): r.device for r in find([tmp_path / pattern])}
        assert found == {"a/1.log": "a", "a/s/2.blf": "a", "b/3.log.gz": "b", "c": "c"}
    assert [r.name for r in find([tmp_path / "logs"])] == ["1", "2", "3", "c"]
    (one,) = find([tmp_path / "logs/a/1.log"], device="mine")
    assert one.device == "mine"
