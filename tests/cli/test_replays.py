"""``gateway replay`` of several logs: as one after the other, whoever does them."""

import json
import random
import re

import pytest
from command import command
from own_message import DBC

CONFIG = """
[[bus]]
name = "chassis"
uri = "socketcan:can0"
database = ["own.dbc"]

[[bus.check]]
message = "M0"
timeout_ms = 100.0
"""


@pytest.fixture
def gateway(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "own.dbc").write_text(DBC)
    (tmp_path / "car.toml").write_text(CONFIG)
    return lambda *arguments: command(capsys, monkeypatch, *arguments)


def write_log(path, rng):
    """A log with up to three silences, which may be damaged, cut off, empty, or of another bus."""
    name = rng.choice(["can0"] * 4 + ["vcan7"])
    silences = {rng.randrange(10, 80) for _ in range(rng.randrange(4))}
    t, lines = rng.uniform(1e9, 2e9), []
    for k in range(rng.choice([0, 90, 90, 90])):
        t += 0.01 + (1.0 if k in silences else 0.0)
        lines.append(f"({t:.6f}) {name} 100#0000000000000000\n")
    if lines and rng.random() < 0.2:
        lines[rng.randrange(len(lines))] = "nonsense\n"
    text = "".join(lines)
    path.write_text(text[:-4] if rng.random() < 0.2 else text)


def same(text):
    """Return lines without how long it took."""
    text = re.sub(r'"(seconds|frames_per_s)": [0-9.e+-]+', r'"\1": 0', text)
    return re.sub(r"in [0-9.]+ s \([0-9,]+ frames/s\)", "", text)


@pytest.mark.long
@pytest.mark.system
@pytest.mark.parametrize(("form", "by"), [(("--json", "--fail-on-dtc"), ("1", "2")), ((), ("0",))])
def test_several_logs_are_as_one_after_the_other(gateway, tmp_path, form, by):
    seed = random.randrange(1 << 30)
    print("seed", seed)
    rng = random.Random(seed)
    logs = [f"{k}.log" for k in range(8)]
    for log in logs:
        write_log(tmp_path / log, rng)
    singles = [gateway("replay", log, "-c", "car.toml", *form) for log in logs]
    said = []
    for log, single in zip(logs, singles, strict=True):
        if form:
            said += [json.dumps({**event, "log": log}) + "\n" for event in single.events]
        else:
            said.append(f"{log}:\n{single.out}")
    progress = re.compile(r"^\d+ of 8 logs\n", re.MULTILINE)
    for jobs in by:
        ended = gateway("replay", *logs, "-c", "car.toml", "--jobs", jobs, *form)
        assert same(ended.out) == same("".join(said)), jobs
        assert progress.sub("", ended.err) == "".join(single.err for single in singles), jobs
        assert ended.code == max(single.code for single in singles), jobs


def test_a_file_for_one_log_is_refused_for_several(gateway, tmp_path):
    for name in ("a.log", "b.log"):
        write_log(tmp_path / name, random.Random(1))
    for option in ("--memory", "--html", "--signals", "--plot", "--junit"):
        ended = gateway("replay", "a.log", "b.log", "-c", "car.toml", option, "x")
        assert ended.code == 2
        assert f"{option} = 'x': of one log, and here are 2" in ended.err
    assert not (tmp_path / "x").exists()


def test_each_log_has_a_memory_of_its_own(gateway, tmp_path):
    lines = [f"({k / 100 + (1 if k > 30 else 0):.6f}) can0 100#0000000000000000\n" for k in range(60)]
    (tmp_path / "a.log").write_text("".join(lines))
    ended = gateway("replay", "a.log", "a.log", "-c", "car.toml", "--json")
    failures = [event for event in ended.events if event["event"] == "dtc" and event["status"] & 1]
    assert [event["occurrence"] for event in failures] == [1, 1]
    assert {event["log"] for event in ended.events} == {"a.log"}


@pytest.mark.long
@pytest.mark.system
@pytest.mark.full("12 s: fleet/test_workers.py has the same workers")
def test_a_log_that_kills_its_process_is_told(gateway, tmp_path, monkeypatch):
    """A monitor of the user's that ends its process at a value."""
    (tmp_path / "poison.py").write_text(
        "import os, signal\n"
        "from gateway_replay.cli import replays\n"
        "before = getattr(replays, 'before', replays.replay)\n"
        "replays.before = before\n"
        "def replay(log, *rest, **options):\n"
        "    if log.name == 'poison.log':\n"
        "        os.kill(os.getpid(), signal.SIGKILL)\n"
        "    return before(log, *rest, **options)\n"
        "replays.replay = replay\n"
    )
    import dask
    import distributed  # noqa: F401 - its settings are there before the test changes one

    for name in ("a.log", "poison.log", "b.log"):
        write_log(tmp_path / name, random.Random(5))
    expected = gateway("replay", "a.log", "-c", "car.toml")
    with dask.config.set({"distributed.worker.preload": [str(tmp_path / "poison.py")]}):
        ended = gateway("replay", "a.log", "poison.log", "b.log", "-c", "car.toml", "--jobs", "2")
    assert ended.code == 70
    assert "poison.log: its process died of it, alone" in ended.err
    assert same(f"a.log:\n{expected.out}") in same(ended.out)
    assert same(f"b.log:\n{expected.out}") in same(ended.out)
