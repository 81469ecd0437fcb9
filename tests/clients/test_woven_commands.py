"""Messages of several frames in logs: gateway decode, replay and learn have them as any message."""

import json
import math
import random

import numpy as np
import pyarrow.parquet as pq
import pytest
from command import command
from long_messages import batch, fast, transported

from gateway.bus.candump import CandumpWriter
from gateway.bus.frames import EXTENDED
from gateway.bus.traffic import Seen
from gateway_serve.messages import MessageNames

DBC = """VERSION ""
BU_: A
BO_ 2566841342 Long: 120 A
 SG_ Near : 0|16@1+ (0.1,0) [0|6553.5] "V" A
 SG_ Far : 816|16@1+ (0.1,0) [0|6553.5] "V" A

BO_ 2583168510 Fast: 43 A
 SG_ Angle : 327|16@0- (0.01,0) [-327|327] "deg" A

BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","reserved","J1939PG";
BA_DEF_DEF_ "VFrameFormat" "StandardCAN";
BA_ "VFrameFormat" BO_ 2566841342 3;
BA_ "VFrameFormat" BO_ 2583168510 3;
"""

BEGIN_S = 1.7e9
CONFIG = """[[bus]]
name = "can0"
uri = "virtual:can0"
database = ["long.dbc"]

check = [{ message = "Long", timeout_ms = 3000.0 }]

[[monitor]]
name = "volts"
type = "signal"
signal = [{ signal = "Long.Far", plausible = [1.0, 400.0] }]
"""


def volts(k):
    return 100.0 + round(50 * random.Random(k // 4).random(), 1)


def drive(tmp_path, seconds, *, wrong_s=math.inf, lost_s=math.inf):
    """Write a log: a broadcast each second, and a fast packet ten times a second; returns what they say."""
    streams, far, angles = [], [], []
    for k in range(seconds):
        value = 500.0 if k >= wrong_s else volts(k)
        data = bytearray(random.Random(k).randbytes(120))
        data[:2], data[102:104] = (k % 100).to_bytes(2, "little"), round(value * 10).to_bytes(2, "little")
        said = transported(0xFEE3, 0x21, 0xFF, bytes(data), BEGIN_S + k)
        streams.append([*said[:3], *said[4:]] if k == lost_s else said)
        far += [value] if k != lost_s else []
    for k in range(10 * seconds):
        angle = round(100 * math.sin(k / 20), 2)
        data = bytes(40) + round(angle * 100).to_bytes(2, "big", signed=True) + b"\0"
        streams.append(fast(0x1F805, 0x35, 0xFF, data, k, BEGIN_S + 0.1 * k + 0.0004))
        angles.append(angle)
    (tmp_path / "long.dbc").write_text(DBC)
    frames = batch(*streams)
    with (tmp_path / "drive.log").open("wb") as file:
        CandumpWriter(file, {0: "can0"}).write(frames)
    return frames, far, angles


@pytest.fixture
def run(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "gateway.toml").write_text(CONFIG)
    return lambda *arguments: command(capsys, monkeypatch, *arguments)


def column(folder, message, name):
    (file,) = folder.rglob(f"{message}/**/*.parquet")
    return pq.read_table(file)[name].to_pylist()


def test_a_log_becomes_tables(tmp_path, run):
    frames, far, angles = drive(tmp_path, 12, lost_s=5)
    ended = run("decode", "drive.log", "--out", "lake", "--database", "long.dbc", "--json")
    assert ended.code == 0, ended.err
    told = json.loads(ended.out)
    assert column(tmp_path / "lake", "Long", "Far") == pytest.approx(far)
    assert set(column(tmp_path / "lake", "Long", "sa")) == {0x21}
    assert column(tmp_path / "lake", "Fast", "Angle") == pytest.approx(angles)
    assert (told["frames"], told["rows"], told["foreign"]) == (len(frames), 11 + 120, 0)
    assert "131 messages of several frames put together, 1 lost not whole" in told["notes"]


@pytest.mark.parametrize("lost_s", [math.inf, 10])
def test_a_replay_tests_them(lost_s, run, tmp_path):
    drive(tmp_path, 30, wrong_s=20, lost_s=lost_s)
    ended = run("replay", "drive.log", "-c", "gateway.toml", "--json")
    assert ended.code == 0, ended.err
    set_ = {e["fault"]: e["t_ns"] / 1e9 - BEGIN_S for e in ended.events if e["event"] == "dtc" and e["status"] & 1}
    assert set(set_) == {"volts.Far.high"}
    assert 20 < set_["volts.Far.high"] < 25
    counters = ended.event("summary")["counters"]
    assert (counters["long_whole"], counters["long_lost"]) == ((30, 0) if lost_s > 30 else (29, 1))
    assert counters["long_parts"] == ended.event("log")["frames"] - 7 * 300, "those of the fast packets are not wanted"


@pytest.mark.long
def test_they_are_learned_from(run, tmp_path):
    drive(tmp_path, 90)
    ended = run("learn", "long.dbc", "drive.log", "-o", "car.toml")
    assert ended.code == 0, ended.err
    text = (tmp_path / "car.toml").read_text()
    assert 'message = "Long"' in text
    assert 'message = "Fast"' in text
    assert "known = []" in text, "what carries parts of messages is no stranger"
    assert not (tmp_path / "car.learned.can0.dbc").exists(), "parts of messages are no unknown ones"


def test_the_page_shows_no_values_of_a_part(tmp_path):
    """A frame of a fast packet has a name, and none of the message's signals."""
    (tmp_path / "long.dbc").write_text(DBC.replace("327|16@0-", "7|16@0-"))
    names = MessageNames([{"name": "can0", "database": [str(tmp_path / "long.dbc")]}])
    row = np.zeros(1, Seen.dtype)
    row["can_id"], row["length"] = EXTENDED | 0x19F805FE, 8
    (shown,) = names.shown(row.tobytes(), 0)
    assert (shown["name"], shown["signals"]) == ("Fast", [])


def test_no_protection_is_read_in_more_than_a_frame(tmp_path, run):
    drive(tmp_path, 1)
    (tmp_path / "gateway.toml").write_text(CONFIG.replace("3000.0 }", '3000.0, counter = { signal = "Near" } }'))
    ended = run("check", "gateway.toml")
    assert ended.code == 2
    assert "Long has 120 bytes: beyond 64 neither counter nor checksum is read" in ended.err
