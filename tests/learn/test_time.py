"""Time as it is: pauses of the bus are no message's, lost frames are not "on change", late ECUs have their time."""

import random
from types import SimpleNamespace

import numpy as np
import pytest
from command import command
from learning import as_before, asked, drive, quiet

from gateway.bus.frames import empty, put
from gateway.bus.logs import LogReader, open_writer
from gateway.config.load import load_config
from gateway_bench.wire.replay import through
from gateway_fleet.cli.learn import learn_car
from gateway_fleet.learn.gaps import CYCLIC, Gaps, lost_share, most, sending, timeout_ms
from gateway_fleet.learn.learn import learn, write
from gateway_fleet.learn.limits import _ended
from gateway_fleet.learn.lines import CHECK
from gateway_replay.channels import channels_of

MS = 1_000_000
IDS = (256, 512, 768, 1024)
DBC = 'VERSION ""\nNS_ :\nBS_:\nBU_: A B C D\n' + "".join(
    f'BO_ {can_id} M{k}: 2 {"ABCD"[k]}\n SG_ X{k} : 0|8@1+ (1,0) [0|255] "" A\n' for k, can_id in enumerate(IDS)
)


def lines_of(log, keep, rng):
    """Keep lines of a log by their time after its begin [s] and identifier."""
    kept = []
    for line in log.read_text().splitlines():
        t, can_id = float(line[1:].split(")")[0]) - 1000.0, int(line.split()[2].split("#")[0], 16)
        if keep(t, can_id, rng):
            kept.append(line)
    log.write_text("\n".join(kept) + "\n")
    return log


def learned(tmp_path, keep, seed=1, seconds=60.0):
    rng = random.Random(seed)
    (tmp_path / "car.dbc").write_text(DBC)
    periods = (0.01, 0.02, 0.05, 0.1)
    messages = [
        (can_id, p, lambda k: bytes([k % 7, 0]), 0.001 * n)
        for n, (can_id, p) in enumerate(zip(IDS, periods, strict=True))
    ]
    log = lines_of(drive(tmp_path / "drive.log", seconds, messages, rng), keep, rng)
    result = learn(asked(tmp_path / "car.toml", log, databases=(tmp_path / "car.dbc",)), quiet)
    write(result.files(tmp_path / "car.toml"))
    return log, result, {place[2]: line.keys for place, line in result.learned.lines.items() if place[1] == CHECK}


def test_a_pause_of_the_whole_bus_deletes_no_timeout_and_is_told(tmp_path):
    log, _, keys = learned(tmp_path, lambda t, _id, _rng: not 20.0 < t < 35.0)
    limits = [keys[f"M{k}"]["timeout_ms"] for k in range(4)]
    assert limits == sorted(limits)
    assert limits[0] <= 100
    assert limits[3] <= 1000
    assert not any("wake_ms" in each for each in keys.values()), "all came within their cycle: the recorder paused"
    as_before("paused.toml", (tmp_path / "car.toml").read_text(), tmp_path)
    config = load_config(tmp_path / "car.toml")
    assert config.bus[0].health.sleeps
    said = through(config, list(LogReader(log, channels_of(config, ()))))
    assert [fault for _, fault, failed in said.dtcs if failed and "timeout" in fault] == []


@pytest.mark.parametrize("seed", [3, 4])
def test_lost_frames_are_estimated(tmp_path, seed):
    _, _, keys = learned(tmp_path, lambda _t, _id, rng: rng.random() > 0.04, seed)
    assert all("timeout_ms" in each for each in keys.values()), keys
    rng = np.random.default_rng(seed)
    stamps = np.cumsum(rng.uniform(9.5, 10.5, 20000)) * MS
    for lost in (0.0, 0.01, 0.04, 0.1):
        gaps = Gaps()
        gaps.add(stamps[rng.random(len(stamps)) >= lost].astype(np.int64))
        assert sending(gaps) == CYCLIC
        assert lost_share(gaps) == pytest.approx(lost, abs=0.006), f"seed {seed}"
        assert 50 <= timeout_ms(gaps) <= 200
    jitter = Gaps()
    jitter.add(np.sort(np.arange(20000) * 10 * MS + rng.uniform(0, 9 * MS, 20000)).astype(np.int64))
    assert lost_share(jitter) == 0.0, "late frames are no lost ones"


