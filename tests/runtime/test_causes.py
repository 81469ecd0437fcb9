"""Diagnoses of a gateway: one cause where one thing is wrong, none where nothing is, and the same however it is fed."""

import itertools
import json
import random

import numpy as np
import pytest
from car import Car, write

from gateway.common.times import NEVER
from gateway.config.load import load_config
from gateway.engine.events import EVENT, QUALIFIED_FAILED, QUALIFIED_PASSED
from gateway.runtime.app import Gateway
from gateway.runtime.assemble import prepare
from gateway_bench.scenario_session import player_of
from gateway_bench.vecu.scenario import load_scenario
from gateway_causes.causes import Causes
from gateway_fdi.common.resources import shipped
from gateway_fleet.cli.learn import learn_car
from gateway_replay.cli.replay import replay
from gateway_replay.injection import Injector, parse_injection


def frames_of(name, seconds, *injected):
    scenario = load_scenario(shipped(f"scenarios/{name}.toml"))
    config = load_config(scenario.config)
    short = scenario.model_copy(update={"duration_s": min(scenario.duration_s, seconds)})
    frames, parts = player_of(short, config).frames, prepare(config)
    for k, text in enumerate(injected):
        asked = parse_injection(text, [bus.name for bus in config.bus], parts.databases)
        frames = Injector(asked, parts.databases, parts.checks, np.random.default_rng([1, k])).apply(frames)
    return config, frames


def played(config, frames, pieces=None, until_s=None):
    """Return the events of a run, fed in pieces; then time passes."""
    gateway = Gateway(config)
    events = []
    gateway.listen(events.append)
    gateway.start(0)
    for piece in pieces or [frames]:
        gateway.feed(piece)
    end = int(frames["t_ns"][-1]) if until_s is None else round(until_s * 1e9)
    gateway.advance(end)
    gateway.stop(end)
    gateway.close()
    return events


def diagnoses(events):
    return [event for event in events if event["event"] == "diagnosis"]


def silent_from(frames, seconds):
    return frames[frames["t_ns"] < seconds * 1e9]


def test_a_bus_that_falls_silent_is_one_cause():
    config, frames = frames_of("signals_faults", 4.9)
    told = diagnoses(played(config, silent_from(frames, 3.0), until_s=60.0))
    assert len(told) == 1
    (group,) = told[0]["groups"]
    assert group["failed"] == ["chassis.bus_silent"]
    assert group["cause"] == ["bus chassis"]
    assert 3.0 < told[0]["t_ns"] / 1e9 < 3.5


def test_one_message_of_an_ecu_that_is_heard_is_not_its_ecu():
    """Body sends two messages, one of which goes on: neither Body nor the bus is silent."""
    config, frames = frames_of("signals_faults", 4.9, "drop WheelSpeeds @2")
    last = diagnoses(played(config, frames))[-1]
    (group,) = last["groups"]
    names = [one["components"] for one in group["causes"]]
    assert names[:2] == [["ecu chassis.Brakes"], ["message chassis.WheelSpeeds"]]
    assert group["cause"] is None  # Brakes sends nothing else
    assert group["waits_for"] == []
    assert not any("bus chassis" in one for one in names[:2])


def test_while_a_slower_test_can_speak_nothing_is_certain():
    """A checksum is wrong: is it the message, or does its sender die?"""
    config, frames = frames_of("restbus", 15.5)
    first, second = diagnoses([e for e in played(config, frames) if e["t_ns"] > 14e9])[:2]
    (before,), (after,) = first["groups"], second["groups"]
    assert before["cause"] is None
    assert [one["test"] for one in before["waits_for"]] == ["chassis.Vehicle.timeout"]
    assert after["cause"] == ["message chassis.Vehicle"]
    assert after["waits_for"] == []
    assert second["t_ns"] - first["t_ns"] >= before["waits_for"][0]["for_s"] * 1e9 > 0.0


