"""The wall clock is set while the daemon runs: nothing but the stamps for people may show it."""

import json
import zlib

import numpy as np
import pytest
from bench_config import beat, write_config
from daemon_rig import World

from gateway.bus.conditions import are_steps, step_ns_of
from gateway.bus.logs import LogReader
from gateway.config.load import load_config
from gateway.faults.store import Store
from gateway.live.clock import Clock
from gateway.runtime.app import Gateway
from gateway_replay.channels import channels_of
from gateway_replay.replay import replay

STEPS = [3600.0, -3600.0, -0.5]
MORE = """
[output.uds]
[memory.recording]
before_ms = 1500.0
after_ms = 400.0
[record]
folder = "{folder}/ring"
[fault."chassis.Beat.counter"]
debounce = {{ failed_ms = 200.0, passed_ms = 200.0 }}
"""


def config_of(folder, more=""):
    folder.mkdir(exist_ok=True)
    text = MORE.format(folder=folder) + more
    return write_config(folder, buses=[("chassis", "virtual:a")], more=text)


class Bench:
    """An ECU with an alive counter, and a tester."""

    def __init__(self, world):
        self.world, self.count = world, 0

    def traffic(self, step=1):
        """Beat each 20 ms, its counter going on by so much."""

        def each(turn):
            if turn % 4 == 0:
                self.count += step
                self.world.put(0x300, beat(self.count))

        return each

    def ask(self, request):
        self.world.put(0x7E0, bytes([len(request)]) + request + bytes(7 - len(request)))


def script(world, bench, step_s, at):
    """Everything that takes time: debounce, a session, a request cut off, silence of a message, cyclic frames.

    Args:
        world, bench: of this run.
        step_s: the clock is set by so much, None: never.
        at: where: "debounce", "session", "request", "silence", "healing".
    """

    def here(place):
        if place == at and step_s is not None:
            world.set_clock(step_s)

    wait = world.wait
    yield from wait(1.0, bench.traffic())
    yield from wait(0.1, bench.traffic(step=5))  # lost frames: a fault after 0.2 s
    here("debounce")
    yield from wait(0.3, bench.traffic(step=5))
    bench.ask(bytes.fromhex("1003"))
    yield from wait(1.0, bench.traffic())
    here("session")
    yield from wait(1.0, bench.traffic())
    bench.ask(bytes.fromhex("22f186"))  # the session is still there; it ends 5 s from here
    world.put(0x7E0, bytes.fromhex("1014220102030405"))  # the first frame of a request, and no more
    yield from wait(0.4, bench.traffic())
    here("request")
    yield from wait(0.4, bench.traffic())
    yield from wait(0.15)
    here("silence")
    yield from wait(1.0)
    here("healing")
    yield from wait(2.9, bench.traffic())
    bench.ask(bytes.fromhex("22f186"))  # 4.9 s after: this one keeps it alive
    yield from wait(5.2, bench.traffic())
    bench.ask(bytes.fromhex("22f186"))
    yield from wait(0.2, bench.traffic())


def run(folder, step_s=None, at="", more="[clock]\nwatched = false\n", **options):
    world = World(**options)
    daemon = world.daemon(config_of(folder, more), folder / "f.sqlite")
    try:
        world.play(daemon, script(world, Bench(world), step_s, at))
        world.counters = daemon.gateway.summary(1.0)["counters"]
        world.entries = daemon.gateway.memory.entries()
    finally:
        daemon.close()
    return world


def without_stamps(world):
    """What happened, and when it truly did."""
    return [
        (at, {k: v for k, v in event.items() if k != "t_ns"}) for at, event in world.events if event["event"] != "clock"
    ]


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    return run(tmp_path_factory.mktemp("undisturbed"))


def answers(world):
    return [data.hex() for _, _, can_id, data in world.sent if can_id == 0x7E8]


