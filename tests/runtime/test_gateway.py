"""The whole gateway in one process: scenarios, live against replay, robustness, clear errors."""

import random
import tomllib
from pathlib import Path

import can
import numpy as np
import pytest
from amount import FULL, examples
from due import due_ns
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from jsonschema_rs import Draft202012Validator, meta

from gateway.bus.frames import ERROR, EXTENDED, FD, FRAME, REMOTE, empty
from gateway.bus.logs import LogReader, open_writer
from gateway.config.load import load_config
from gateway.faults import service
from gateway.runtime.app import Gateway
from gateway_ask.clients.ecu import COUNTED
from gateway_bench.drive import drive
from gateway_bench.vecu.expectations import Judge
from gateway_bench.vecu.player import Player
from gateway_bench.vecu.scenario import load_scenario
from gateway_commands.configuration_schema import schema
from gateway_fdi.common.resources import all_shipped, shipped
from gateway_fdi.errors import GatewayError, InputError, InputErrors
from gateway_replay.replay import replay

SCENARIOS = sorted(path.stem for path in all_shipped("scenarios", ".toml"))

#: The one that is also run with GATEWAY_TESTS=small.
CHAIN = pytest.mark.chain


def build(name, seed=None):
    scenario = load_scenario(shipped(f"scenarios/{name}.toml"))
    config = load_config(scenario.config)
    buses = {bus.name: k for k, bus in enumerate(config.bus)}
    player = Player(scenario, buses, seed=seed, databases={k: bus.database for k, bus in enumerate(config.bus)})
    return scenario, config, player


def live(name, seed=None, log=None):
    """Run a scenario in this process; returns its events and findings."""
    scenario, config, player = build(name, seed)
    gateway = Gateway(config)
    events = []
    gateway.listen(events.append)
    judge = Judge(scenario)
    writer = None if log is None else open_writer(log)
    drive(gateway, player, judge=judge, on_frames=None if writer is None else writer.write)
    if writer is not None:
        writer.close()
    summary = gateway.summary(1.0)
    gateway.close()
    return config, events, judge.findings(), summary


def replayed(config, batches):
    gateway = Gateway(config)
    events = []
    gateway.listen(events.append)
    replay(gateway, batches)
    summary = gateway.summary(1.0)
    gateway.close()
    return events, summary


def heard(summary):
    """Return the counters of a run, without those of requests: a replay asks nobody."""
    asked = {f"ecu_{name}" for name in COUNTED}
    return {name: count for name, count in summary["counters"].items() if name not in asked}


#: Replayed frame by frame in CI, one of each kind; the others eleven frames at a time. GATEWAY_TESTS=full: all.
SINGLY = {
    "crank_missed_tooth", "crank_cam", "crank_fd", "crank_wire_corrupted", "diagnostics", "linear_aircraft_faults",
    "linear_belt_faults", "pedal_emergency", "signals_faults", "steering_healthy", "truck_mass",
}  # fmt: skip


#: Left out in CI: others are of the same plant and configuration, or of the same bus.
MORE = {
    "battery_healthy", "brake_healthy", "cooling_healthy", "obd_port", "obd_port_2027", "tanks_healthy", "truck_brake",
    "truck_hills", "truck_machine_resistance", "truck_noise", "truck_slope", "truck_wind", "pedal_three",
}  # fmt: skip


def marks_of(name):
    if name == "crank_missed_tooth":
        return CHAIN
    return pytest.mark.full("1 to 3 s each") if name in MORE else pytest.mark.long


@pytest.mark.evidence("Live is replay: scenarios")
@pytest.mark.parametrize("name", [pytest.param(name, marks=marks_of(name)) for name in SCENARIOS])
def test_every_scenario_meets_its_expectations_and_live_equals_replay(name, tmp_path):
    """Event for event, time stamp for time stamp, whatever the chunks of the replay."""
    for seed in (1,):
        log = tmp_path / f"{seed}.log"
        config, events, findings, summary = live(name, seed, log)
        assert all(finding.good for finding in findings), [f.text for f in findings]
        for chunk in (1, 100_000) if FULL or name in SINGLY else (11,):
            again, repeated = replayed(config, LogReader(log, chunk=chunk))
            assert again == events
            assert heard(repeated) == heard(summary)
            assert repeated["monitors"] == summary["monitors"]
        assert len(events) > 0