@pytest.mark.evidence("Healthy parts: two faults")
def test_two_faults_that_no_test_of_one_explains_are_named_together():
    """A plant's monitor knows single faults only: by its tests, brake's resistance and force's sensor are wrong."""
    scenario = load_scenario(shipped("scenarios/brake_faults.toml"))
    config = load_config(scenario.config)
    faults = [fault for fault in scenario.fault if fault.name in ("f_R", "f_F")]
    both = tuple(fault.model_copy(update={"from_s": 20.0, "to_s": None}) for fault in faults)
    short = scenario.model_copy(update={"duration_s": 50.0, "fault": both, "expect": ()})
    last = diagnoses(played(config, player_of(short, config).frames))[-1]
    (group,) = last["groups"]
    assert group["failed"] == ["brake.unisolated"]  # tests that it is made of have no DTCs, and are not told
    assert set(group["causes"][0]["components"]) == {"plant brake.f_R", "signal brake.Sensors.Force"}


def test_two_faults_that_cancel_each_other_in_a_test_are_no_third_one():
    """Angle and force of the brake, wrong alike: the caliper holds again, and its monitor names the friction."""
    scenario = load_scenario(shipped("scenarios/brake_faults.toml"))
    config = load_config(scenario.config)
    force, angle = (next(fault for fault in scenario.fault if fault.name == name) for name in ("f_F", "f_a"))
    both = tuple(f.model_copy(update={"from_s": t, "to_s": None}) for f, t in ((force, 20.0), (angle, 21.1)))
    short = scenario.model_copy(update={"duration_s": 40.0, "fault": both, "expect": ()})
    events = played(config, player_of(short, config).frames)
    assert "brake.f_b" in [event["fault"] for event in events if event["event"] == "dtc"]
    told = [group for event in diagnoses(events) for group in event["groups"]]
    assert not any("plant brake.f_b" in (group["cause"] or ()) for group in told)
    assert set(told[-1]["causes"][0]["components"]) == {"signal brake.Sensors.Angle", "signal brake.Sensors.Force"}


def test_frames_without_a_change_of_verdict_cost_nothing(monkeypatch):
    """Of some hundred frames, those are followed by work at which a verdict changes, and a wait ends."""
    config, frames = frames_of("signals_faults", 8.5)
    calls = {"take": 0, "look": 0}
    for name in calls:
        inner = getattr(Causes, name)

        def counted(self, *arguments, name=name, inner=inner):
            calls[name] += 1
            return inner(self, *arguments)

        monkeypatch.setattr(Causes, name, counted)
    told = diagnoses(played(config, frames[frames["t_ns"] < 2e9], list(np.array_split(frames, 400))))
    assert len(told) == 2, "one fault comes and goes"
    assert len(frames) > 600
    assert 2 <= calls["look"] <= 6
    assert calls["take"] <= 2 * 400 + 20
    calls["look"] = 0
    assert diagnoses(played(config, frames[frames["t_ns"] < 2e9])) == []
    assert calls["look"] == 0


@pytest.mark.parametrize("symptoms", ["keep", "hold"])
def test_a_fault_that_has_passed_again_at_once_is_looked_at_where_its_confirmation_waits(symptoms):
    config = load_config(shipped("gateway.toml"))
    memory = config.memory.model_copy(update={"symptoms": symptoms})
    gateway = Gateway(config.model_copy(update={"memory": memory}))
    causes = gateway._diagnosis._causes
    slot = next(k for k, slot in enumerate(gateway.engine.faults) if slot.id in causes.tested)
    for kind, after_ms in ((QUALIFIED_FAILED, 0), (QUALIFIED_PASSED, 20), (QUALIFIED_FAILED, 90)):
        event = np.zeros(1, EVENT)
        event["kind"], event["fault"], event["t_ns"] = kind, slot, 10**9 + after_ms * 10**6
        causes.take(event)
        looked = kind == QUALIFIED_FAILED or symptoms == "hold"
        assert gateway.engine.pause_ns == (1_100_000_000 if looked else NEVER), "one that chatters is looked at in time"
    gateway.close()


def test_a_cause_that_is_gone_is_told_as_gone():
    config, frames = frames_of("signals_faults", 8.5)
    assert diagnoses(played(config, frames))[-1]["groups"] == []


