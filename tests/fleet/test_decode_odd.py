"""``gateway decode`` of odd databases and frames: what is right is decoded, the rest is told."""

import json

import pyarrow.parquet as pq
from car import HEAD
from typer.testing import CliRunner

from gateway.bus.frames import empty, put
from gateway.bus.logs import open_writer
from gateway.cli import app

MUX = 'BO_ 256 M: 8 A\n SG_ Mux M : 0|8@1+ (1,0) [0|0] "" B\n SG_ Always : 8|8@1+ (1,0) [0|0] "" B\n'


def decoded(folder, text, *payloads):
    """Decode frames of identifier 256; returns the rows of each message, and the notes."""
    (folder / "car.dbc").write_text(HEAD + text)
    frames = empty(len(payloads))
    for k, data in enumerate(payloads):
        put(frames, k, k, 256, bytes(data))
    with open_writer(folder / "drive.log") as writer:
        writer.write(frames)
    words = ("decode", folder / "drive.log", "-d", folder / "car.dbc", "-o", folder / "lake", "--json")
    ended = CliRunner().invoke(app, [str(word) for word in words])
    assert ended.exit_code == 0, ended.output
    found = {path.parts[-5]: pq.read_table(path) for path in (folder / "lake").rglob("*.parquet")}
    rows = {name: table.drop(["t"]).to_pylist() for name, table in found.items()}
    (event,) = [json.loads(line) for line in ended.output.splitlines() if line.startswith("{")]
    return rows, event["notes"]


def test_a_short_frame_is_a_row_of_what_is_in_it(tmp_path):
    text = 'BO_ 256 M: 8 A\n SG_ First : 0|16@1+ (1,0) [0|0] "" B\n SG_ Last : 48|16@1+ (1,0) [0|0] "" B\n'
    rows, notes = decoded(tmp_path, text, [1, 0, 0, 0, 0, 0, 4, 0], [1, 0, 2, 0], [1, 0, 2, 0, 3, 0])
    assert rows == {"M": [{"First": 1, "Last": 4}, {"First": 1, "Last": None}, {"First": 1, "Last": None}]}
    assert "2 frames of M are shorter than the database says, 4 to 6 bytes: not in them Last" in notes


def test_an_unknown_multiplexer_value_leaves_what_is_always_there(tmp_path):
    rows, notes = decoded(
        tmp_path,
        MUX + ' SG_ S0 m0 : 16|8@1+ (1,0) [0|0] "" B\n',
        [0, 17, 34, 0, 0, 0, 0, 0],
        [7, 20, 85, 0, 0, 0, 0, 0],
    )
    assert rows == {"M": [{"Mux": 0, "Always": 17, "S0": 34}, {"Mux": 7, "Always": 20, "S0": None}]}
    assert "1 frames of M have a multiplexer value that the database does not describe" in notes


def test_one_column_of_a_name_in_two_branches(tmp_path):
    branches = ' SG_ Temp m0 : 16|8@1+ (1,0) [0|0] "C" B\n SG_ Temp m1 : 24|8@1- (0.5,0) [0|0] "C" B\n'
    rows, notes = decoded(tmp_path, MUX + branches, [0, 0, 5, 0], [1, 0, 0, 255])
    assert rows == {"M": [{"Mux": 0, "Always": 0, "Temp": 5.0}, {"Mux": 1, "Always": 0, "Temp": -0.5}]}
    assert "M has signals of one name in several branches: Temp (Temp_m0 or Temp_m1)" in notes


def test_of_two_messages_of_one_identifier_one_is_decoded(tmp_path):
    text = 'BO_ 256 M1: 8 A\n SG_ S : 0|8@1+ (1,0) [0|0] "" B\nBO_ 256 M2: 8 A\n SG_ T : 8|8@1+ (1,0) [0|0] "" B\n'
    rows, notes = decoded(tmp_path, text, [1, 2])
    assert rows == {"M1": [{"S": 1}]}
    assert "M1 and M2 have the identifier 0x100: frames of it are decoded as M1" in notes


def test_a_signal_beyond_its_message_costs_itself(tmp_path):
    text = 'BO_ 256 M: 2 A\n SG_ Good : 0|8@1+ (1,0) [0|0] "" B\n SG_ Bad : 12|8@1+ (1,0) [0|0] "" B\n'
    rows, notes = decoded(tmp_path, text, [7, 0])
    assert rows == {"M": [{"Good": 7, "Bad": None}]}
    assert "M has 2 bytes; beyond them: Bad" in notes