def test_an_ecu_that_wakes_late_has_its_time(tmp_path):
    """M3 comes 5 s after each wake-up, at the log's begin and after 15 s of sleep; another log is silent, too."""

    def keep(t, can_id, _rng):
        awake = t < 18.0 or t >= 33.0
        return awake and not (can_id == IDS[3] and (t < 5.0 or 33.0 <= t < 38.0))

    log, result, keys = learned(tmp_path, keep)
    assert result.alarms == ()
    assert result.changes == []
    assert keys["M3"]["wake_ms"] >= 10_000
    assert keys["M3"]["timeout_ms"] <= 1000, "that it wakes late says nothing of its cycle"
    assert keys["M0"]["wake_ms"] >= 15_000, "one wake-up says little: it has the bus's own time"
    config = load_config(tmp_path / "car.toml")
    silent = lines_of(log, lambda t, can_id, _rng: not (can_id == IDS[3] and t > 45.0), None)
    said = through(config, list(LogReader(silent, channels_of(config, ()))))
    assert [fault for _, fault, failed in said.dtcs if failed and "timeout" in fault] == ["M3.timeout"]


def test_a_message_that_is_still_asleep_where_the_held_out_part_begins_has_not_ended(tmp_path):
    def keep(t, can_id, _rng):
        return (t < 25.0 or t >= 40.0) and not (can_id == IDS[3] and (t < 5.0 or 25.0 <= t < 48.0))

    _, result, keys = learned(tmp_path, keep)
    assert 40.0 < result.observation.logs[0].seconds < 48.0
    assert keys["M3"]["timeout_ms"] <= 1000
    assert result.alarms == ()
    assert result.changes == []


def test_what_an_update_drops_is_told(tmp_path):
    """A second drive in which a message comes when it likes: its timeout goes, and a line says so."""
    learned(tmp_path, lambda _t, _id, _rng: True)
    (tmp_path / "car.toml").unlink()
    more = {"buses": (), "hold_out": 0.3, "maps": (), "pgn": False, "seed": 1, "json": False, "ecu": None} | {
        "false_per_hour": 1e-3
    }
    out = tmp_path / "car.toml"
    learn_car([tmp_path / "car.dbc", tmp_path / "drive.log"], out=out, update=False, force=False, **more)
    rng = random.Random(8)
    stamps = np.cumsum([rng.expovariate(1.0) for _ in range(600)])
    text = [f"({1000 + t:.6f}) can0 400#0100" for t in stamps]
    (tmp_path / "second.log").write_text("\n".join(text) + "\n")
    result = learn(asked(out, tmp_path / "second.log", databases=(tmp_path / "car.dbc",), update=True), quiet)
    assert [line for line in result.dropped if "M3" in line and "timeout_ms" in line], result.dropped
    assert not any("M0" in line for line in result.dropped)


@pytest.mark.parametrize(("ended_s", "ended"), [(2.9, False), (3.1, True)])
def test_a_message_has_ended_that_stopped_three_of_its_longest_gaps_before_its_log(ended_s, ended):
    seen = SimpleNamespace(ended_s=ended_s, gaps=SimpleNamespace(largest_ns=10**9))
    assert _ended(seen) is ended
    assert not _ended(SimpleNamespace(ended_s=1.9, gaps=SimpleNamespace(largest_ns=10**7))), "two seconds at least"


def crowded(stamps, limit):
    """Return whether more frames than the limit come in one of its windows."""
    row = int(limit["frames"])
    return bool(((stamps[row:] - stamps[:-row]) < limit["ms"] * MS).any())


