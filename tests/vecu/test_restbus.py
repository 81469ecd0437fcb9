"""A rest bus of others' databases: what was asked for is what cantools reads, and every protection is right."""

import functools
from pathlib import Path

import cantools
import numpy as np
import pytest

from gateway.bus.frames import EXTENDED, ID_MASK, payload
from gateway.config.load import load_config
from gateway.runtime.app import Gateway
from gateway.signals.bits import field_of, mask_of
from gateway_bench.cli.simulate import demo, simulate
from gateway_bench.vecu.player import Player
from gateway_bench.vecu.restbus.signals import start_value
from gateway_bench.vecu.scenario import load_scenario
from gateway_fdi.errors import GatewayError

SEED = 31
#: Database -> keys of the ECU, its nodes (None: all), courses of signals, messages with a checksum that are sent.
CARS = {
    "toyota_prius_2010_pt": (
        "cycle_ms = 20",
        None,
        {"WHEEL_SPEEDS.WHEEL_SPEED_FL": "[[0, 10], [2, 60]]", "SPEED.SPEED": '"WHEEL_SPEEDS.WHEEL_SPEED_FL / 2"'},
        10,
    ),
    "vw_mqb": (
        "cycle_ms = 50",
        {"Gateway_MQB", "Motor_Diesel_MQB", "XXX"},
        {"ESP_21.ESP_v_Signal": "{ sine = { mean = 80, amplitude = 30, period_s = 2 } }"},
        20,
    ),
    "ford_lincoln_base_pt": ("", {"PCM_HEV"}, {}, 0),
}
COURSES = {
    "WHEEL_SPEEDS.WHEEL_SPEED_FL": lambda t: np.interp(t, [0, 2], [10, 60]),
    "SPEED.SPEED": lambda t: np.interp(t, [0, 2], [10, 60]) / 2,
    "ESP_21.ESP_v_Signal": lambda t: 80 + 30 * np.sin(np.pi * t),
}
#: Its signals overlap so that cantools unpacks it never.
NOT_FOR_CANTOOLS = {"PLA_01"}


def database(name):
    return Path(pytest.importorskip("opendbc").DBC_PATH) / f"{name}.dbc"


@functools.cache
def oracle(name):
    return cantools.database.load_file(database(name), strict=False)


def protected(name):
    """Return the names of a car's messages with a checksum that are sent."""
    _, nodes, _, _ = CARS[name]
    return [
        m.name
        for m in oracle(name).messages
        if (nodes is None or set(m.senders) & nodes) and any(s.name == "CHECKSUM" for s in m.signals)
    ]


def write(folder, name, keys, courses, *, nodes=None, more="", checks=""):
    """Write a configuration and a scenario; returns the latter's path."""
    (folder / "gateway.toml").write_text(
        f'[clock]\nwatched = false\n[[bus]]\nname = "can"\nuri = "virtual:x"\ndatabase = ["{database(name)}"]\n'
        f'codes = "own"\nhealth = {{ watched = false }}\ncheck = [{checks}]\n[output.dtc_frame]\n'
    )
    signals = "".join(f'"{k}" = {v}\n' for k, v in courses.items())
    of = "" if nodes is None else f"nodes = {sorted(nodes)}\n"
    scenario = folder / "scenario.toml"
    scenario.write_text(
        f'name = "rest"\nduration_s = 2.0\nseed = {SEED}\nconfig = "gateway.toml"\n[[ecu]]\ntype = "restbus"\n'
        f"{of}{keys}\n[ecu.signals]\n{signals}\n{more}"
    )
    return scenario


def play(file):
    scenario = load_scenario(file)
    config = load_config(scenario.config)
    return config, Player(scenario, {"can": 0}, databases={0: config.bus[0].database})


def overlaps(message):
    """Return the signals that share bits with another one."""
    masks = {s.name: mask_of(field_of(s)) for s in message.signals if s.length <= 64}
    return {a for a in masks for b in masks if a != b and masks[a] & masks[b]}


