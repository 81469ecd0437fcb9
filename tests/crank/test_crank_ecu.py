"""Crank kinematics against closed forms; frames against cantools; captures against independent counts."""

from pathlib import Path

import cantools
import crccheck
import numpy as np
import pytest
from amount import examples
from hypothesis import given, settings
from hypothesis import strategies as st

from gateway.bus.frames import empty, payload
from gateway_bench.vecu.player import Player
from gateway_bench.vecu.scenario import Scenario, load_scenario
from gateway_bench.vecu.wire_faults import Wire
from gateway_fdi.common.resources import all_shipped, shipped
from gateway_fdi.errors import InputError, InputErrors
from gateway_plants.crank.ecu.capture import read_capture
from gateway_plants.crank.ecu.faults import added_pulses, missed_pulses
from gateway_plants.crank.ecu.kinematics import profile_angle, profile_time, tooth_times
from gateway_plants.crank.ecu.tooth_frames import tooth_frames
from gateway_plants.crank.wheel import Wheel

DBC = cantools.database.load_file(shipped("dbc/crank.dbc"))
W = Wheel.parse("60-2")
RNG = np.random.default_rng


def test_constant_speed():
    times = tooth_times(W, [(0, 1500)], 2.0, rng=RNG(1))
    assert len(times) == 50 * 58 + 1
    turn = times[58:] - times[:-58]
    assert (abs(turn - 40_000_000) <= 1000).all()
    gaps = np.diff(times)[57::58]
    assert (abs(gaps - 2_000_000) <= 1000).all()


def test_constant_acceleration_has_its_closed_form():
    times = tooth_times(W, [(0, 600), (4, 3000)], 4.0, rng=RNG(1)) / 1e9
    # theta = w0 t + a t^2 / 2, in pitches of 1/60 turn
    angle = (10 * times + 10 * times**2 / 2) * 60
    places = np.concatenate([np.array(W.positions) + 60 * k for k in range(121)])[: len(times)]
    np.testing.assert_allclose(angle, places, atol=0.004)


@given(
    st.lists(st.tuples(st.floats(0.1, 5), st.just(0.0) | st.floats(1e-3, 8000)), min_size=1, max_size=5),
    st.floats(0.01, 20),
)
def test_time_is_the_inverse_of_angle(steps, t):
    knots = np.concatenate([[0.0], np.cumsum([dt for dt, _ in steps])[:-1]])
    profile = [(float(k), rpm) for k, (_, rpm) in zip(knots, steps, strict=True)]
    angle = profile_angle(np.array([t]), profile)
    back = profile_time(angle, profile)
    np.testing.assert_allclose(profile_angle(back, profile), angle, rtol=1e-9, atol=1e-9)


def test_an_engine_at_rest_makes_no_teeth_and_starts():
    times = tooth_times(W, [(0, 0), (1, 0), (2, 600)], 3.0, rng=RNG(1))
    assert (times[1:] >= 10**9).all()
    assert len(times) > 100
    assert len(tooth_times(W, [(0, 0)], 3.0, rng=RNG(1))) <= 1


def test_ripple_modulates_the_speed_as_stated():
    times = tooth_times(W, [(0, 1500)], 1.0, ripple=[(2.0, 0.05, 0.0)], rng=RNG(1)) / 1e9
    speed = 1 / np.diff(times)
    speed = speed[np.arange(len(speed)) % 58 != 57] / 1500
    assert speed.max() / speed.min() == pytest.approx(1.05 / 0.95, rel=0.01)
    turn = times[58] - times[0]
    assert turn == pytest.approx(0.04, rel=1e-4)


def test_the_same_seed_gives_the_same_train():
    made = [tooth_times(W, [(0, 1500)], 1.0, jitter=0.01, tooth_error=0.01, rng=RNG(seed)) for seed in (5, 5, 6)]
    np.testing.assert_array_equal(made[0], made[1])
    assert len(made[0]) != len(made[2]) or (made[0] != made[2]).any()


