"""Asleep, waking, running, falling asleep: who is late, stops with others or alone, and what is told of it."""

import random
from itertools import pairwise

import networks
import pytest
from amount import amount
from networks import causes, run, traffic

#: Two buses; ECUs and their messages, as (identifier, cycle [ms]).
NETWORK = {
    "drive": {
        "Engine": [(0x100, 10), (0x101, 100)], "Gears": [(0x110, 20), (0x111, 100)],
        "Brakes": [(0x120, 20), (0x121, 50)], "Steering": [(0x130, 10), (0x131, 50)],
        "Climate": [(0x140, 200), (0x141, 100)],
    },
}  # fmt: skip
SLEEPS = "health = { sleeps = true }"
SEEDS = range(amount(40, 3))


def config_of(folder, health=SLEEPS, power=""):
    return networks.config_of(folder, NETWORK, 5.0, power, health)


def drawn(rng, span_s):
    return {ecu: rng.uniform(0, span_s) for ecu in NETWORK["drive"]}


def activities(events):
    return [(e["before"], e["activity"]) for e in events if e["event"] == "activity"]


@pytest.mark.evidence("Healthy parts: start")
@pytest.mark.parametrize("seed", SEEDS)
def test_ecus_that_start_late_are_not_missing(tmp_path, seed):
    """The gateway starts 8 s before the car, or with it; nothing of that is in the configuration."""
    rng = random.Random(seed)
    late = drawn(rng, rng.choice([1, 5, 10]))
    frames = traffic(NETWORK, rng, 40, lambda b, e, i, t: t >= late[e])
    for start_s in (-8.0, 0.0):
        codes, told, events = run(config_of(tmp_path, ""), frames, 40, start_s=start_s)
        assert (codes, told, activities(events)) == (set(), [], [])


def test_a_message_that_never_comes_is_missing_after_its_time_to_wake(tmp_path):
    frames = traffic(
        NETWORK, random.Random(1), 30, lambda b, e, i, t: t > 2 and i != 0x121 and not (i == 0x120 and t > 9)
    )
    for start_s in (-8.0, 0.0):
        codes, _, events = run(config_of(tmp_path, ""), frames, 30, start_s=start_s)
        assert codes == {"drive.M120.timeout", "drive.M121.timeout"}
        at = {e["fault"]: e["t_ns"] * 1e-9 for e in reversed(events) if e["event"] == "dtc" and e["status"] & 1}
        assert at["drive.M121.timeout"] == pytest.approx(17.0, abs=0.1)
        assert at["drive.M120.timeout"] == pytest.approx(9.1, abs=0.1), "one that stops is found as fast as ever"


@pytest.mark.evidence("Healthy parts: parking")
@pytest.mark.parametrize("run_on_s", [2.0, 10.0], ids=["at once", "after-run"])
@pytest.mark.parametrize("seed", SEEDS)
def test_a_bus_that_falls_asleep_accuses_nobody(tmp_path, seed, run_on_s):
    """Ignition off: its ECUs stop one after the other, the bus sleeps, and wakes for another drive."""
    rng = random.Random(100 + seed)
    off, late = drawn(rng, 2.0), drawn(rng, 5.0)
    off |= dict.fromkeys(rng.sample([*off], 2), run_on_s)
    frames = traffic(NETWORK, rng, 60, lambda b, e, i, t: t < 8 + off[e] or t > 40 + late[e])
    codes, told, events = run(config_of(tmp_path), frames, 60)
    assert (codes, told) == (set(), [])
    steps = ["running", "falling asleep", "asleep", "waking", "running"]
    assert activities(events) == [*pairwise(steps)]


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("away_s", [2.0, 30.0], ids=["reboots", "dies"])
def test_an_ecu_that_stops_alone_is_told_on_a_bus_that_may_sleep(tmp_path, seed, away_s):
    rng = random.Random(200 + seed)
    dead = rng.choice([*NETWORK["drive"]])
    frames = traffic(NETWORK, rng, 20, lambda b, e, i, t: e != dead or not 8 < t < 8 + away_s)
    codes, told, events = run(config_of(tmp_path), frames, 20)
    assert codes == {f"drive.M{can_id:X}.timeout" for can_id, _ in NETWORK["drive"][dead]}
    assert activities(events) == []
    first = min(e["t_ns"] for e in events if e["event"] == "dtc") * 1e-9
    assert first < 8 + min(away_s, 3.0) + 0.3
    if away_s > 10:
        assert causes(told) <= {(f"ecu drive.{dead}",)}


