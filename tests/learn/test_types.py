"""Signals of every type are learned from and watched: the values are those that the engine decodes."""

import math
import random

import cantools
import numpy as np
import pytest
from learning import asked, drive, quiet

from gateway.bus.logs import LogReader
from gateway.config.load import load_config
from gateway.runtime.assemble import prepare
from gateway_bench.wire.replay import through
from gateway_fleet.learn.learn import learn, write
from gateway_fleet.learn.lines import SIGNAL
from gateway_replay.channels import channels_of
from gateway_replay.injection import Injector, parse_injection

SEED, SECONDS, PERIOD = 66, 60.0, 0.02
#: Type -> place and scaling in DBC, kind of SIG_VALTYPE_, middle, half of the span, a value far beyond.
TYPES = {
    "Half": ("7|16@0- (1,0)", 1, 20.0, 5.0, 6e4),
    "HalfLittle": ("0|16@1- (1,0)", 1, 20.0, 5.0, -6e4),
    "Single": ("0|32@1- (1,0)", 1, 20.0, 5.0, 1e6),
    "SingleBig": ("7|32@0- (1,0)", 1, 380.0, 15.0, 0.0),
    "SingleScaled": ("7|32@0- (0.5,-40)", 1, 80.0, 10.0, 600.0),
    "Double": ("0|64@1- (1,0)", 2, 1013.0, 30.0, 5.0),
    "DoubleBig": ("7|64@0- (0.001,0)", 2, -3.0, 2.0, 1e9),
    "Unsigned": ("8|12@1+ (0.5,-100)", 0, 400.0, 230.0, 1900.0),
    "Signed": ("0|16@1- (0.1,0)", 0, -1500.0, 700.0, 3270.0),
    "SignedBig": ("3|12@0- (1,10)", 0, -900.0, 430.0, 2050.0),
}
#: Of a message with a multiplexer: those of branch 1 and of branch 2.
BRANCHES = {
    "BranchSingle": ("16|32@1- (1,0)", 1, 20.0, 5.0, 4e3),
    "BranchSigned": ("23|16@0- (0.1,0)", 0, -1500.0, 700.0, 3e3),
}
ALL = {**TYPES, **BRANCHES}
#: First frame of a fault, and how long it is [s].
LEAD, LONG = 4.0, 3.0


def database_text():
    text, kinds = 'VERSION ""\nNS_ :\nBS_:\nBU_: A\n', ""
    for k, (name, (place, kind, *_)) in enumerate(TYPES.items()):
        text += f'BO_ {256 + k} M{name}: 8 A\n SG_ {name} : {place} [0|0] "" A\n'
        kinds += f"SIG_VALTYPE_ {256 + k} {name} : {kind};\n" if kind else ""
    text += 'BO_ 512 Branches: 8 A\n SG_ Which M : 0|8@1+ (1,0) [0|0] "" A\n'
    for branch, (name, (place, kind, *_)) in enumerate(BRANCHES.items()):
        text += f' SG_ {name} m{branch + 1} : {place} [0|0] "" A\n'
        kinds += f"SIG_VALTYPE_ 512 {name} : {kind};\n" if kind else ""
    return text + kinds


def full(name):
    return f"{'Branches' if name in BRANCHES else 'M' + name}.{name}"


def healthy(database, seed):
    """Return messages for ``drive``: each signal swings, and no value equals the one before."""
    rng = random.Random(seed)

    def value(name, k):
        middle, half = ALL[name][2:4]
        return middle + half * (
            0.93 * math.sin((1.5 + 0.11 * list(ALL).index(name)) * k * PERIOD) + 0.07 * rng.random()
        )

    def branch(k):
        name = list(BRANCHES)[k % 2]
        return database.encode_message(512, {"Which": k % 2 + 1, name: value(name, k // 2)}, strict=False)

    def alone(can_id, name):
        return lambda k: database.encode_message(can_id, {name: value(name, k)}, strict=False)

    each = [(256 + k, PERIOD, alone(256 + k, name), 1e-3 * k) for k, name in enumerate(TYPES)]
    return [*each, (512, PERIOD, branch, 0.015)]


@pytest.fixture(scope="module")
def car(tmp_path_factory):
    """A configuration learned of all types, and what was learned."""
    folder = tmp_path_factory.mktemp("types")
    (folder / "car.dbc").write_text(database_text())
    database = cantools.database.load_file(folder / "car.dbc")
    print("seed", SEED)
    log = drive(folder / "drive.log", SECONDS, healthy(database, SEED))
    result = learn(asked(folder / "car.toml", log, databases=(folder / "car.dbc",)), quiet)
    write(result.files(folder / "car.toml"))
    return folder / "car.toml", database, result


def alarms(file, log, kind, value):
    """Return (seconds, fault) of each fault that is set with a fault put into each signal, one after the other."""
    config = load_config(file)
    parts = prepare(config)
    (frames,) = LogReader(log, channels_of(config, ()))
    for k, name in enumerate(ALL):
        text = f"{kind} {full(name)}{value(name)} @{LEAD * (k + 1)}..{LEAD * (k + 1) + LONG}"
        asked_for = parse_injection(text, [config.bus[0].name], parts.databases)
        rng = np.random.default_rng(SEED)
        injector = Injector(asked_for, parts.databases, parts.checks, rng, int(frames["t_ns"][0]), [])
        frames = injector.apply(frames)
        assert injector.count >= (LONG - 0.1) / PERIOD / (2 if name in BRANCHES else 1)
    return [(t - 1000.0, fault) for t, fault, failed in through(config, [frames]).dtcs if failed]


@pytest.mark.long
def test_every_type_is_learned_with_its_physical_values(car):
    _, _, result = car
    assert result.alarms == (), "silent on what was held out, too"
    lines = {place[2]: line.keys for place, line in result.learned.lines.items() if place[1] == SIGNAL}
    assert set(lines) == {full(name) for name in ALL}
    for name, (_, _, middle, half, _) in ALL.items():
        keys = lines[full(name)]
        low, high = keys["plausible"]
        assert middle - 8 * half < low < middle - half < middle + half < high < middle + 8 * half, (name, keys)
        if name in TYPES:
            inside = keys["stuck"]["inside"]
            assert middle - 1.1 * half < inside[0] < middle < inside[1] < middle + 1.1 * half, (name, keys)


@pytest.mark.long
@pytest.mark.parametrize(
    ("kind", "value", "found", "names"),
    [
        ("value", lambda name: f"={ALL[name][4]}", (".high", ".low"), list(ALL)),
        ("stuck", lambda name: "", (".stuck",), list(TYPES)),
    ],
)
def test_a_fault_of_a_signal_of_every_type_is_found(car, tmp_path, kind, value, found, names):
    file, database, _ = car
    log = drive(tmp_path / "fresh.log", SECONDS, healthy(database, SEED + 1))
    set_ = alarms(file, log, kind, value)
    for k, name in enumerate(ALL):
        mine = [fault for t, fault in set_ if LEAD * (k + 1) < t < LEAD * (k + 1) + LONG + 0.5]
        named = [fault for fault in mine if fault.startswith(f"{name}.") and fault.endswith(found)]
        assert bool(named) == (name in names), (name, mine)
    assert not any(fault.startswith("can0.") for _, fault in set_), "no frame of it is accused"