def test_pulse_faults_are_what_they_say():
    times = tooth_times(W, [(0, 1500)], 1.0, rng=RNG(1))
    places, (truth,) = missed_pulses(times, 58, 500_000_000, 2, 20)
    assert (places % 58).tolist() == [20, 21]
    assert truth.t_ns == times[places[0]] >= 500_000_000
    added, (truth,) = added_pulses(times, 58, 500_000_000, 3, RNG(2), 57)
    at = int(np.searchsorted(times, added[0])) - 1
    assert at % 58 == 57
    assert ((added > times[at]) & (added < times[at + 1])).all()
    assert len(set(added.tolist())) == truth.count == 3
    places, truth = missed_pulses(times, 58, 10**12, 1)
    assert (len(places), truth) == (0, [])


def receive(frames):
    """Decode frames as a receiver would, with cantools; returns pulse times relative to the first."""
    t, out, counters, crcs = 0.0, [0.0], [], []
    for frame in frames:
        message = DBC.get_message_by_frame_id(int(frame["can_id"]))
        data = payload(frame)
        crc = crccheck.crc.Crc8SaeJ1850.calc(data[1:] + message.frame_id.to_bytes(2, "little"))
        crcs.append(crc == data[0])
        values = message.decode(data, decode_choices=False)
        if message.name == "CTW_PT4":
            counters.append(values["FrameCnt"])
            for k in range(4):
                code = int(values[f"Pt{k}"])
                if code:
                    t += (code & 0x3FF) << (2 * (code >> 10))
                    out.append(t)
        elif message.name == "CTW_FD27":
            counters.append(values["FrameCnt"])
            assert values["PulseCnt"] == (len(out) - 1) % 65536
            for k in range(int(values["NValid"])):
                t += values[f"Pt{k}"] * 2 ** values["Shift"]
                out.append(t)
        else:
            assert values["PulseCnt"] == (len(out) - 1) % 65536
    return np.array(out), counters, crcs


@pytest.mark.parametrize("form", ["classic", "fd"])
@pytest.mark.parametrize("rpm", [100, 300, 1500, 6000])
def test_frames_carry_the_train(form, rpm):
    times = tooth_times(W, [(0, rpm)], 3.0, jitter=0.01, rng=RNG(3))
    frames = tooth_frames(times, form)
    got, counters, crcs = receive(frames)
    expected = (times - times[0]) / 1e3
    assert len(got) == len(expected)
    assert np.abs(got - expected).max() <= (32.5 if form == "classic" else 20)
    assert counters == [k % 256 for k in range(len(counters))]
    assert all(crcs)
    assert (np.diff(frames["t_ns"]) >= 0).all()


def test_slow_teeth_leave_before_the_frame_is_full():
    times = np.arange(10) * 15_000_000
    frames = tooth_frames(times, "classic")
    assert (frames["t_ns"] - 0 < times[-1] + 40_000_000).all()
    got, _, _ = receive(frames)
    np.testing.assert_allclose(got, times / 1e3, atol=40)
    assert len(frames) > 4


@pytest.mark.parametrize("form", ["classic", "fd"])
def test_an_engine_that_stands_is_not_a_dead_ecu(form):
    """Frames at least every 100 ms, before the first tooth, in a stall, and after the last."""
    times = np.concatenate([np.arange(100) * 1_000_000 + 10**9, np.arange(50) * 1_000_000 + 2 * 10**9])
    frames = tooth_frames(times, form, span_ns=(0, 3 * 10**9))
    frames = frames[frames["can_id"] != 0x701]
    stamps = np.concatenate([[0], frames["t_ns"], [3 * 10**9]])
    assert np.diff(stamps).max() <= 101_000_000
    _got, counters, crcs = receive(frames)
    assert all(crcs)
    assert counters == [k % 256 for k in range(len(counters))]
    resting = tooth_frames(np.zeros(0, np.int64), form, span_ns=(0, 10**9))
    assert len(resting) == 9