@pytest.mark.parametrize("health", ["", SLEEPS])
@pytest.mark.parametrize("seed", SEEDS)
def test_a_bus_that_is_away_for_3_s_is_told(tmp_path, seed, health):
    """It has a slow sender, so that it is silent as a whole only after 10 s: no code, but an event."""
    rng = random.Random(500 + seed)
    network = {"drive": NETWORK["drive"] | {"Clock": [(0x1F0, 4000)]}}
    away = rng.uniform(8, 12)
    frames = traffic(network, rng, 40, lambda b, e, i, t: not away < t < away + 3)
    codes, told, events = run(networks.config_of(tmp_path, network, 5.0, health=health), frames, 40)
    assert (codes, told) == (set(), [])
    (asleep, waking, running) = [e for e in events if e["event"] == "activity"]
    assert (asleep["activity"], waking["activity"], running["activity"]) == ("asleep", "waking", "running")
    assert asleep["t_ns"] * 1e-9 == pytest.approx(away + 1.0, abs=0.1)
    assert waking["t_ns"] * 1e-9 == pytest.approx(away + 3.0, abs=0.1)


@pytest.mark.evidence("Healthy parts: cranking")
@pytest.mark.parametrize("seed", SEEDS)
def test_a_dip_while_cranking_accuses_nobody(tmp_path, seed):
    """Most ECUs are reset at once for less than 2 s; one alone would be told."""
    rng = random.Random(600 + seed)
    stays, dip = rng.choice([*NETWORK["drive"]]), rng.uniform(1.2, 1.9)
    frames = traffic(NETWORK, rng, 20, lambda b, e, i, t: e == stays or not 8 < t < 8 + dip)
    codes, told, events = run(config_of(tmp_path), frames, 20)
    assert (codes, told) == (set(), [])
    assert [one for _, one in activities(events)] in ([], ["falling asleep", "running"])


def test_terminal_15_says_that_nothing_falls_asleep(tmp_path):
    """While it is on, each sender is judged at once, and a silent bus is at fault."""
    power = '[power]\nawake = [{ signal = "drive.M100.Value", min = 1 }]\n'
    stops = {"Gears": 8.0, "Brakes": 9.0}
    frames = traffic(NETWORK, random.Random(3), 14, lambda b, e, i, t: t < stops.get(e, 14.0))
    codes, _, events = run(config_of(tmp_path, power=power), frames, 40)
    assert codes == {f"drive.M{i}.timeout" for i in (110, 111, 120, 121)} | {"drive.bus_silent"}
    assert min(e["t_ns"] for e in events if e["event"] == "dtc") * 1e-9 < 8.2
    assert activities(events) == [("running", "asleep")]


def several(rng, health, folder, stop, nobody=()):
    """Return the configuration, and frames in which messages stop at 8 s; ``nobody``: ECUs without a name."""
    network = {"drive": {"XXX" if e in nobody else e: NETWORK["drive"][e] for e in NETWORK["drive"]}}
    if nobody:
        network["drive"]["XXX"] = [each for e in nobody for each in NETWORK["drive"][e]]
    frames = traffic(network, rng, 24, lambda b, e, i, t: i not in stop or t < 8)
    return networks.config_of(folder, network, 5.0, health=health), frames


@pytest.mark.parametrize("health", ["", SLEEPS])
@pytest.mark.parametrize("seed", SEEDS)
def test_two_ecus_at_once_are_two_ecus(tmp_path, seed, health):
    rng = random.Random(300 + seed)
    dead = rng.sample([*NETWORK["drive"]], 2)
    stop = {can_id for ecu in dead for can_id, _ in NETWORK["drive"][ecu]}
    config, frames = several(rng, health, tmp_path, stop)
    codes, told, _ = run(config, frames, 24)
    assert codes == {f"drive.M{can_id:X}.timeout" for can_id in stop}
    assert {frozenset(g["cause"]) for g in told[-1]["groups"]} == {frozenset({f"ecu drive.{ecu}"}) for ecu in dead}
    assert not [one for one in causes(told) if "bus drive" in one]


@pytest.mark.parametrize("health", ["", SLEEPS])
@pytest.mark.parametrize("seed", SEEDS)
def test_an_ecu_that_no_database_names_is_no_bus(tmp_path, seed, health):
    """Others are heard at their rate, so that the bus is well; what stopped is told as one group."""
    rng = random.Random(400 + seed)
    dead = rng.choice(["Engine", "Brakes"])
    stop = {can_id for can_id, _ in NETWORK["drive"][dead]}
    config, frames = several(rng, health, tmp_path, stop, [*NETWORK["drive"]])
    _, told, _ = run(config, frames, 24)
    (group,) = told[-1]["groups"]
    assert set(group["failed"]) == {f"drive.M{can_id:X}.timeout" for can_id in stop}
    assert group["cause"] == ["ecu drive.unnamed"]
    assert not [one for one in causes(told) if "bus drive" in one]