@pytest.mark.parametrize("repeated", [0.0, 1.0])
@pytest.mark.parametrize("period", [0.01, 0.024, 0.1, 0.5, 1.0])
def test_the_rate_of_a_cyclic_message_is_limited_with_room_for_queues_and_none_for_a_second_sender(period, repeated):
    seed = 4711
    rng = np.random.default_rng(seed)
    sent = np.arange(round(max(120.0, 60 * period) / period)) * period
    late = np.where(rng.random(len(sent)) < 0.1, rng.uniform(0.0, min(0.05, period), len(sent)), 0.0)
    stamps = np.rint(np.maximum.accumulate(sent + late) * 1e9).astype(np.int64)
    gaps = Gaps()
    for part in np.array_split(stamps, 7):
        gaps.add(part)
    limit = most(gaps, repeated)
    assert limit is not None
    assert limit["cycle_ms"] == pytest.approx(1000.0 * period, rel=0.02)
    assert limit.get("repeats", False) == (period > 0.09 and repeated == 1.0), "slow ones may be sent at a change"
    assert not crowded(stamps, limit), f"seed {seed}"
    host = stamps + rng.integers(0, 200 * MS, len(stamps))  # a host that is up to 0.2 s late
    assert not crowded(np.sort(host), limit), f"seed {seed}"
    if period > 0.09 and repeated == 1.0:
        asked = sent[40:42] + 0.4 * period  # two buttons, one after the other: the same content is sent at once
        assert not crowded(np.sort(np.concatenate([stamps, np.rint(asked * 1e9).astype(np.int64)])), limit)
    both = np.sort(np.concatenate([stamps, stamps + round(0.3e9 * period)]))
    assert crowded(both, limit), f"seed {seed}"
    kept = Gaps.of(gaps.data())
    assert most(kept, repeated) == limit
    kept.join(gaps)
    assert most(kept, repeated)["frames"] == limit["frames"]


def test_no_rate_is_limited_where_nothing_says_it():
    """Frames on change, too few of them, and what an earlier version kept."""
    rng = np.random.default_rng(4712)
    gaps = Gaps()
    gaps.add(np.cumsum(rng.exponential(0.05e9, 2000)).astype(np.int64))
    assert most(gaps, 1.0) is None
    few = Gaps()
    few.add(np.arange(24) * 1000 * MS)
    assert most(few, 1.0) is not None, "three rows of eight"
    assert most(few, 0.0) is None, "one of sixteen"
    data = few.data()
    del data["spans_ns"], data["counted"]
    assert most(Gaps.of(data), 1.0) is None


def mixed(path, seconds, rng, *, buttons=(), twice=(), lost=0.0, skips=0.0):
    """Write a log: three counters, and a message each second, which comes at once where its content changes, too."""
    rows = [
        (round((0.003 * k + 0.01 * cycle * n) * 1e9), can_id, bytes([n % modulus, 0, n % 7]))
        for k, (can_id, cycle, modulus) in enumerate(((0x100, 1, 4), (0x110, 2, 16), (0x120, 2, 256)))
        for n in range(int(seconds * 100 / cycle))
    ]
    events = sorted([*(k + 0.05 for k in range(int(seconds))), *buttons, *twice])
    pressed = [sum(t <= now for t in buttons) for now in events]
    rows += [(round(now * 1e9), 0x439, bytes([n, 0])) for now, n in zip(events, pressed, strict=True)]
    kept = [row for row in sorted(rows) if rng.random() >= (skips if row[1] == 0x110 else 0.0) + lost]
    frames = empty(len(kept))
    for at, (t_ns, can_id, data) in enumerate(kept):
        put(frames, at, 1_000_000_000_000 + t_ns, can_id, data)
    with open_writer(path) as writer:
        writer.write(frames)
    return path


