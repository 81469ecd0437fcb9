"""From a database and a drive to a configuration: silent on what it did not see, and not blind."""

import json
import lzma
import os
import random
import subprocess
import sys
import tomllib
from pathlib import Path

import can
import numpy as np
import pytest
from cantools.database import load_file
from command import command
from learning import as_before, asked, drive, quiet

from gateway.config.load import load_config
from gateway.runtime.app import Gateway
from gateway_fdi.errors import InputError, InputErrors
from gateway_fleet.learn.learn import learn, write
from gateway_fleet.learn.lines import CHECK, RULE, SIGNAL
from gateway_fleet.learn.report import markdown

ROOT = Path(__file__).parents[2]
DRIVE = ROOT / "examples/car/drive.log.xz"


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    """What half of the shipped drive teaches."""
    out = tmp_path_factory.mktemp("learn") / "car.toml"
    result = learn(asked(out, DRIVE, hold_out=0.5), quiet)
    write(result.files(out))
    return out, result


@pytest.mark.evidence("Healthy parts: learned")
def test_half_a_drive_is_learned_and_the_other_half_is_silent(found):
    _, result = found
    assert result.alarms == ()
    assert result.held_frames > 25_000
    named = sum(outcome.named for outcome in result.outcomes)
    assert len(result.outcomes) >= 50
    assert named >= 0.6 * len(result.outcomes), "offsets are as large as the signals' own spread, not as their limits"
    kinds = {outcome.trial.injection.kind for outcome in result.outcomes}
    assert kinds >= {"drop", "flip", "freeze", "repeat", "offset", "stuck"}
    sees = {each.name: each for each in result.trials.seeing}
    speed = sees["can0.SPEED.SPEED"]
    assert (speed.up.size, speed.down.size) <= (10.0, 10.0), "ten km/h are seen"
    assert speed.up.named == speed.down.named == speed.up.moments >= 2, "the car drives at each moment"
    assert sees["can0.SPEED.SPEED"].stuck_s < 6.0
    assert "can0.BODY_CONTROL_STATE_2.UNITS" not in result.trials.unwatched, "it never moves"
    assert not set(result.trials.unwatched) & set(sees)


def test_the_configuration_is_one_line_each_and_what_gateway_check_takes(found):
    out, result = found
    config = load_config(out)
    Gateway(config, file=out).close()
    lines = result.learned.lines.values()
    text = out.read_text()
    for line in lines:
        (mine,) = [each for each in text.splitlines() if each == line.text()]
        assert "  # " in mine, "its evidence"
    checks = {line.name: line.keys for line in lines if line.table == CHECK}
    for name in ("SPEED", "GAS_PEDAL", "PCM_CRUISE", "STEER_TORQUE_SENSOR"):
        assert checks[name]["checksum"] == {"rule": "toyota", "signal": "CHECKSUM"}
    for name in ("KINEMATICS", "STEER_ANGLE_SENSOR", "ENGINE_RPM"):
        assert checks[name]["checksum"] == {"rule": "toyota", "signal": "byte 7"}, "the database does not know it"
    for name in ("WHEEL_SPEEDS", "BRAKE_MODULE"):
        assert not {"checksum", "crc", "e2e"} & set(checks[name]), "they have none"
    assert 30 <= checks["WHEEL_SPEEDS"]["timeout_ms"] <= 120
    relations = [line.keys["holds"] for line in lines if line.table == RULE]
    assert any("WHEEL_SPEEDS.WHEEL_SPEED_FL" in text and "SPEED.SPEED" in text for text in relations)
    notes = "\n".join(result.learned.notes)
    assert "ID_2D5" in notes, "in no database"
    assert checks["ID_2D5"]["timeout_ms"] > 0
    assert "ACC_CONTROL" in notes, "never came"
    assert "GEAR_PACKET.GEAR (1 of 5)" in notes, "one gear says nothing of values without a text"
    assert "counter" not in checks["ID_63B"], "a time: it goes up by five"