def test_the_script_has_all_that_takes_time(undisturbed):
    """Or the tests below would show nothing."""
    assert undisturbed.dtcs() == [
        ("U0401-82", 1), ("U0401-82", 0), ("U0100-87", 1), ("U0100-87", 0)
    ]  # fmt: skip
    assert [answer[:8] for answer in answers(undisturbed)] == [
        "06500300", "0462f186", "300000cc", "0462f186", "0462f186"
    ]  # fmt: skip
    sessions = [answer[8:10] for answer in answers(undisturbed) if answer.startswith("0462")]
    assert sessions == ["03", "03", "01"], "kept by requests, ended by S3"
    assert undisturbed.counters["isotp_errors"] == 1, "the request that was cut off"
    assert undisturbed.counters["clock_steps"] == 0


@pytest.mark.parametrize("at", ["debounce", "session", "request", "silence", "healing"])
@pytest.mark.parametrize("step_s", STEPS)
def test_a_step_changes_nothing_but_stamps(step_s, at, undisturbed, tmp_path):
    world = run(tmp_path / "run", step_s, at)
    assert world.sent == undisturbed.sent, "each frame at the same true time"
    assert without_stamps(world) == without_stamps(undisturbed)
    frames = undisturbed.counters["frames"] + 1  # one tells of the step
    assert world.counters == undisturbed.counters | {"clock_steps": 1, "frames": frames}
    (step,) = world.told("clock")
    assert step["step_s"] == step_s
    # Stamps for people are of the wall clock as it was.
    place = [event for _, event in world.events].index(step)
    mine = [event["t_ns"] for _, event in world.events if event is not step]
    theirs = [event["t_ns"] for _, event in undisturbed.events]
    shift = round(step_s * 1e9)
    assert mine == [t + (shift if k >= place else 0) for k, t in enumerate(theirs)]
    assert 0 < place < len(theirs)


@pytest.mark.evidence("Nothing is silent: clock")
@pytest.mark.parametrize("at", ["debounce", "silence"])
@pytest.mark.parametrize("step_s", STEPS)
def test_a_step_is_a_fault_of_the_gateway_that_heals(step_s, at, tmp_path):
    world = run(tmp_path / "run", step_s, at, more="[clock]\nheals_after_s = 2.0\n")
    mine = [(t, e) for t, e in world.events if e["event"] == "dtc" and e["dtc"] == "U3000-62"]
    (set_at, failed), (healed_at, healed) = mine
    assert failed["fault"] == "gateway.clock_stepped"
    assert failed["bus"] == ""
    assert failed["evidence"] == {
        "value": abs(step_s), "threshold": 0.01, "step [s]": step_s, "steps since the start": 1.0
    }  # fmt: skip
    assert (failed["status"] & 1, healed["status"] & 1) == (1, 0)
    assert 2.0 <= (healed_at - set_at) / 1e9 < 2.1
    wall = world.start_ns + 1_700_000_000 * 10**9 + round(step_s * 1e9)
    entry = next(e for e in world.entries if e.fault == "gateway.clock_stepped")
    assert entry.record.first_ns == failed["t_ns"] > wall, "by the clock as it was set"
    assert [d for d, _ in world.dtcs() if d != "U3000-62"] == ["U0401-82"] * 2 + ["U0100-87"] * 2


def test_what_others_do_to_the_clock_slowly_is_followed(tmp_path):
    """NTP slews by 500 ppm where the monotonic clock does not go with it: no step, and time is the wall's."""
    world = World()
    bench = Bench(world)
    daemon = world.daemon(config_of(tmp_path / "run"), tmp_path / "f.sqlite")

    def each(turn):
        bench.traffic()(turn)
        world.ahead_ns += 2500 if turn < 3000 else -2500

    world.play(daemon, world.wait(30.0, each))
    daemon.close()
    assert world.told("clock") == []
    assert world.dtcs() == []
    assert world.clock.offset_ns == 0


@pytest.mark.parametrize("ahead_s", [0.0, 86_400.0])
def test_an_adapter_with_a_clock_of_its_own(ahead_s, undisturbed, tmp_path):
    """Its stamps begin anywhere, and no step of our clock is theirs."""
    ahead = {"virtual:a": round(ahead_s * 1e9) - 10**12}
    world = run(tmp_path / "run", 3600.0, "silence", own_clocks=ahead)
    assert world.sent == undisturbed.sent
    assert without_stamps(world) == without_stamps(undisturbed)
    assert world.counters["late"] == 0