def test_the_bus_load_is_that_of_the_layout():
    times = tooth_times(W, [(0, 6000)], 1.0, rng=RNG(3))
    assert len(tooth_frames(times, "classic")) == pytest.approx(5800 / 4 + 100, abs=3)
    assert len(tooth_frames(times, "fd")) == pytest.approx(5800 / 27, abs=2)


def scenario(**changes):
    return Scenario.model_validate(
        {
            "name": "s",
            "duration_s": 2.0,
            "ecu": [{"wheel": "60-2", "speed": [[0, 1500]], "jitter": 0.003}],
            **changes,
        }
    )


def test_the_player_is_deterministic_and_its_batches_are_its_frames():
    one = Player(scenario(), {"can": 0}, seed=3)
    two = Player(scenario(), {"can": 0}, seed=3)
    other = Player(scenario(), {"can": 0}, seed=4)
    np.testing.assert_array_equal(one.frames, two.frames)
    assert len(other.frames) != len(one.frames) or (other.frames != one.frames).any()
    parts = list(one.batches(7_000_000, start_ns=10**18))
    joined = np.concatenate([frames for _, frames in parts])
    joined["t_ns"] -= 10**18
    np.testing.assert_array_equal(joined, one.frames)
    for until, frames in parts:
        assert (frames["t_ns"] < until).all()


@pytest.mark.parametrize(
    ("fault", "check"),
    [
        ({"kind": "lost", "probability": 0.5}, lambda a, b: 0.4 < len(b) / len(a) < 0.6),
        ({"kind": "silent", "from_s": 1}, lambda a, b: (b["t_ns"] < 10**9).all() and len(b) > 300),
        ({"kind": "corrupted"}, lambda a, b: ((a["data"] != b["data"]).any(axis=1)).all()),
        ({"kind": "duplicated"}, lambda a, b: len(b) == 2 * len(a)),
        ({"kind": "short"}, lambda a, b: (b["length"] < 8).all()),
        (
            {"kind": "late", "message": "0x701"},
            lambda a, b: (np.sort(b["t_ns"]) == b["t_ns"]).all() and (a["t_ns"] != b["t_ns"]).any(),
        ),
    ],
)
def test_wire_faults_are_what_they_say(fault, check):
    made = scenario(wire=[fault])
    healthy = Player(scenario(), {"can": 0}, seed=1).frames
    wire = Wire(made.wire, RNG(1), {}, {})
    assert check(healthy, wire.apply(healthy, np.iinfo(np.int64).max))
    assert len(wire.truth) == 1


@pytest.mark.parametrize(
    ("text", "key"),
    [
        ('name = "s"\nduration_s = 1\n', "ecu"),
        (
            'name = "s"\nduration_s = 1\n[[ecu]]\nwheel = "361"\nspeed = [[0, 1]]\n',
            r"ecu\[0\]\.wheel",
        ),
        (
            'name = "s"\nduration_s = 1\n[[ecu]]\nwheel = "60-2"\nspeed = [[1, 1], [0, 2]]\n',
            r"ecu\[0\]",
        ),
        (
            'name = "s"\nduration_s = 1\nspeed = 3\n[[ecu]]\nwheel = "60-2"\nspeed = [[0, 1]]\n',
            "speed: unknown key",
        ),
        (
            'name = "s"\nduration_s = 1\n[[ecu]]\nwheel = "60-2"\nspeed = [[0, 1]]\n[[expect]]\ndtc = "Q1"\n',
            r"expect\[0\]\.dtc",
        ),
        (
            'name = "s"\nduration_s = 1\n[[ecu]]\nwheel = "60-2"\nspeed = [[0, 1]]\n'
            '[[fault]]\nkind = "missed_pulses"\nat_s = 1\necu = "x"\n',
            "no ECU 'x'",
        ),
    ],
)
def test_wrong_scenarios_name_the_key(tmp_path, text, key):
    path = tmp_path / "s.toml"
    path.write_text(text)
    with pytest.raises(InputErrors, match=key):
        load_scenario(path)


def test_every_shipped_scenario_loads():
    files = all_shipped("scenarios", ".toml")
    assert len(files) >= 10
    for file in files:
        assert load_scenario(file).config.exists()