@pytest.mark.evidence("Live is replay: chunks")
@pytest.mark.long
@settings(
    max_examples=examples(12),
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(seed=st.integers(0, 2**31), data=st.data())
def test_live_equals_replay_for_any_seed_and_any_chunks(seed, data):
    name = data.draw(st.sampled_from(["crank_missed_tooth", "crank_wire_corrupted", "crank_fd"]))
    _, config, player = build(name, seed)
    gateway = Gateway(config)
    events = []
    gateway.listen(events.append)
    gateway.start(0)
    step = data.draw(st.sampled_from([1_000_000, 13_000_000, 400_000_000]))
    for until, frames in player.batches(step):
        gateway.feed(frames)
        gateway.advance(until)
    gateway.close()
    cuts = sorted(data.draw(st.lists(st.integers(0, len(player.frames)), max_size=6)))
    again, _ = replayed(config, np.split(player.frames, cuts))
    assert again == events


@pytest.mark.long
@pytest.mark.parametrize("name", ["crank_missed_tooth", "diagnostics", "truck_mass", "signals_faults", "restbus"])
def test_before_it_is_due_there_is_nothing_to_do(name):
    """Who waits for the next time it gives misses no event and no frame; and on a quiet bus it is seldom due."""
    _, config, player = build(name)
    gateway = Gateway(config)
    events = []
    gateway.listen(events.append)
    gateway.start(0)
    assert due_ns(gateway) < 0, "its time has not begun"
    last = waited = 0
    for until, frames in player.batches():
        gateway.feed(frames)
        while True:
            early = min(due_ns(gateway) - 1, until)
            if early > gateway.engine.now_ns:
                waited += early - gateway.engine.now_ns
                told = len(events)
                assert not len(gateway.advance(early))
                assert len(events) == told
            if due_ns(gateway) > until:
                break
            gateway.advance(due_ns(gateway) if due_ns(gateway) > gateway.engine.now_ns else until)
            if gateway.engine.now_ns >= until:
                break
        last = until
    gateway.stop(last)
    gateway.close()
    _, plain, _, _ = live(name)
    assert events == plain
    assert waited > last // 10


def test_the_json_contract_of_events():
    _, events, _, summary = live("crank_missed_tooth")
    dtcs = [event for event in events if event["event"] == "dtc"]
    first = dtcs[0]
    assert (first["fault"], first["dtc"], first["status"]) == ("crank.missed_pulse", "P0336-39", 47)
    assert (first["fdc"], first["bus"], first["occurrence"]) == (127, "powertrain", 1)
    assert {"value", "threshold", "count", "tooth", "residual 5 [pitch]"} <= set(first["evidence"])
    assert [event["status"] for event in dtcs] == [0x2F, 0x2E]
    assert {event["event"] for event in events} == {"dtc", "monitor", "diagnosis"}
    assert summary["event"] == "summary"
    assert {"frames", "decoded", "events", "seconds", "frames_per_s"} <= set(summary)
    assert summary["events"] == sum(event["event"] != "diagnosis" for event in events)


def test_the_freeze_frame_is_of_the_very_frame_that_failed(tmp_path):
    """The same record from single frames as from one big batch, and its values lie in that frame."""
    _, config, player = build("crank_missed_tooth")
    records = []
    for name, parts in (("one", 1), ("each", len(player.frames))):
        path = tmp_path / f"{name}.sqlite"
        gateway = Gateway(config, path)
        replay(gateway, np.array_split(player.frames, parts))
        gateway.close()
        records.append(service.show(path, "P0336-39"))
    assert records[0] == records[1]
    (record,) = records[0]["freeze_frames"]
    at = player.frames[player.frames["t_ns"] == record["t_ns"]][0]
    assert record["signals"]["CTW_PT4.FrameCnt"] == int(at["data"][1])


def random_frames(rng, count):
    frames = np.zeros(count, FRAME)
    frames["t_ns"] = np.sort(rng.integers(0, 10**11, count))
    late = rng.random(count) < 0.01
    frames["t_ns"][late] = rng.integers(-(2**40), 2**60, late.sum())
    known = rng.choice([0x700, 0x701, 0x703, 0x6F0], count)
    frames["can_id"] = np.where(rng.random(count) < 0.5, known, rng.integers(0, 2**29, count))
    for bit, share in ((EXTENDED, 0.3), (REMOTE, 0.02), (ERROR, 0.02)):
        frames["can_id"] |= np.where(rng.random(count) < share, bit, 0).astype(np.uint32)
    frames["bus"] = rng.integers(0, 3, count)
    frames["flags"] = rng.choice([0, FD, FD | 2, 8], count)
    frames["length"] = rng.choice([0, 1, 7, 8, 8, 8, 8, 12, 63, 64], count)
    frames["data"] = rng.integers(0, 256, (count, 64), dtype=np.uint8)
    frames["data"][np.arange(64)[None, :] >= frames["length"][:, None]] = 0
    return frames


@pytest.mark.parametrize("config", ["gateway.toml", "configs/crank_fd.toml"])
def test_a_hundred_thousand_random_frames(config):
    print("seed 77")
    rng = np.random.default_rng(77)
    gateway = Gateway(load_config(shipped(config)))
    frames = random_frames(rng, 100_000)
    # Half of the frames of the watched message get a good CRC, so that the monitor sees garbage too.
    watched = 0x700 if config == "gateway.toml" else 0x703
    import crccheck

    for k in np.flatnonzero(frames["can_id"] == watched)[::2]:
        length = int(frames[k]["length"])
        if length:
            body = bytes(frames[k]["data"][1:length]) + watched.to_bytes(2, "little")
            frames[k]["data"][0] = crccheck.crc.Crc8SaeJ1850.calc(body)
    gateway.start(0)
    for part in np.split(frames, 100):
        gateway.feed(part)
    counters = gateway.engine.counters()
    assert counters["frames"] == 100_000
    told = sum(counters[k] for k in ("unknown", "remote", "error", "crc_failed", "repeated"))
    # Short frames are decoded as far as they go, or refused.
    assert told + counters["decoded"] <= 100_000 <= told + counters["decoded"] + counters["too_short"]
    assert counters["decoded"] > 100
    assert counters["events_lost"] == counters["results_lost"] == 0
    for values in gateway.engine.readout().values():
        assert all(np.isfinite(value) for value in values.values())
    gateway.close()


@pytest.mark.long
def test_a_damaged_configuration_is_one_clear_error(tmp_path):
    whole = shipped("gateway.toml").read_text()
    path = tmp_path / "gateway.toml"
    rng = random.Random(3)
    print("seed 3")
    outcomes = set()
    for k in range(400):
        text = whole[: rng.randrange(len(whole))] if k % 2 else whole
        noise = bytearray(text.encode())
        if k % 2 == 0:
            for _ in range(rng.randrange(1, 4)):
                noise[rng.randrange(len(noise))] = rng.randrange(32, 127)
        path.write_bytes(bytes(noise))
        try:
            Gateway(load_config(path), file=path).close()
        except (InputError, InputErrors) as error:
            outcomes.add("refused")
            assert all("gateway.toml" in line or ".dbc" in line for line in str(error).splitlines())
        else:
            outcomes.add("good")
    assert outcomes == {"refused", "good"}


def config_error(tmp_path, *changes):
    text = shipped("gateway.toml").read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path = tmp_path / "gateway.toml"
    path.write_text(text)
    with pytest.raises((InputError, InputErrors)) as caught:
        Gateway(load_config(path), file=path)
    return str(caught.value)


@pytest.mark.evidence("Nothing is silent: error")
@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('wheel = "60-2"', 'wheel = "sixty"', "monitor[0].wheel = 'sixty'"),
        ('wheel = "60-2"', 'wheel = "60-2"\ngian = 1', "monitor[0].gian: unknown key"),
        ('wheel = "60-2"', "", "monitor[0].wheel: this key is missing"),
        (
            'type = "crank_sync"',
            'type = "crank"',
            "monitor[0].type = 'crank': the types are crank_sync",
        ),
        ('bus = "powertrain"\nwheel', 'bus = "body"\nwheel', "the buses are powertrain"),
        ('"FrameCnt"', '"FrameCount"', "did you mean FrameCnt"),
        ('message = "CTW_PT4"', 'message = "CTW_PT5"', "did you mean CTW_PT4"),
        ("timeout_ms = 500.0", "timeout_ms = -1", "bus[0].check[0].timeout_ms = -1"),
        ('[fault."crank.missed_pulse"]', '[fault."crank.missed"]', "no monitor reports this fault"),
        ("freeze_frame = [", 'dtc = "P033"\nfreeze_frame = [', 'fault."crank.missed_pulse".dtc'),
        (
            "freeze_frame = [",
            'dtc = "P0336-3A"\nfreeze_frame = [',
            "crank.missed_pulse has this DTC",
        ),
        ('"CTW_PT4.FrameCnt"]', '"powertrain.CTW_PT4.Pt9"]', "no signal 'Pt9'"),
        ("crank.dbc", "nowhere.dbc", "No such file"),
        ('name = "bench"', 'name = "bench', "gateway.toml:3"),
        ("cycle_ms = 1000.0", 'cycle_ms = "x"', "output.dtc_frame.cycle_ms = 'x'"),
    ],
)
def test_wrong_configurations_name_file_key_and_value(tmp_path, old, new, said):
    text = config_error(tmp_path, (old, new))
    assert said in text
    assert "gateway.toml" in text or ".dbc" in text


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("send = true", 'send = "Nope"', "monitor \"brake\".send = 'Nope': no database has"),
        ("send = true", 'send = "PED_Brake"', "this message has no Isolated, Mismatch, Position"),
        ('preset = "brake"', 'preset = "clutch"', "monitor[0].preset = 'clutch'"),
        ('preset = "brake"', 'preset = "brake_3"', "monitor[0]: a redundant_pair has 2 channels"),
        ('preset = "brake"', 'voter = "none"', "monitor[0].voter = 'none'"),
        ('preset = "brake"', 'voter = "kalman"', "in the studies now: gateway evaluate pedal"),
        ('preset = "brake"', "tolerance = 0", "monitor[0].tolerance = 0"),
    ],
)
def test_wrong_pedals_are_refused_with_their_key(tmp_path, old, new, said):
    text = shipped("configs/pedal.toml").read_text()
    assert old in text
    path = tmp_path / "pedal.toml"
    path.write_text(text.replace(old, new))
    with pytest.raises((InputError, InputErrors)) as caught:
        Gateway(load_config(path), file=path)
    assert said in str(caught.value)
    assert "pedal.toml" in str(caught.value)