def replayed(config, frames, channels=None):
    events = []
    gateway = Gateway(load_config(config))
    gateway.listen(events.append)
    replay(gateway, frames)
    return [e for e in events if e["event"] in ("dtc", "clock")], gateway


@pytest.mark.evidence("Live is replay: clock")
@pytest.mark.parametrize("at", ["debounce", "silence"])
@pytest.mark.parametrize("step_s", STEPS)
def test_its_recording_replays_to_the_same_verdicts(step_s, at, tmp_path):
    world = run(tmp_path / "run", step_s, at, more="")
    config = tmp_path / "run" / "beat.toml"
    events, gateway = replayed(config, LogReader(tmp_path / "run" / "ring"))
    live = [e for _, e in world.events if e["event"] in ("dtc", "clock")]
    assert json.dumps(events) == json.dumps(live), "to the nanosecond, by the wall clock"
    assert gateway.engine.offset_ns == round(step_s * 1e9)
    # The frames in it have the stamps that the bus gave them.
    frames = np.concatenate(list(LogReader(tmp_path / "run" / "ring")))
    (step,) = np.flatnonzero(are_steps(frames))
    assert step_ns_of(frames[step]) == round(step_s * 1e9)
    beats = frames[frames["can_id"] == 0x300]["t_ns"]
    jumps = np.flatnonzero(np.abs(np.diff(beats)) > 3e8)
    assert len(jumps) in (1, 2), "the step, and the silence"


@pytest.mark.parametrize("step_s", STEPS)
def test_frames_kept_around_a_failure_have_the_step_too(step_s, tmp_path):
    run(tmp_path / "run", step_s, "debounce")
    store = Store(tmp_path / "run" / "f.sqlite", write=False)
    (recording,) = store.recordings("chassis.Beat.counter")
    store.close()
    log = zlib.decompress(recording.log)
    (tmp_path / "cut.log").write_bytes(log)
    frames = np.concatenate(list(LogReader(tmp_path / "cut.log")))
    (step,) = np.flatnonzero(are_steps(frames))
    assert step_ns_of(frames[step]) == round(step_s * 1e9)
    events, _ = replayed(tmp_path / "run" / "beat.toml", LogReader(tmp_path / "cut.log"))
    (failed,) = [e for e in events if e["event"] == "dtc" and e["status"] & 1]
    assert failed["dtc"] == "U0401-82"
    assert failed["t_ns"] == recording.t_ns, "stamped as in the live run"


@pytest.mark.parametrize("step_s", STEPS)
def test_a_recording_of_another_tool_with_a_step_in_it(step_s, undisturbed, tmp_path):
    """Without a frame that tells of the step: back is known by the stamps, forward is taken for a gap."""
    run(tmp_path / "run", step_s, "debounce", more="")
    frames = np.concatenate(list(LogReader(tmp_path / "run" / "ring")))
    foreign = frames[frames["can_id"] == 0x300]
    events, gateway = replayed(tmp_path / "run" / "beat.toml", [foreign[:70], foreign[70:]])
    dtcs = [(e["dtc"], e["status"] & 1) for e in events if e["event"] == "dtc"]
    theirs = undisturbed.dtcs()
    if step_s < 0:
        assert [d for d in dtcs if d[0] != "U3000-62"] == theirs
        (step,) = [e for e in events if e["event"] == "clock"]
        assert step["step_s"] == pytest.approx(step_s, abs=0.021), "but for the time between two frames"
        assert gateway.summary(1.0)["counters"]["late"] == 0
    else:
        assert not [e for e in events if e["event"] == "clock"]
        assert dtcs.count(("U0100-87", 1)) == 2, "an hour without frames, and the silence"


