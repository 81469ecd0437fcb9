"""Faults put into recorded frames: what cantools decodes of them, and what their protection says."""

import random

import cantools
import numpy as np
import pytest
from amount import amount

from gateway.bus.frames import empty, payload, put
from gateway.engine.checks.communication import CheckInstance
from gateway.engine.checks.message import Params
from gateway.signals.database import load_database
from gateway_fdi.errors import InputError
from gateway_replay.injection import FRAME_KINDS, SIGNAL_KINDS, Injection, Injector, parse_injection

DBC = (
    'VERSION ""\nNS_ :\nBS_:\nBU_: A\n'
    "BO_ 256 Car: 8 A\n"
    ' SG_ CHECKSUM : 0|8@1+ (1,0) [0|255] "" A\n SG_ COUNTER : 8|4@1+ (1,0) [0|15] "" A\n'
    ' SG_ Speed : 12|13@1+ (0.1,-50) [0|0] "km/h" A\n SG_ Angle : 39|14@0- (0.5,0) [0|0] "deg" A\n'
    "BO_ 512 Ratio: 8 A\n"
    ' SG_ Value : 0|32@1- (1,0) [0|0] "" A\n SG_ Mux M : 32|2@1+ (1,0) [0|3] "" A\n'
    ' SG_ Part m1 : 40|8@1+ (1,0) [0|0] "" A\n'
    "SIG_VALTYPE_ 512 Value : 1;\n"
)
CRC = {"crc": {"signal": "CHECKSUM", "algorithm": "crc8_autosar"}, "counter": {"signal": "COUNTER"}}


@pytest.fixture(scope="module")
def car(tmp_path_factory):
    file = tmp_path_factory.mktemp("car") / "car.dbc"
    file.write_text(DBC)
    return load_database([file]), cantools.database.load_file(file)


def frames_of(rng, count=200):
    made = empty(2 * count)
    for k in range(count):
        put(made, 2 * k, k * 10_000_000, 0x100, rng.randbytes(8))
        put(
            made,
            2 * k + 1,
            k * 10_000_000 + 5_000_000,
            0x200,
            np.float32(rng.uniform(-9, 9)).tobytes() + bytes([k % 4, 7, 0, 0]),
        )
    return made


def changed(car, injection, frames, checks=()):
    """Return the frames with a fault in them, put in by batches of any size."""
    injector = Injector(injection, [car[0]], checks, np.random.default_rng(1))
    out, at, rng = [], 0, random.Random(2)
    while at < len(frames):
        size = rng.randint(1, 40)
        out.append(injector.apply(frames[at : at + size]))
        at += size
    return np.concatenate(out), injector


def mine(frames, can_id=0x100):
    return frames[frames["can_id"] == can_id]


@pytest.mark.parametrize("signal", ["Speed", "Angle"])
@pytest.mark.parametrize("kind", SIGNAL_KINDS)
def test_a_fault_of_a_signal_changes_it_alone_and_leaves_the_protection_right(car, kind, signal):
    """Beside cantools: only this signal differs, by what was asked, only while it was asked; the CRC fits."""
    checks = [CheckInstance(Params.model_validate({"message": "Car", **CRC}), 0, "b.Car")]
    twin = car[1].get_message_by_name("Car")
    for seed in range(amount(20, 4)):
        frames = frames_of(random.Random(seed))
        value = 12.5
        out, injector = changed(car, Injection(kind, 0, "Car", signal, value, 0.5, 1.5), frames, checks)
        assert len(out) == len(frames)
        assert injector.count == 100
        held, turn = None, 1
        from gateway.signals.protection.params import protection_for
        from gateway_fleet.learn.protection_check import Payloads, judged

        for before, after in zip(mine(frames), mine(out), strict=True):
            was, now = (twin.decode(payload(frame), decode_choices=False) for frame in (before, after))
            t = before["t_ns"] * 1e-9
            if not 0.5 <= t < 1.5:
                assert payload(before) == payload(after), f"seed {seed}"
                held = was[signal]
                continue
            turn = -turn
            wanted = {
                "stuck": held,
                "offset": was[signal] + value,
                "scale": was[signal] * value,
                "value": value,
                "jump": was[signal] + turn * value,
                "drift": was[signal] + (t - 0.5) * value,
            }[kind]
            low, high = (-50, 769.1) if signal == "Speed" else (-4096, 4095.5)
            assert now[signal] == pytest.approx(min(max(wanted, low), high), abs=0.26), f"seed {seed}"
            for other in was:
                assert other in (signal, "CHECKSUM") or now[other] == was[other], f"seed {seed}: {other}"
        hit = mine(out)[50:150]
        words = np.ascontiguousarray(hit["data"]).view("<u8").reshape(len(hit), 8)
        asked = protection_for(car[0].message("Car"), checks[0].params)
        assert judged(Payloads(words, hit["length"].astype(np.int64)), asked).good.all(), f"seed {seed}"


@pytest.mark.parametrize("kind", FRAME_KINDS)
def test_a_fault_of_the_frame(car, kind):
    frames = frames_of(random.Random(3))
    out, injector = changed(car, Injection(kind, 0, "Car", None, 0.0, 0.5, 1.5), frames)
    assert injector.count == 100
    before = [payload(frame) for frame in mine(frames)]
    assert [payload(f) for f in mine(out, 0x200)] == [payload(f) for f in mine(frames, 0x200)]
    if kind == "drop":
        assert [payload(f) for f in mine(out)] == before[:50] + before[150:]
        return
    after = [payload(frame) for frame in mine(out)]
    assert after[:50] == before[:50]
    assert after[150:] == before[150:]
    for k in range(50, 150):
        if kind == "freeze":
            assert after[k] == before[49]
        elif kind == "repeat":
            assert after[k] == (before[k - 1] if (k - 50) % 2 == 0 else before[k])
        else:
            difference = int.from_bytes(after[k], "big") ^ int.from_bytes(before[k], "big")
            assert difference.bit_count() == 1