@pytest.mark.parametrize("name", CARS)
def test_cantools_reads_what_was_asked_for(name, tmp_path):
    keys, nodes, courses, _ = CARS[name]
    _, player = play(write(tmp_path, name, keys, courses, nodes=nodes))
    count = {}
    shared = {m.name: overlaps(m) for m in oracle(name).messages}
    compared = 0
    for frame in player.frames:
        message = oracle(name).get_message_by_frame_id(int(frame["can_id"]) & ID_MASK)
        assert bool(frame["can_id"] & EXTENDED) == message.is_extended_frame
        count[message.name] = count.get(message.name, 0) + 1
        if message.name in NOT_FOR_CANTOOLS:
            continue
        values = message.decode(payload(frame), decode_choices=False, allow_truncated=False)
        for signal in message.signals:
            own = f"{message.name}.{signal.name}"
            if signal.name in values and own in courses:
                wanted = COURSES[own](frame["t_ns"] / 1e9)
            elif (
                signal.name not in values
                or signal.name in ("CHECKSUM", "COUNTER")
                or signal.is_multiplexer
                or signal.name in shared[message.name]
            ):
                continue
            else:
                wanted = start_value(signal)
            assert abs(values[signal.name] - wanted) <= abs(signal.scale) * 0.5001, own
            compared += 1
    assert compared > 1000
    chosen = [m for m in oracle(name).messages if nodes is None or set(m.senders) & nodes]
    cycles = {m.name: m.cycle_time or float(keys.rpartition("=")[2] or 0) for m in chosen}
    wanted = {name: 2000 / cycle for name, cycle in cycles.items() if cycle}
    assert count.keys() == wanted.keys()
    assert all(abs(count[name] - wanted[name]) <= 1 for name in wanted)


@pytest.mark.parametrize("name", [name for name, car in CARS.items() if car[3]])
def test_every_protected_message_passes_its_check(name, tmp_path):
    keys, nodes, courses, least = CARS[name]
    names = protected(name)
    assert len(names) >= least
    checks = ", ".join(f'{{ message = "{m}", timeout_ms = 300, protection = "auto" }}' for m in names)
    config, player = play(write(tmp_path, name, keys, courses, nodes=nodes, checks=checks))
    assert run(config, player.frames) == set()
    # A check that sees nothing would pass, too: one bit wrong from 1 s on is seen in each message.
    wrong = player.frames.copy()
    wrong["data"][wrong["t_ns"] > 1_000_000_000, 2] ^= 0x10
    assert run(config, wrong) == {f"can.{name}.crc" for name in names}


def run(config, frames):
    """Return the faults that a gateway finds in frames."""
    gateway, events = Gateway(config), []
    gateway.listen(events.append)
    gateway.start(0)
    gateway.feed(frames)
    gateway.advance(2_000_000_000)
    return {event["fault"] for event in events if event["event"] == "dtc" and event["status"] & 1}


def test_simulate_and_demo_play_it(tmp_path, capsys, monkeypatch):
    keys, _, courses, _ = CARS["vw_mqb"]
    keys += '\nmessages = ["ESP_21", "LWI_01"]'
    checks = '{ message = "ESP_21", timeout_ms = 300, protection = "auto" }'
    fault = '[[fault]]\nkind = "checksum"\nmessage = "ESP_21"\nfrom_s = 1\n'
    file = write(tmp_path, "vw_mqb", keys, courses, checks=checks, more=fault)
    asked = {"bus": "inside", "check": True, "wait": 1, "record": None, "seed": None, "json": False}
    assert simulate(file, **asked) == 1
    assert "NOT as expected: U0402-83 set at 1." in capsys.readouterr().out
    file.write_text(file.read_text() + '[[expect]]\ndtc = "U0402-83"\nafter_s = 1\nby_s = 1.5\n')
    assert simulate(file, **asked) == 0
    monkeypatch.chdir(tmp_path)
    assert demo(Path(file.name), speed=0, seed=None, json=False) == 0
    said = capsys.readouterr().out
    assert "INJECTED: ESP_21: checksum is wrong" in said
    assert "1 fault injected, 1 DTC set: all as expected" in said
    assert max(map(len, said.splitlines())) <= 80