@pytest.mark.parametrize(
    ("text", "channel", "falling"),
    [
        ("0.0,1\n0.1,0\n0.2,1\n0.3,0\n", "0", [0.1, 0.3]),
        ("time_s,level\n0,0\n8e-05,1\n0.5,0\n", "0", [0.5]),
        ("Time[s], Channel 0, Channel 1\n0, 1, 1\n1, 1, 0\n2, 0, 0\n3, 0, 1\n", "Channel 0", [2]),
        ("Time [s],crank,cam\n0,1,1\n1,1,0\n2,0,0\n3,0,1\n4,0,0\n", "cam", [1, 4]),
        ("0,1,1\n1,1,0\n", "1", [1]),
    ],
)
def test_captures_of_all_forms(tmp_path, text, channel, falling):
    path = tmp_path / "c.csv"
    path.write_text(text)
    got = read_capture(path, channel=channel, edge="falling")
    assert (got.times_ns / 1e9).tolist() == falling


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("", "holds no rows"),
        ("time,level\n", "holds no rows"),
        ("0,1\nx,0\n", r"c\.csv:2"),
        ("0,1\n1,7\n", r"c\.csv:2.*a level is 0 or 1"),
        ("0,1\n1,0\n0.5,1\n", r"c\.csv:3.*backwards"),
        ("0,1\n1\n", r"c\.csv:2"),
        ("0,1\nnan,0\n", r"c\.csv:2"),
    ],
)
def test_wrong_captures_name_the_line(tmp_path, text, match):
    path = tmp_path / "c.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=match):
        read_capture(path)


def test_wrong_channels_name_the_right_ones(tmp_path):
    path = tmp_path / "c.csv"
    path.write_text("t,crank,cam\n0,0,0\n")
    with pytest.raises(InputError, match="crank, cam or numbers 0 to 1"):
        read_capture(path, channel="2")
    path.write_bytes(b"\xff\xfe\x00\x01" * 50)
    with pytest.raises(InputError, match=r"c\.csv"):
        read_capture(path)
    with pytest.raises(InputError, match="No such file"):
        read_capture(Path(tmp_path / "none.csv"))


def test_too_few_teeth_make_no_frames():
    assert len(tooth_frames(np.array([5]), "classic")) == len(empty(0))


@settings(max_examples=examples(50))
@given(st.sampled_from(["60-2", "36-1", "36-2-1", "12+1", "29*1,3", "1,1,1,0.5,2.5"]))
def test_wheels_begin_behind_their_largest_gap(text):
    w = Wheel.parse(text)
    assert w.pitches[-1] == max(w.pitches)
    assert w.turn == pytest.approx(sum(w.pitches))
    assert str(w) == text


def test_the_gaps_of_36_2_1_lie_as_on_the_real_wheel():
    """16 teeth on pitch 1 after the gap of 3, then the gap of 2: as captured from a 4B11."""
    pitches = Wheel.parse("36-2-1").pitches
    assert (len(pitches), pitches.index(2.0)) == (33, 16)


def test_wheels_whose_gaps_do_not_lie_evenly_are_known_by_name():
    """Mitsubishi's, as open decoders have it: gaps of 20, 20 and 30 degrees behind 11, 11 and 10 teeth; Mazda's."""
    pitches = Wheel.parse("36-2-1-1").pitches
    assert [(k, p) for k, p in enumerate(pitches) if p > 1] == [(10, 2.0), (21, 2.0), (31, 3.0)]
    assert sum(pitches) == 36.0
    mazda = Wheel.parse("4-2")
    assert (mazda.pulses, mazda.repeats) == (4, 2)
    assert [90 * p for p in mazda.pitches] == pytest.approx([70, 110, 70, 110], abs=0.01)


@pytest.mark.parametrize("text", ["", "0", "361", "60-", "4-3", "x-1", "2-1", "300*1,2", "36-2-2-2-2", "1,1,-1"])
def test_wrong_wheels_are_refused(text):
    with pytest.raises(ValueError, match="wheel|teeth"):
        Wheel.parse(text)