def test_every_line_of_the_shipped_drive_is_that_of_before(found):
    """A limit, an evidence, a note, a trial that changes is seen here, and is meant or not."""
    out, result = found
    as_before("car.toml", out.read_text(), out.parent)
    as_before("car.md", markdown(asked(out, DRIVE, hold_out=0.5), result), out.parent)


@pytest.mark.evidence("Healthy parts: stranger car")
def test_a_healthy_stranger_of_the_same_car_is_not_accused(found):
    """Limits leave room for what the drive did not show: full throttle, standstill, a steering wheel at its stop."""
    out, _ = found
    table = tomllib.loads(out.read_text())
    signals = {line["signal"]: line for monitor in table["monitor"] for line in monitor.get("signal", [])}
    for name, low, high in (
        ("GAS_PEDAL.GAS_PEDAL", 0, 100),
        ("SPEED.SPEED", 0, 200),
        ("WHEEL_SPEEDS.WHEEL_SPEED_FL", 0, 200),
        ("STEER_ANGLE_SENSOR.STEER_ANGLE", -540, 540),
    ):
        least, most = signals.get(name, {}).get("plausible", [-1e9, 1e9])
        assert least <= low, name
        assert high <= most, name
    assert signals["SPEED.SPEED"]["gradient"] > 60, "km/h/s: more than any brake"


DBC = (
    'VERSION ""\nNS_ :\nBS_:\nBU_: A\n'
    "BO_ 256 Alive: 8 A\n"
    ' SG_ Count : 0|4@1+ (1,0) [0|15] "" A\n SG_ Level : 8|16@1+ (0.1,0) [0|5000] "kPa" A\n'
    ' SG_ State : 24|4@1+ (1,0) [0|15] "" A\n'
    "BO_ 512 Twin: 8 A\n"
    ' SG_ Level2 : 0|16@1+ (0.01,-10) [0|0] "bar" A\n SG_ Rest : 16|8@1+ (1,0) [0|100] "" A\n'
    "BO_ 768 Event: 2 A\n"
    ' SG_ Button : 0|1@1+ (1,0) [0|1] "" A\n'
    'VAL_ 256 State 0 "off" 1 "on" 2 "test" 15 "SNA" ;\n'
)