def test_a_cleared_fault_has_no_cause_until_it_fails_again():
    """The silence is looked at again every 200 ms."""
    config, frames = frames_of("signals_faults", 4.9)
    gateway = Gateway(config)
    events = []
    gateway.listen(events.append)
    gateway.start(0)
    gateway.feed(silent_from(frames, 3.0))
    gateway.advance(4_000_000_000)
    assert diagnoses(events)[-1]["groups"]
    assert gateway.controls.clear(0xFFFFFF)
    gateway.advance(4_110_000_000)
    assert diagnoses(events)[-1]["groups"] == []
    gateway.advance(4_310_000_000)
    assert [group["failed"] for group in diagnoses(events)[-1]["groups"]] == [["chassis.bus_silent"]]
    gateway.close()


@pytest.mark.evidence("Healthy parts: plants")
@pytest.mark.parametrize("name", ["pedal_healthy", "crank_healthy", "truck_healthy", "tanks_healthy"])
def test_healthy_plants_have_no_cause(name):
    config, frames = frames_of(name, 10.0)
    assert diagnoses(played(config, frames)) == []


@pytest.mark.parametrize(
    ("name", "seconds"), [("signals_faults", 36.0), ("pedal_three", 8.0), ("crank_wire_corrupted", 8.0)]
)
def test_it_is_the_same_however_the_frames_come(name, seconds):
    """A log in one piece, in pieces of any length, frame by frame with time between them: the same events."""
    config, frames = frames_of(name, seconds)
    seed = sum(map(ord, name))
    print("seed", seed)
    whole = played(config, frames)
    assert diagnoses(whole)
    for most in (3, 400):
        rng = random.Random(seed + most)
        cuts = [0]
        while cuts[-1] < len(frames):
            cuts.append(cuts[-1] + rng.randint(1, most))
        pieces = [frames[a:b] for a, b in itertools.pairwise(cuts)]
        assert played(config, frames, pieces) == whole


def test_a_frozen_message_proves_no_signal_beside_it(tmp_path):
    """Four wheels of one message stand, and go on to fit each other: the speed that moves on is not proven wrong."""
    signals = 'SG_ {} : {}|16@1+ (0.01,0) [0|300] "km/h" B'
    wheels = " ".join(signals.format(name, 16 * k) for k, name in enumerate(("FL", "FR", "RL", "RR")))
    text = f"BO_ 256 Speed: 8 A\n {signals.format('V', 0)}\nBO_ 257 Wheels: 8 A\n {wheels}\n"
    rules = [f'{{name = "{n}", holds = "Speed.V == Wheels.{n}", tolerance = 4.0}}' for n in ("FL", "RR")]
    rules += ['{name = "rear", holds = "Wheels.RL == Wheels.RR", tolerance = 4.0}']
    tables = f'[[monitor]]\nname = "r"\ntype = "rule"\nbus = "b"\nrule = [{", ".join(rules)}]\n'
    one = Car(write(tmp_path, text, tables))
    for k in range(1500):
        speed = round(100 * (40.0 + 0.02 * k)).to_bytes(2, "little")
        wheel = round(100 * (40.0 + 0.02 * min(k, 600))).to_bytes(2, "little")
        one.feed([speed + bytes(6)], 256).feed([4 * wheel], 257)
    assert one.failed() == ["FL", "RR"]
    groups = [group for event in one.of("diagnosis") for group in event["groups"]]
    assert groups[-1]["failed"]
    assert all(group["cause"] is None for group in groups)
    named = {tuple(one["components"]): one["probability"] for one in groups[-1]["causes"]}
    assert named["message b.Wheels",] > 0.05
    assert len(named) == len(groups[-1]["causes"]), "a message is told once, in whatever way it fails"