DBC = """VERSION ""
BU_: A B
BO_ 256 Motion: 8 A
 SG_ Counter : 0|4@1+ (1,0) [0|15] "" B
 SG_ Speed : 8|16@1- (0.01,0) [0|300] "km/h" B
 SG_ Gear : 24|3@1+ (1,0) [0|5] "" B
BO_ 257 Half: 16 A
 SG_ Speed : 7|32@0+ (1,0) [0|0] "km/h" B
 SG_ Twice : 39|64@0- (1,0) [0|0] "km/h" B
BO_ 258 Pages: 8 B
 SG_ Page M : 0|8@1+ (1,0) [0|9] "" A
 SG_ One m1 : 8|8@1+ (1,0) [0|0] "" A
 SG_ Two m2 : 8|16@1- (0.5,-10) [0|0] "" A
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 10000;
BA_DEF_ SG_ "GenSigStartValue" FLOAT 0 100000;
BA_DEF_DEF_ "GenMsgCycleTime" 0;
BA_DEF_DEF_ "GenSigStartValue" 0;
BA_ "GenMsgCycleTime" BO_ 256 10;
BA_ "GenMsgCycleTime" BO_ 257 20;
BA_ "GenSigStartValue" SG_ 258 Two 36;
VAL_ 256 Gear 0 "Park" 4 "Drive";
SIG_VALTYPE_ 257 Speed : 1;
SIG_VALTYPE_ 257 Twice : 2;
"""


def small(folder, ecu, more=""):
    """Return the path of a scenario of a small database of nodes A and B."""
    (folder / "small.dbc").write_text(DBC)
    (folder / "gateway.toml").write_text('[[bus]]\nname = "can"\nuri = "virtual:x"\ndatabase = ["small.dbc"]\n')
    file = folder / "scenario.toml"
    file.write_text(
        f'name = "s"\nduration_s = 4.0\nseed = {SEED}\nconfig = "gateway.toml"\n'
        f'[[ecu]]\ntype = "restbus"\n{ecu}\n{more}'
    )
    return file


def decoded(folder, ecu, more=""):
    """Return message -> its frames' times [s] and values, by cantools."""
    _, player = play(small(folder, ecu, more))
    known = cantools.database.load_string(DBC, strict=False)
    found = {}
    for frame in player.frames:
        message = known.get_message_by_frame_id(int(frame["can_id"]))
        values = message.decode(payload(frame), decode_choices=False)
        found.setdefault(message.name, []).append((frame["t_ns"] / 1e9, values))
    return found, player.truth


def column(found, message, signal):
    pairs = [(t, values[signal]) for t, values in found[message] if signal in values]
    return np.array([t for t, _ in pairs]), np.array([v for _, v in pairs])


SPEED = '[ecu.signals]\n"Motion.Speed" = '
FORMS = {
    "12.34": lambda t: np.full(len(t), 12.34),
    "[[0, 0], [2, 100]]": lambda t: np.interp(t, [0, 2], [0, 100]),
    "{ points = [[1, 5], [2, 10]] }": lambda t: np.interp(t, [1, 2], [5, 10]),
    "{ steps = [[0, 1], [1.0001, 2], [3.0001, 7]] }": lambda t: np.where(t < 1.0001, 1, np.where(t < 3.0001, 2, 7)),
    "{ ramp = { start = 10, end = 30, in_s = 2, at_s = 1 } }": lambda t: np.interp(t, [1, 3], [10, 30]),
    "{ sine = { mean = 50, amplitude = 20, period_s = 3, phase_deg = 90 } }": lambda t: (
        50 + 20 * np.cos(2 * np.pi * t / 3)
    ),
    '{ csv = { file = "drive.csv", value = "v" } }': lambda t: np.interp(t, [0, 1, 2.5], [0, 40, 10]),
    '{ csv = { file = "drive.csv", value = "v", hold = true } }': lambda t: np.where(
        t < 1, 0, np.where(t < 2.5, 40, 10)
    ),
    '{ csv = { file = "drive.csv", value = "v", repeat = true } }': lambda t: np.interp(
        t % 2.5, [0, 1, 2.5], [0, 40, 10]
    ),
}