def plant(rng, seconds=60.0):
    """Return messages: a counter of 15 values, a pressure in two units, states, and one that comes when it likes."""
    level = [2000 + 1500 * np.sin(k / 150) for k in range(int(seconds * 100) + 1)]

    def alive(k):
        raw = round(level[k] / 0.1) + rng.randint(-2, 2)
        return bytes([k % 15, raw & 0xFF, raw >> 8, (k // 300) % 3, 0, 0, 0, 0])

    def twin(k):
        raw = round((level[2 * k] / 100 + 10) / 0.01)
        return bytes([raw & 0xFF, raw >> 8, 50, 0, 0, 0, 0, 0])

    return [(256, 0.01, alive, 0.0), (512, 0.02, twin, 0.003)]


def made(tmp_path, seed=1, **more):
    (tmp_path / "car.dbc").write_text(DBC)
    rng = random.Random(seed)
    log = drive(tmp_path / "drive.log", 60.0, plant(rng), rng)
    result = learn(asked(tmp_path / "car.toml", log, databases=(tmp_path / "car.dbc",), **more), quiet)
    return log, result


def test_counters_with_a_modulus_relations_over_units_and_states(tmp_path):
    _, result = made(tmp_path)
    (text, *_) = result.files(tmp_path / "car.toml").values()
    as_before("made.toml", text, tmp_path)
    lines = {place[1:]: line.keys for place, line in result.learned.lines.items()}
    assert lines[CHECK, "Alive"]["counter"] == {"signal": "Count", "modulus": 15}
    assert result.alarms == ()
    assert lines[SIGNAL, "Alive.State"]["undefined"] is True
    assert lines[SIGNAL, "Alive.State"]["invalid"] == "auto"
    (relation,) = [keys for (table, _), keys in lines.items() if table == RULE]
    assert "number(" in relation["holds"], "kPa and bar: said, not mixed in silence"
    assert "stuck" not in lines.get((SIGNAL, "Twin.Rest"), {}), "it never moves"
    named = {(o.trial.injection.kind, o.trial.injection.signal): o.named for o in result.outcomes}
    assert all(named[kind, None] for kind in ("freeze", "repeat", "drop"))
    assert named["value", "State"]
    assert named["offset", "Level"]
    assert named["offset", "Level2"]


def test_what_alarms_in_what_was_held_out_is_widened_and_said(tmp_path):
    """The last third is slower than the first: the timeout of the first does not fit it."""
    (tmp_path / "car.dbc").write_text(DBC)
    rng = random.Random(3)
    first, second = plant(rng), plant(rng)
    late = [(can_id, period * 12, payload, 40.05 + offset) for can_id, period, payload, offset in second]
    log = drive(tmp_path / "drive.log", 40.0, first)
    late_log = drive(tmp_path / "late.log", 20.0, late)
    log.write_bytes(log.read_bytes() + late_log.read_bytes())
    result = learn(asked(tmp_path / "car.toml", log, databases=(tmp_path / "car.dbc",), hold_out=0.04), quiet)
    assert any("timeout alarmed in what was held out" in change for change in result.changes)
    assert result.alarms == ()
    (line,) = [line for place, line in result.learned.lines.items() if place[1:] == (CHECK, "Alive")]
    assert line.keys["timeout_ms"] > 120
    assert "alarmed" in line.why


def test_a_message_that_ends_before_the_log_has_no_timeout(tmp_path):
    (tmp_path / "car.dbc").write_text(DBC)
    rng = random.Random(5)
    messages = plant(rng)
    whole = drive(tmp_path / "a.log", 60.0, messages[:1])
    part = drive(tmp_path / "b.log", 20.0, messages[1:])
    lines = sorted(whole.read_text().splitlines() + part.read_text().splitlines())
    (tmp_path / "drive.log").write_text("\n".join(lines) + "\n")
    result = learn(asked(tmp_path / "car.toml", tmp_path / "drive.log", databases=(tmp_path / "car.dbc",)), quiet)
    keys = {place[2]: line for place, line in result.learned.lines.items() if place[1] == CHECK}
    assert "timeout_ms" in keys["Alive"].keys
    assert "timeout_ms" not in keys["Twin"].keys
    assert "before the log" in keys["Twin"].why


def gateway(*arguments, cwd):
    return subprocess.run(
        [sys.executable, "-m", "gateway", *map(str, arguments)],
        capture_output=True,
        check=False,
        text=True,
        cwd=cwd,
        timeout=300,
    )


@pytest.fixture
def run(tmp_path, monkeypatch, capsys):
    """Return a function that runs ``gateway`` in this process, in this test's folder."""
    monkeypatch.chdir(tmp_path)
    return lambda *arguments: command(capsys, monkeypatch, *arguments)


@pytest.mark.long
def test_the_command_learns_updates_and_keeps_a_person_s_lines(tmp_path):
    """One process each, as people do it: learn, edit, another drive."""
    log, _ = made(tmp_path)
    said = gateway("learn", "car.dbc", log, "-o", "car.toml", cwd=tmp_path)
    assert said.returncode == 0, said.stderr
    assert "silent on all" in said.stdout
    assert "reading drive.log" in said.stderr, "a line in a pipe, too"
    out = tmp_path / "car.toml"
    first = out.read_text()
    assert (tmp_path / "car.md").read_text().startswith("# Learned")
    again = gateway("learn", "car.dbc", log, "-o", "car.toml", cwd=tmp_path)
    assert again.returncode == 2
    assert "--update" in again.stderr
    lines = first.splitlines()
    (alive,) = [k for k, line in enumerate(lines) if 'message = "Alive"' in line]
    (state,) = [k for k, line in enumerate(lines) if '"Alive.State"' in line]
    lines[alive] = '    { message = "Alive", timeout_ms = 77.0 },  # mine'
    del lines[state]
    lines.insert(alive + 1, '    { message = "Event" },  # mine, too')
    edited = "\n".join(lines) + '\n# a remark\n[output.dtc_frame]\nbus = "can0"\n'
    out.write_text(edited)
    rng = random.Random(9)
    second = drive(tmp_path / "second.log", 60.0, plant(rng), rng)
    said = gateway("learn", "--update", second, "-o", "car.toml", cwd=tmp_path)
    assert said.returncode == 0, said.stderr
    assert "kept: 3 lines" in said.stdout, said.stdout
    now = out.read_text()
    assert lines[alive] in now
    assert lines[alive + 1] in now
    assert '"Alive.State"' not in now, "taken out by hand: it stays out"
    assert "# a remark" in now
    assert "[output.dtc_frame]" in now
    (twin,) = [line for line in now.splitlines() if 'message = "Twin"' in line]
    (before,) = [line for line in first.splitlines() if 'message = "Twin"' in line]
    assert twin != before, "the frames of both drives"
    assert gateway("check", "car.toml", cwd=tmp_path).returncode == 0
    data = json.loads(gateway("learn", "--update", second, "-o", "car.toml", "--json", cwd=tmp_path).stdout)
    assert data["kept"] == 3
    assert data["alarms"] == []


@pytest.mark.long
def test_two_buses_are_learned_together(tmp_path, run):
    (tmp_path / "car.dbc").write_text(DBC)
    rng = random.Random(2)
    one = drive(tmp_path / "one.log", 30.0, plant(rng, 30.0), rng).read_text()
    two = drive(tmp_path / "two.log", 30.0, plant(rng, 30.0)[:1], rng).read_text().replace(" can0 ", " can1 ")
    stamped = sorted((one + two).splitlines())
    (tmp_path / "drive.log").write_text("\n".join(stamped) + "\n")
    said = run("learn", "drive.log", "--bus", "drive=car.dbc", "--bus", "body=car.dbc", "-o", "x.toml")
    assert said.code == 0, said.err
    config = load_config(tmp_path / "x.toml")
    assert [(bus.name, len(bus.check)) for bus in config.bus] == [("drive", 2), ("body", 1)]
    assert run("check", "x.toml").code == 0


def test_other_people_s_logs_and_databases(tmp_path):
    """BLF by python-can, an extended identifier, KCD: read as the rest of the gateway reads them."""
    (tmp_path / "car.dbc").write_text(DBC.replace("BO_ 256 ", f"BO_ {0x80000000 | 0x18FF0100} ").split("VAL_")[0])
    log = tmp_path / "drive.blf"
    rng = random.Random(4)
    alive = plant(rng)[0][2]
    with can.Logger(log) as writer:
        for k in range(3000):
            writer.on_message_received(
                can.Message(timestamp=1e9 + k * 0.01, arbitration_id=0x18FF0100, is_extended_id=True, data=alive(k))
            )
    assert load_file(tmp_path / "car.dbc").messages[0].is_extended_frame
    result = learn(asked(tmp_path / "car.toml", log, databases=(tmp_path / "car.dbc",)), quiet)
    (line,) = [line for place, line in result.learned.lines.items() if place[1] == CHECK]
    assert line.keys["counter"]["modulus"] == 15


@pytest.mark.long
def test_messages_by_pgn(tmp_path, run):
    """Frames of another source address than the database's are the same message."""
    (tmp_path / "car.dbc").write_text(DBC.replace("BO_ 256 ", f"BO_ {0x80000000 | 0x18FF0100} ").split("VAL_")[0])
    alive = plant(random.Random(4))[0][2]
    with can.Logger(tmp_path / "drive.asc") as writer:
        for k in range(3000):
            frame = can.Message(timestamp=k * 0.01, arbitration_id=0x18FF0142, is_extended_id=True, data=alive(k))
            writer.on_message_received(frame)
    said = run("learn", "car.dbc", "drive.asc", "-o", "x.toml", "--pgn")
    assert said.code == 0, said.err
    config = load_config(tmp_path / "x.toml")
    assert config.bus[0].match == "pgn"
    assert config.bus[0].check[0].counter.modulus == 15
    assert run("learn", "car.dbc", "drive.asc", "-o", "y.toml").code == 2


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["nowhere.dbc", "drive.log"], ["nowhere.dbc", "no such file"]),
        (["car.dbc"], ["name a log"]),
        (["empty.log"], ["empty.log", "no frame"]),
        (["car.dbc", "empty.log"], ["empty.log", "no frame"]),
        (["car.dbc", "foreign.log"], ["foreign.log", "no frame of this log is one of", "car.dbc", "0x7A1"]),
        (["bad.dbc", "drive.log"], ["bad.dbc", "not a good .dbc file"]),
        (["car.dbc", "drive.log", "--bus", "x=car.dbc"], ["--bus"]),
        (["drive.log", "--bus", "x="], ["--bus", "NAME[=DATABASE"]),
        (["car.dbc", "cut.log"], ["cut.log"]),
        (["--update", "drive.log", "-o", "mine.toml"], ["mine.toml"]),
        (["--update", "drive.log", "-o", "hand.toml"], ["hand.learned.json", "not there"]),
    ],
)
def test_what_cannot_be_learned_is_one_clear_line(arguments, words, tmp_path, run):
    (tmp_path / "car.dbc").write_text(DBC)
    (tmp_path / "bad.dbc").write_text("BO_ what")
    rng = random.Random(1)
    log = drive(tmp_path / "drive.log", 5.0, plant(rng, 5.0))
    (tmp_path / "empty.log").write_text("")
    (tmp_path / "foreign.log").write_text("(1.0) can0 7A1#00\n(2.0) can0 7A1#01\n")
    (tmp_path / "cut.log").write_text(log.read_text()[:-7])
    (tmp_path / "hand.toml").write_text('[[bus]]\nname = "can0"\nuri = "virtual:x"\ndatabase = ["car.dbc"]\n')
    said = run("learn", *arguments)
    assert said.code == 2, said.out
    lines = [line for line in said.err.splitlines() if line.startswith("error")]
    assert len(lines) == 1, said.err
    for word in words:
        assert word in lines[0]
    assert not (tmp_path / "car.toml").exists()