def test_signals_of_a_frozen_message_that_look_for_other_times_are_not_late(tmp_path):
    """One wheel is stuck after a second, the others after three: that is how long they look, not a second fault."""
    signals = 'SG_ {} : {}|16@1+ (0.01,0) [0|300] "km/h" B'
    wheels = " ".join(signals.format(name, 16 * k) for k, name in enumerate(("FL", "FR", "RL", "RR")))
    text = f"BO_ 256 Speed: 8 A\n {signals.format('V', 0)}\nBO_ 257 Wheels: 8 B\n {wheels}\n"
    looks = zip(("FL", "FR", "RL", "RR"), (1.0, 3.0, 3.0, 3.0), strict=True)
    stuck = 'stuck = {{seconds = {}, share = 0.5, during = "Speed.V", within = [10.0, 300.0]}}'
    lines = ", ".join(f'{{signal = "Wheels.{n}", {stuck.format(s)}}}' for n, s in looks)
    one = Car(write(tmp_path, text, f'[[monitor]]\nname = "s"\ntype = "signal"\nbus = "b"\nsignal = [{lines}]\n'))
    for k in range(1500):
        speed, wheel = ((round(4000 + 2 * n)).to_bytes(2, "little") for n in (k, min(k, 600)))
        one.feed([speed + bytes(6)], 256).feed([4 * wheel], 257)
    assert one.failed() == ["FL.stuck", "FR.stuck", "RL.stuck", "RR.stuck"]
    causes = [group["cause"] for event in one.of("diagnosis") for group in event["groups"]]
    assert causes[-1] == ["message b.Wheels"]
    assert all(cause in (None, ["message b.Wheels"]) for cause in causes)


@pytest.fixture(scope="module")
def car(tmp_path_factory):
    """Return the configuration that is learned from the car's drive, and the drive."""
    folder = tmp_path_factory.mktemp("car")
    database, log = shipped("examples/car/toyota_rav4.dbc"), shipped("examples/car/drive.log.xz")
    learn_car(
        [database, log], out=folder / "car.toml", buses=(), hold_out=0.2, maps=(), pgn=False, seed=1, update=False,
        ecu=None, force=False, json=True, false_per_hour=1e-3,
    )  # fmt: skip
    return folder / "car.toml", log


@pytest.mark.long
@pytest.mark.parametrize(
    ("injected", "cause"),
    [
        ("offset SPEED.SPEED=40 @20..25", "signal can0.SPEED.SPEED"),
        ("drop SPEED @20..25", "message can0.SPEED"),
        ("freeze WHEEL_SPEEDS @20..30", "message can0.WHEEL_SPEEDS"),
        ("offset WHEEL_SPEEDS.WHEEL_SPEED_FR=40 @20..45", "signal can0.WHEEL_SPEEDS.WHEEL_SPEED_FR"),
        ("", None),
    ],
)
def test_of_a_learned_car_the_part_that_is_wrong_is_named(car, tmp_path, capsys, injected, cause):
    config, log = car
    capsys.readouterr()
    faults = [injected] if injected else []
    replay(log, config, memory=tmp_path / "m.sqlite", injections=faults, json=True, fail_on_dtc=False)
    told = diagnoses([json.loads(line) for line in capsys.readouterr().out.splitlines()])
    causes = {tuple(group["cause"]) for event in told for group in event["groups"] if group["cause"]}
    assert causes == ({(cause,)} if cause else set())
    assert bool(told) is bool(injected)


@pytest.mark.long
@pytest.mark.parametrize(
    "injected",
    [
        "offset WHEEL_SPEEDS.WHEEL_SPEED_FR=25 @20..22", "scale WHEEL_SPEEDS.WHEEL_SPEED_FL=0.2 @20..20.8",
        "scale WHEEL_SPEEDS.WHEEL_SPEED_RL=0.96 @5",
    ],
    ids=["a wheel spins on ice", "ABS", "a spare wheel"],
)  # fmt: skip
def test_everyday_driving_accuses_no_part_of_a_learned_car(car, tmp_path, capsys, injected):
    config, log = car
    capsys.readouterr()
    replay(log, config, memory=tmp_path / "m.sqlite", injections=[injected], json=True, fail_on_dtc=False)
    events = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [e["fault"] for e in events if e["event"] == "dtc"] == []
    assert diagnoses(events) == []