@pytest.mark.parametrize("form", FORMS)
def test_courses(form, tmp_path):
    (tmp_path / "drive.csv").write_text("time,other,v\n0,1,0\n1,1,40\n2.5,1,10\n")
    found, _ = decoded(tmp_path, f'[ecu.signals]\n"Motion.Speed" = {form}')
    t, v = column(found, "Motion", "Speed")
    assert len(t) >= 399
    assert np.diff(t) == pytest.approx(0.01)
    assert np.abs(v - FORMS[form](t)).max() <= 0.0051


def test_expression_text_turns_floats_and_start_values(tmp_path):
    courses = (
        '[ecu.signals]\n"Motion.Speed" = { sine = { mean = 100, amplitude = 50, period_s = 2 } }\n'
        '"Half.Speed" = "Motion.Speed / 2"\n"Half.Twice" = "2 * Half.Speed"\n"Motion.Gear" = { text = "Drive" }\n'
        '"Motion.Counter" = { turns = [3, 1, 2] }\n'
    )
    found, _ = decoded(tmp_path, f"cycle_ms = 100\n{courses}")
    t, half = column(found, "Half", "Speed")
    wanted = 100 + 50 * np.sin(np.pi * t)
    assert half == pytest.approx(wanted / 2, rel=1e-6)
    assert column(found, "Half", "Twice")[1] == pytest.approx(wanted, rel=1e-9)
    assert set(column(found, "Motion", "Gear")[1]) == {4}
    assert column(found, "Motion", "Counter")[1][:6].tolist() == [3, 1, 2, 3, 1, 2]
    assert column(found, "Pages", "Page")[1][:5].tolist() == [1, 2, 1, 2, 1]  # a multiplexer turns by itself
    assert set(column(found, "Pages", "Two")[1]) == {8.0}  # raw 36 at its start
    _, held = column(decoded(tmp_path, 'cycle_ms = 50\n[ecu.signals]\n"Pages.Page" = 2')[0], "Pages", "Page")
    assert set(held) == {2}


def test_a_course_by_a_recorded_log(tmp_path):
    """What a rest bus sent, recorded by python-can, is the course of another one, with another cycle."""
    import can

    recorded, _ = decoded(tmp_path, SPEED + "{ points = [[0, 5], [2, 105]] }")
    times, values = column(recorded, "Motion", "Speed")
    known = cantools.database.load_string(DBC, strict=False).get_message_by_name("Motion")
    with can.ASCWriter(tmp_path / "drive.asc") as writer:
        for t, value in zip(times, values, strict=True):
            data = known.encode({"Counter": 0, "Speed": value, "Gear": 0})
            writer(can.Message(timestamp=1e9 + t, arbitration_id=256, is_extended_id=False, data=data, channel=0))
    t0 = times[0]
    for keys, wanted in (
        ("", lambda t: 5 + 50 * (t + t0)),
        (", from_s = 1.0, hold = false", lambda t: 5 + 50 * (t + t0 + 1)),
        (", repeat = true", lambda t: 5 + 50 * (t % (times[-1] - t0) + t0)),
    ):
        course = f'{{ log = {{ file = "drive.asc", signal = "Motion.Speed"{keys} }} }}'
        found, _ = decoded(tmp_path, f'cycle_ms = 7\n[ecu.signals]\n"Half.Speed" = {course}')
        t, v = column(found, "Half", "Speed")
        assert np.abs(v - np.minimum(wanted(t), 105)).max() < 0.52, keys  # what lies between two frames of the log
    with pytest.raises(GatewayError, match="log.signal = 'Pages.One': no frame of the log"):
        decoded(tmp_path, SPEED + '{ log = { file = "drive.asc", signal = "Pages.One" } }')
    with pytest.raises(GatewayError, match=r"Motion\.Speed.*log\.file = 'no\.asc': there is no such file"):
        decoded(tmp_path, SPEED + '{ log = { file = "no.asc" } }')