def test_two_senders_of_one_identifier_are_told(tmp_path):
    (tmp_path / "car.dbc").write_text(DBC)
    other = [(512, 0.02, lambda k: bytes([k & 0xFF, 1, 50, 0, 0, 0, 0, 0]), 0.004)]
    first = (512, 0.02, lambda k: bytes([k & 0xFF, 2, 50, 0, 0, 0, 0, 0]), 0.0)
    log = drive(tmp_path / "drive.log", 30.0, [*plant(random.Random(1), 30.0)[:1], first, *other])
    result = learn(asked(tmp_path / "car.toml", log, databases=(tmp_path / "car.dbc",)), quiet)
    assert any("two senders" in note and "Twin" in note for note in result.learned.notes)


def test_stamps_that_jump_back_are_evened(tmp_path):
    """The clock of the recorder was set: what lies between is no gap, and nothing is lost."""
    (tmp_path / "car.dbc").write_text(DBC)
    rng = random.Random(6)
    log = drive(tmp_path / "drive.log", 30.0, plant(rng, 30.0))
    lines = log.read_text().splitlines()
    half = len(lines) // 2
    moved = [f"({float(line[1:].split(')')[0]) - 500:.6f}){line.split(')', 1)[1]}" for line in lines[half:]]
    log.write_text("\n".join(lines[:half] + moved) + "\n")
    result = learn(asked(tmp_path / "car.toml", log, databases=(tmp_path / "car.dbc",)), quiet)
    (keys,) = [line.keys for place, line in result.learned.lines.items() if place[1:] == (CHECK, "Alive")]
    assert keys["timeout_ms"] < 200
    assert result.alarms == ()
    assert result.conditions == ("gateway.clock_stepped",)