def test_floating_point_and_multiplexed_signals(car):
    frames = frames_of(random.Random(4))
    out, _ = changed(car, Injection("value", 0, "Ratio", "Value", 2.75), frames)
    values = [np.frombuffer(payload(frame)[:4], "<f4")[0] for frame in mine(out, 0x200)]
    assert set(values[1::4]) == {2.75}
    out, _ = changed(car, Injection("offset", 0, "Ratio", "Part", 5.0), frames)
    for before, after in zip(mine(frames, 0x200), mine(out, 0x200), strict=True):
        carries = payload(before)[4] % 4 == 1
        assert payload(after)[5] == (12 if carries else 7)
        assert payload(after)[:5] + payload(after)[6:] == payload(before)[:5] + payload(before)[6:]


@pytest.mark.parametrize(
    ("text", "kind", "target", "value", "times"),
    [
        ("drop Car", "drop", ("Car", None), 0.0, (0.0, None)),
        ("drop b.Car @2", "drop", ("Car", None), 0.0, (2.0, None)),
        ("offset Car.Speed=-4.5 @10..12.5", "offset", ("Car", "Speed"), -4.5, (10.0, 12.5)),
        ("  value  b.Car.Speed = 7  @ 1 .. 3", "value", ("Car", "Speed"), 7.0, (1.0, 3.0)),
    ],
)
def test_texts(car, text, kind, target, value, times):
    found = parse_injection(text, ["b"], [car[0]])
    assert (found.kind, (found.message, found.signal), found.value) == (kind, target, value)
    assert (found.from_s, found.to_s) == times


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("", "KIND MESSAGE"),
        ("dorp Car", "did you mean drop"),
        ("drop Cra", "did you mean Car"),
        ("offset Car.Sped=3", "did you mean Speed"),
        ("offset Car.Speed", "wants a value"),
        ("stuck Car.Speed=3", "has no value"),
        ("stuck Car", "Message.Signal"),
        ("drop Car.Speed", "whole message"),
        ("drop Car @5..4", "ends before it begins"),
        ("value Car.Speed=much", "no number"),
    ],
)
def test_what_is_no_fault_is_one_clear_line(car, text, word):
    with pytest.raises(InputError) as told:
        parse_injection(text, ["b"], [car[0]])
    assert told.value.key == "--inject"
    assert told.value.value == text
    assert word in str(told.value)


@pytest.mark.parametrize("kind", ["double", "replay", "fuzz"])
def test_frames_of_another_sender_come_beside_those_of_the_message(car, kind):
    """In order of time, by batches of any size, none of the others changed."""
    frames = frames_of(random.Random(5))
    out, injector = changed(car, Injection(kind, 0, "Car", None, 0.3, 0.5, 1.5), frames)
    assert injector.count == 100
    assert (np.diff(out["t_ns"]) >= 0).all()
    assert len(out) == len(frames) + 100
    assert [payload(f) for f in mine(out, 0x200)] == [payload(f) for f in mine(frames, 0x200)]
    theirs = np.isin(mine(out)["t_ns"], frames["t_ns"], invert=True)
    added = mine(out)[theirs]
    assert [payload(f) for f in mine(out)[~theirs]] == [payload(f) for f in mine(frames)]
    before = [payload(frame) for frame in mine(frames)]
    if kind == "double":
        assert [payload(f) for f in added] == before[50:150]
    elif kind == "replay":
        assert [payload(f) for f in added] == before[20:120]
    else:
        assert len({payload(f) for f in added} - set(before)) == 100


def test_a_forged_frame_has_one_signal_changed_and_its_protection_right(car):
    from gateway.signals.protection.params import protection_for
    from gateway_fleet.learn.protection_check import Payloads, judged

    checks = [CheckInstance(Params.model_validate({"message": "Car", **CRC}), 0, "b.Car")]
    frames = frames_of(random.Random(6))
    out, _ = changed(car, Injection("forge", 0, "Car", "Speed", -20.0, 0.5, 1.5), frames, checks)
    added = mine(out)[np.isin(mine(out)["t_ns"], frames["t_ns"], invert=True)]
    twin = car[1].get_message_by_name("Car")
    was = [twin.decode(payload(f), decode_choices=False) for f in mine(frames)[50:150]]
    now = [twin.decode(payload(f), decode_choices=False) for f in added]
    wanted = [max(each["Speed"] - 20.0, -50.0) for each in was]
    assert [each["Speed"] for each in now] == pytest.approx(wanted, abs=0.06)
    words = np.ascontiguousarray(added["data"]).view("<u8").reshape(len(added), 8)
    asked = protection_for(car[0].message("Car"), checks[0].params)
    assert judged(Payloads(words, added["length"].astype(np.int64)), asked).good.all()


def test_an_unknown_identifier_comes_at_its_rate(car):
    frames = frames_of(random.Random(7))
    asked = parse_injection("unknown 0x3A1=50 @0.5..1.5", ["b"], [car[0]])
    out, injector = changed(car, asked, frames)
    assert injector.count == len(mine(out, 0x3A1)) == 50
    assert (np.diff(mine(out, 0x3A1)["t_ns"]) == 20_000_000).all()
    for wrong in ("unknown SPEED", "unknown 0x3A1=0", "unknown 0x3A1=-3", "unknown 0xFFFFFFFFF", "forge Car=3"):
        with pytest.raises(InputError):
            parse_injection(wrong, ["b"], [car[0]])