def test_noise_is_of_the_seed(tmp_path):
    ecu = '[ecu.signals]\n"Motion.Speed" = { value = 50, noise = 2 }'
    one, two = (column(decoded(tmp_path, ecu)[0], "Motion", "Speed")[1] for _ in range(2))
    assert (one == two).all()
    assert 1.7 < one.std() < 2.3


WRONG = {
    'nodes = ["a"]': ("ecu[0].nodes[0] = 'a'", "did you mean A?"),
    'messages = ["Motoin"]': ("ecu[0].messages[0] = 'Motoin'", "did you mean Motion?"),
    'messages = ["Pages"]': ("ecu[0].messages = 'Pages'", "give period_ms, or cycle_ms"),
    'nodes = ["B"]': ("ecu[0].cycle_ms", "none of 1 messages has a cycle time"),
    '[[ecu.message]]\nname = "Hlaf"': ("ecu[0].message[0].name = 'Hlaf'", "did you mean Half?"),
    '[[ecu.message]]\nname = "Half"\ncounter = { signal = "C" }': ("message[0].counter.signal = 'C'", "no such signal"),
    '[ecu.signals]\n"Motion.Sped" = 1': ("Motion.Sped", "did you mean Speed?"),
    SPEED + '400': ('ecu[0].signals."Motion.Speed" = 400.0', "it can carry -327.68 to 327.67"),
    SPEED + '"Half.Sped"': ('ecu[0].signals."Motion.Speed"', "did you mean Speed?"),
    SPEED + '"Half.Speed"\n"Half.Speed" = "Motion.Speed"': ("signals", "in a circle"),
    SPEED + '"Motion.Gear + "': ('ecu[0].signals."Motion.Speed"', "no expression"),
    '[ecu.signals]\n"Motion.Gear" = { text = "drive" }': ('"Motion.Gear".text = \'drive\'', "did you mean Drive?"),
    SPEED + '{ sinus = 3 }': ("sinus", "did you mean sine"),
    SPEED + '{ value = 3, steps = [[0, 1]] }': ("Motion.Speed", "a signal has one course"),
    SPEED + '[[1, 3], [0, 4]]': ("ecu[0]", "must rise"),
    SPEED + '{ csv = { file = "no.csv", value = "v" } }': ("csv.file = 'no.csv'", "no such file"),
    SPEED + '{ csv = { file = "bad.csv", value = "V" } }': ("csv.value = 'V'", "did you mean v?"),
    SPEED + '{ csv = { file = "bad.csv", value = "v" } }': ("bad.csv:3", "two numbers"),
    '[[fault]]\nkind = "stuck"\nsignal = "Motion.Sped"\nfrom_s = 1': ("fault[0].signal = 'Motion.Sped'", "mean Speed?"),
    '[[fault]]\nkind = "offset"\nsignal = "Motion.Speed"\nfrom_s = 1': ("fault[0]", "offset wants a size"),
    '[[fault]]\nkind = "lost"\nsignal = "Motion.Speed"\nfrom_s = 1': ("fault[0]", "lost is a fault of a message"),
    '[[fault]]\nkind = "checksum"\nmessage = "Motion"\nfrom_s = 1': ("fault[0].message = 'Motion'", "has no checksum"),
    '[[fault]]\nkind = "out_of_range"\nsignal = "Half.Speed"\nfrom_s = 1': ("'Half.Speed'", "give a size"),
}  # fmt: skip


@pytest.mark.parametrize("wrong", WRONG)
def test_mistakes_are_told_in_one_line(wrong, tmp_path):
    (tmp_path / "bad.csv").write_text("time,v\n0,1\n1,x\n")
    with pytest.raises(GatewayError) as told:
        play_named(small(tmp_path, wrong))
    line = str(told.value)
    assert all(part in line for part in WRONG[wrong]), line
    assert len(line.splitlines()) == 1
    assert "scenario.toml" in line or "bad.csv" in line


def play_named(file):
    """Play a scenario as the commands do, that name its file."""
    asked = {"bus": "inside", "check": False, "wait": 1, "record": None, "seed": None, "json": False}
    simulate(file, **asked)