@pytest.mark.long
def test_a_log_that_cannot_be_read_to_its_end_teaches_nothing(tmp_path):
    log = tmp_path / "drive.log.xz"
    log.write_bytes(lzma.compress(lzma.decompress(DRIVE.read_bytes())[:-13]))
    with pytest.raises((InputError, InputErrors)):
        learn(asked(tmp_path / "car.toml", log), quiet)


def test_a_log_of_another_car_is_told(tmp_path):
    """Sixty identifiers, and a database of eight messages that shares one of them by chance."""
    (tmp_path / "car.dbc").write_text(
        'VERSION ""\nBS_:\nBU_: A\n'
        + "".join(f'BO_ {256 + 3 * k} M{k}: 8 A\n SG_ X{k} : 0|8@1+ (1,0) [0|255] "" A\n' for k in range(8))
    )
    ids = [256, *range(900, 1900, 17)]
    log = drive(
        tmp_path / "drive.log",
        20.0,
        [(can_id, 0.1, lambda k: bytes([k % 50, 0, 0, 0, 0, 0, 0, 0]), 0.0) for can_id in ids],
    )
    result = learn(asked(tmp_path / "car.toml", log, databases=(tmp_path / "car.dbc",), hold_out=0.0), quiet)
    assert any("DOES NOT LOOK" in note for note in result.learned.notes)
    mine = drive(
        tmp_path / "mine.log",
        20.0,
        [(256 + 3 * k, 0.1, lambda k: bytes([k % 50, 0, 0, 0, 0, 0, 0, 0]), 0.0) for k in range(6)],
    )
    result = learn(asked(tmp_path / "car.toml", mine, databases=(tmp_path / "car.dbc",), hold_out=0.0), quiet)
    assert not any("DOES NOT LOOK" in note for note in result.learned.notes)