def test_a_voted_value_can_go_out_as_another_message(tmp_path):
    text = shipped("configs/pedal.toml").read_text()
    path = tmp_path / "pedal.toml"
    path.write_text(text.replace("send = true", 'send = "GW_AcceleratorPedal"'))
    gateway = Gateway(load_config(path))
    _, _, player = build("pedal_emergency")
    gateway.start(0)
    sent = gateway.feed(player.frames[:100])
    gateway.close()
    assert (sent["can_id"] == 0x2B1).sum() == 100


@pytest.mark.evidence("Nothing is silent: mistakes")
def test_all_mistakes_are_named_at_once(tmp_path):
    text = config_error(
        tmp_path,
        ('wheel = "60-2"', 'wheel = "x"\nfoo = 1'),
        ('bus = "powertrain"\nwheel', 'bus = "body"\nwheel'),
    )
    assert len(text.splitlines()) == 3


def test_the_environment_overrides_the_file(monkeypatch):
    monkeypatch.setenv("GATEWAY_MEMORY__PATH", "/elsewhere/f.sqlite")
    monkeypatch.setenv("GATEWAY_NAME", "other")
    config = load_config(shipped("gateway.toml"))
    assert config.memory.path == Path("/elsewhere/f.sqlite")
    assert config.name == "other"
    assert config.bus[0].name == "powertrain"