@pytest.mark.parametrize("step_s", STEPS)
def test_frames_of_several_buses_stay_in_one_order(step_s, tmp_path):
    """Two buses and a third that is silent: what leaves, what is told and what a replay says of the recording."""

    def play(folder, step_s, more=""):
        folder.mkdir()
        world = World()
        buses = [("chassis", "virtual:a"), ("body", "virtual:b"), ("silent", "virtual:c")]
        path = write_config(folder, buses=buses, more=more + f'[record]\nfolder = "{folder}/ring"\n')
        text = path.read_text().split("[[bus]]\n")
        text[3] = text[3].replace("U0140", "U0146").replace("U0422", "U0423")
        path.write_text("[[bus]]\n".join(text))
        bench = Bench(world)
        beats, others = bench.traffic(), Bench(world)

        def each(turn):
            beats(turn)
            if turn % 3 == 0 and turn < 150:
                others.count += 1
                world.put(0x300, beat(others.count), "virtual:b")

        def script():
            yield from world.wait(0.5, each)
            world.set_clock(step_s)
            yield from world.wait(1.5, each)

        daemon = world.daemon(path, folder / "f.sqlite")
        world.play(daemon, script())
        world.counters = daemon.gateway.engine.counters()
        daemon.close()
        return world

    unwatched = "[clock]\nwatched = false\n"
    even = play(tmp_path / "even", 0.0, unwatched)
    assert play(tmp_path / "unwatched", step_s, unwatched).sent == even.sent
    world = play(tmp_path / "stepped", step_s)
    failed = [(e["dtc"], e["status"] & 1) for e in world.told("dtc")]
    assert failed == [("U3000-62", 1), ("U0140-87", 1)]  # what was never heard has 15 s to come
    assert world.counters["late"] == 0
    config = load_config(tmp_path / "stepped" / "beat.toml")
    ring = LogReader(tmp_path / "stepped" / "ring", channels_of(config))
    events, _ = replayed(tmp_path / "stepped" / "beat.toml", ring)
    assert events == [e for _, e in world.events if e["event"] in ("dtc", "clock")]


def test_clocks_that_go_in_ticks_make_no_steps():
    """As Windows' before Python 3.13: 15.6 ms each, and not at the same time; a real step is seen."""
    now, tick_ns = 10**12, 15_625_000
    clock = Clock(
        lambda: 1_700_000_000 * 10**9 + now // tick_ns * tick_ns,
        lambda: (now + 9_000_000) // tick_ns * tick_ns,
        tick_ns=2 * tick_ns,
    )
    for _ in range(2000):
        now += 777_777
        clock.now()
    assert clock.count == 0
    wall = clock._wall_ns
    clock._wall_ns = lambda: wall() + 100_000_000
    clock.now()
    assert clock.count == 1


PLAIN = """
from gateway.monitors.plain import Result, monitor

@monitor(signals=["Beat.Value"], fault="P0128-00")
class Mine:
    def __init__(self, most: int = 20):
        self.most, self.seen = most, 0

    def update(self, count, dt_s):
        self.seen += 1
        return Result(self.seen % 40 > self.most, self.seen + dt_s, self.most)
"""


def test_a_monitor_of_plain_python_says_the_same_live_and_in_the_replay_of_the_recording(tmp_path, monkeypatch):
    monkeypatch.setenv("GATEWAY_TRUST", "all")
    (tmp_path / "plain_beat.py").write_text(PLAIN)
    path = config_of(tmp_path, '[[monitor]]\nname = "mine"\ntype = "plain_beat:Mine"\nmost = 25\n')
    world = World()
    bench = Bench(world)
    daemon = world.daemon(path, tmp_path / "f.sqlite")
    world.play(daemon, world.wait(3.0, bench.traffic()))
    daemon.close()
    live = [e for e in world.told("dtc") if e["fault"] == "mine.fault"]
    ring = LogReader(tmp_path / "ring", channels_of(load_config(path)))
    events, _ = replayed(path, ring)
    assert [e for e in events if e.get("fault") == "mine.fault"] == live
    assert len(live) >= 4, "it fails and heals, again and again"