def test_a_checksum_that_its_frames_cannot_tell_is_its_neighbours_or_none(tmp_path, capsys, monkeypatch):
    """Of two buses one has a message that proves the maker's rule; on the other it is told that none is claimed."""
    (tmp_path / "idle.dbc").write_text(
        'VERSION ""\nBS_:\nBU_: A\nBO_ 644 Brake: 6 A\n SG_ CHECKSUM : 0|8@1+ (1,0) [0|255] "" A\n'
        ' SG_ COUNTER : 12|4@1+ (1,0) [0|15] "" A\nBO_ 700 Engine: 8 A\n SG_ CHECKSUM : 0|8@1+ (1,0) [0|255] "" A\n'
    )
    rng = np.random.default_rng(3)
    with can.Logger(tmp_path / "idle.log") as log:
        for k in range(500):
            for channel in ("can0", "can1"):
                moves = rng.integers(0, 256, 7).tolist() if channel == "can1" else []
                for can_id, rest in ((644, [k % 16 << 4, 0, 0, 0, 0]), (700, moves)):
                    data = bytes([int(np.bitwise_xor.reduce(rest)), *rest]) if rest else bytes(8)
                    log(can.Message(0.02 * k, can_id, is_extended_id=False, data=data, channel=channel))
    buses = [part for bus in ("can0", "can1") for part in ("--bus", f"{bus}={tmp_path / 'idle.dbc'}")]
    arguments = [str(tmp_path / "idle.log"), *buses, "-o", str(tmp_path / "idle.toml")]
    ended = command(capsys, monkeypatch, "learn", *arguments)
    assert ended.code == 0
    alone, beside = tomllib.loads((tmp_path / "idle.toml").read_text())["bus"]
    assert "checksum" not in next(line for line in alone["check"] if line["message"] == "Brake")
    rules = {line["message"]: line["checksum"]["rule"] for line in beside["check"]}
    assert rules == {"Brake": "volkswagen_pq", "Engine": "volkswagen_pq"}
    assert "can0.Brake: no checksum: its 16 different frames fit hyundai_6b, " in ended.out
    assert "can1.Brake" not in ended.out


def test_what_is_no_file_is_not_replaced_by_one(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(InputError, match="pipe: -o: is there, and no file"):
        write({tmp_path / "car.dbc": "", tmp_path / "pipe": ""})
    assert (tmp_path / "pipe").is_fifo()
    assert list(tmp_path.iterdir()) == [tmp_path / "pipe"]