def test_shipped_configurations_are_as_the_schema_says():
    meta.validate(schema())
    judge = Draft202012Validator(schema())
    files = [
        shipped("gateway.toml"),
        *(path for path in all_shipped("configs", ".toml") if "bus" in _read(path)),  # the others are catalogues
        shipped("examples/battery_voltage/gateway.toml"),
    ]
    assert {path.name: [error.message for error in judge.iter_errors(_read(path))] for path in files} == {
        path.name: [] for path in files
    }
    wrong = _read(shipped("configs/truck.toml"))
    wrong["monitor"][0]["nu"] = {"T1": "many"}  # a part that only this monitor has
    assert not judge.is_valid(wrong)


def _read(path):
    return tomllib.loads(path.read_text(encoding="utf-8"))


def test_the_schema_describes_monitors():
    text = str(schema())
    assert "crank_sync" in text
    assert "trigger wheel" in text


def test_a_stalled_engine_is_neither_a_dead_ecu_nor_a_sensor_fault():
    scenario, config, _ = build("crank_healthy")
    (ecu,) = scenario.ecu
    # Runs, is switched off within one turn, stands, runs again.
    profile = ((0, 0), (1, 0), (1.001, 1500), (3, 1500), (3.001, 0), (5, 0), (5.001, 1500))
    stalled = scenario.model_copy(update={"ecu": (ecu.model_copy(update={"speed": profile}),)})
    gateway = Gateway(config)
    events = []
    gateway.listen(events.append)
    replay(gateway, [Player(stalled, {"powertrain": 0}).frames])
    crank = gateway.engine.readout()["crank"]
    assert [e for e in events if e["event"] == "dtc"] == []
    assert crank["revolutions"] > 100
    assert crank["speed_rpm"] == pytest.approx(1500, rel=0.01)
    gateway.close()