def test_mixed_senders_and_lost_frames_are_no_second_sender(tmp_path, capsys, monkeypatch):
    """Learned of a quiet drive: buttons, and a bus that loses each third frame; a sender that skips is told."""
    rng, out = np.random.default_rng(11), tmp_path / "car.toml"
    quiet = mixed(tmp_path / "quiet.log", 40.0, rng)
    assert command(capsys, monkeypatch, "learn", quiet, "-o", out).code == 0

    def told(name, **how):
        log = mixed(tmp_path / f"{name}.log", 40.0, rng, **how)
        ended = command(capsys, monkeypatch, "replay", log, "-c", out, "--json")
        kinds = {event["fault"] for event in ended.events if event["event"] in ("dtc", "security") and "fault" in event}
        return kinds, any(event["event"] == "security" for event in ended.events)

    assert told("buttons", buttons=[4.2, 4.9, 7.4, 9.1, 9.6, 9.7, 9.8]) == (set(), False)
    assert told("twice", twice=[k + 0.6 for k in range(10, 20)]) == ({"can0.ID_439.early"}, True)
    kinds, security = told("lost", lost=0.3)
    assert {kind.rpartition(".")[2] for kind in kinds} <= {"timeout"}
    assert not security
    assert "can0.ID_110.counter" in told("skips", skips=0.2)[0]


def test_a_fault_in_the_learning_drive_is_told(tmp_path, capsys, monkeypatch):
    """A checksum wrong in a quarter of the frames, a message gone, one frozen, one sent twice; a healthy drive."""
    rng = np.random.default_rng(5)
    moves = rng.integers(0, 256, (2000, 4))

    def summed(can_id, k, wrong):
        data = [*moves[k % 2000].tolist(), k % 16]
        return bytes([*data, (sum(data) + 6 + (can_id >> 8) + (can_id & 0xFF) + wrong) & 0xFF])

    def told(name, faulty):
        rows = []
        for k in range(2000):
            t_ns, away = round(k * 10e6), faulty and 500 <= k < 900
            rows.append((t_ns, 0x101, summed(0x101, k, faulty and k % 4 == 0)))
            rows += [] if away else [(t_ns + MS, 0x102, summed(0x102, k, 0))]
            rows.append((t_ns + 2 * MS, 0x103, summed(0x103, 500 if away else k, 0)))
            rows += [(t_ns + (3 + 5 * n) * MS, 0x104, summed(0x104, k, 0)) for n in range(1 + away)]
            rows.append((t_ns + 4 * MS, 0x105, summed(0x105, k, 0)))
        frames = empty(len(rows))
        for at, (t_ns, can_id, data) in enumerate(sorted(rows)):
            put(frames, at, 1_000_000_000_000 + t_ns, can_id, data)
        with open_writer(tmp_path / f"{name}.log") as writer:
            writer.write(frames)
        out = tmp_path / f"{name}.toml"
        said = command(capsys, monkeypatch, "learn", tmp_path / f"{name}.log", "-o", out).out
        return said, out.with_suffix(".md").read_text()

    said, page = told("faulty", faulty=True)
    for text in (
        "can0.ID_101: toyota is right in ",
        "can0.ID_102: gone for 4.0 s while others came",
        "can0.ID_103: frozen for 4.0 s",
        "can0.ID_104: sent twice as often as its cycle for ",
    ):
        assert f"FAULT IN WHAT WAS LEARNED FROM? {text}" in said
        assert text in page
    assert said.count("FAULT IN") == 4
    assert "FAULT IN" not in told("healthy", faulty=False)[0]


def test_what_comes_every_few_hours_has_no_limit_that_no_check_may_have(tmp_path):
    """A timeout of days, and a rate in hours, were written into a file that `gateway check` refused."""
    log = drive(tmp_path / "drive.log", 150_000.0, [(0x100, 7200.0, lambda k: bytes([k & 0xFF]), 0.0)])
    result = learn(asked(tmp_path / "car.toml", log, databases=()), quiet)
    write(result.files(tmp_path / "car.toml"))
    config = load_config(tmp_path / "car.toml")
    assert [check.timeout_ms for check in config.bus[0].check if check.message == "ID_100"] in ([None], [])