def test_monitors_are_silent_when_a_tester_says_so():
    _, config, player = build("crank_missed_tooth")
    gateway = Gateway(config)
    gateway.start(0)
    assert len(gateway.feed(player.frames[:1000])) > 10
    gateway.controls.set_communication(receive=True, send=False)
    assert len(gateway.feed(player.frames[1000:2000])) == 0
    gateway.controls.set_communication(receive=True, send=True)
    assert len(gateway.feed(player.frames[2000:])) > 10
    gateway.close()


def test_an_empty_log_is_no_cycle():
    gateway = Gateway(load_config(shipped("gateway.toml")))
    assert replay(gateway, [empty(0)]) == 0
    assert gateway.memory.cycle_number() == 0


def test_a_gateway_that_is_closed_takes_no_frames_and_no_time():
    gateway = Gateway(load_config(shipped("gateway.toml")))
    gateway.start(0)
    gateway.close()
    with pytest.raises(GatewayError, match=r"^this gateway is closed"):
        gateway.feed(empty(1))
    with pytest.raises(GatewayError, match=r"^this gateway is closed"):
        gateway.advance(10**9)


@pytest.mark.parametrize(
    ("frames", "what"),
    [
        ([can.Message(arbitration_id=0x123)], "list"),
        (can.Message(), "Message"),
        (None, "NoneType"),
        (empty(2)[0], "void"),
        (np.zeros(3), r"array of float64 and shape \(3,\)"),
        (empty(4).reshape(2, 2), r"array of .* and shape \(2, 2\)"),
    ],
)
def test_what_is_no_batch_of_frames_is_refused(frames, what):
    gateway = Gateway(load_config(shipped("gateway.toml")))
    gateway.start(0)
    with pytest.raises(TypeError, match=rf"gateway\.bus\.frames\.FRAME.*; this is: {what}$"):
        gateway.feed(frames)
    gateway.feed(empty(1))  # an array of the same fields, whoever made it
    gateway.feed(np.zeros(1, np.dtype(FRAME.descr)))
    gateway.close()


def test_paths_may_be_texts(tmp_path):
    path = str(shipped("gateway.toml"))
    assert load_config(path) == load_config(Path(path))
    gateway = Gateway(load_config(path), str(tmp_path / "faults.sqlite"))
    gateway.close()
    assert (tmp_path / "faults.sqlite").exists()
    with pytest.raises(InputError, match=r"^none\.toml: No such file"):
        load_config("none.toml")
