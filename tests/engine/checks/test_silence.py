"""Sleep, wake, recorder pauses, ECUs and buses that are cut off: one cause each, and no code of any other."""

import random

import networks
import numpy as np
import pytest
from amount import amount
from networks import causes, run

from gateway.bus.conditions import LOSS, condition_frame

#: Buses -> ECUs -> their messages, as (identifier, cycle [ms]).
NETWORK = {
    "drive": {"Engine": [(0x100, 10), (0x101, 20), (0x102, 100)], "Gears": [(0x110, 20), (0x111, 50)]},
    "body": {"Doors": [(0x200, 50), (0x201, 200)], "Lights": [(0x210, 100), (0x211, 1000)]},
}
#: Timeouts in cycles.
TIMEOUT = 2.5


def of(buses):
    """Return the part of the network that is on some buses."""
    return {bus: NETWORK[bus] for bus in buses}


def config_of(folder, buses, power=""):
    return networks.config_of(folder, of(buses), TIMEOUT, power)


def traffic(buses, *rest):
    return networks.traffic(of(buses), *rest)


SEEDS = range(amount(40, 4))


@pytest.mark.evidence("Healthy parts: sleep")
@pytest.mark.parametrize("seed", SEEDS)
def test_a_bus_that_sleeps_at_any_time_and_wakes_late_is_one_cause(tmp_path, seed):
    """Its ECUs wake 0 to 10 s late, each message a while after its ECU; before, all fall silent at once."""
    rng = random.Random(seed)
    config = config_of(tmp_path, ["drive"])
    sleeps, wakes = 5.0 + rng.uniform(0, 5), 15.0 + rng.uniform(0, 60)
    late = {ecu: rng.choice([0.0, rng.uniform(0, 10)]) for ecu in NETWORK["drive"]}
    frames = traffic(["drive"], rng, wakes + 40, lambda b, e, i, t: t < sleeps or t >= wakes + late[e])
    codes, told, _ = run(config, frames, wakes + 40)
    assert codes == {"drive.bus_silent"}
    assert causes(told) == {("bus drive",)}
    assert told[-1]["groups"] == []


@pytest.mark.evidence("Healthy parts: recorder")
@pytest.mark.parametrize("seed", SEEDS)
def test_a_recorder_that_pauses_accuses_nobody(tmp_path, seed):
    """All buses pause, for 10 ms to 20 s, again and again: nothing is at fault, not even a bus."""
    rng = random.Random(100 + seed)
    config = config_of(tmp_path, ["drive", "body"])
    pauses = [(t, t + 10 ** rng.uniform(-2, 1.3)) for t in (4, 30, 60, 66, 90)]
    frames = traffic(["drive", "body"], rng, 120, lambda b, e, i, t: not any(a <= t < z for a, z in pauses))
    codes, told, _ = run(config, frames, 120)
    assert codes == set()
    assert told == []


@pytest.mark.parametrize("seed", SEEDS)
def test_an_ecu_that_is_cut_off_is_one_cause_with_its_messages(tmp_path, seed):
    rng = random.Random(200 + seed)
    buses = ["drive", "body"]
    config = config_of(tmp_path, buses)
    bus, dead = rng.choice([(bus, ecu) for bus, ecus in NETWORK.items() for ecu in ecus])
    cut = rng.uniform(3, 8)
    frames = traffic(buses, rng, 30, lambda b, e, i, t: e != dead or t < cut)
    codes, told, events = run(config, frames, 30)
    assert codes == {f"{bus}.M{can_id:X}.timeout" for can_id, _ in NETWORK[bus][dead]}
    assert causes(told) == {(f"ecu {bus}.{dead}",)}
    _, _, live = run(config, frames, 30, step_s=0.0173)
    assert [e for e in live if e["event"] in ("dtc", "diagnosis")] == [
        e for e in events if e["event"] in ("dtc", "diagnosis")
    ]


@pytest.mark.parametrize("seed", SEEDS)
def test_an_ecu_whose_critical_half_stops_is_the_cause(tmp_path, seed):
    rng = random.Random(300 + seed)
    config = config_of(tmp_path, ["drive", "body"])
    stopped = {0x100, 0x101}
    frames = traffic(["drive", "body"], rng, 20, lambda b, e, i, t: i not in stopped or t < 5)
    codes, told, _ = run(config, frames, 20)
    assert codes == {"drive.M100.timeout", "drive.M101.timeout"}
    assert causes(told) == {("ecu drive.Engine",)}


@pytest.mark.evidence("Healthy parts: cut bus")
@pytest.mark.parametrize("seed", SEEDS)
def test_a_bus_that_is_cut_off_is_one_cause(tmp_path, seed):
    rng = random.Random(400 + seed)
    buses = ["drive", "body"]
    config = config_of(tmp_path, buses)
    dead, cut, back = rng.choice(buses), rng.uniform(3, 8), rng.uniform(15, 25)
    frames = traffic(buses, rng, 50, lambda b, e, i, t: b != dead or t < cut or t > back)
    codes, told, _ = run(config, frames, 50)
    assert codes == {f"{dead}.bus_silent"}
    assert causes(told) == {(f"bus {dead}",)}
    assert told[-1]["groups"] == []


def test_who_does_not_wake_is_told_after_its_time(tmp_path):
    """Nobody waits for ever: after 15 s the ECU that is still away is the cause."""
    rng = random.Random(7)
    config = config_of(tmp_path, ["drive"])
    frames = traffic(["drive"], rng, 60, lambda b, e, i, t: t < 5 or (t >= 20 and e == "Gears"))
    codes, told, events = run(config, frames, 60)
    assert codes == {"drive.bus_silent", *(f"drive.M{can_id:X}.timeout" for can_id in (0x100, 0x101, 0x102))}
    first = min(e["t_ns"] for e in events if e["event"] == "dtc" and e["fault"] == "drive.M100.timeout")
    assert 34.9e9 < first < 35.2e9
    assert told[-1]["groups"][0]["cause"] == ["ecu drive.Engine"]


AWAKE = """[power]
awake = [{ signal = "drive.M102.Value", min = 1 }]
"""


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("is_on", [True, False], ids=["terminal 15 on", "off"])
def test_power_tells_sleep_from_a_cut(tmp_path, seed, is_on):
    """Terminal 15, sent on the bus itself: off before it is silent, ECUs fall asleep one by one, or on to the end."""
    rng = random.Random(500 + seed)
    config = config_of(tmp_path, ["drive"], AWAKE)
    off = 6.0
    silent = {ecu: off + rng.uniform(0.2, 4) for ecu in NETWORK["drive"]}
    wakes = {ecu: 40 + rng.uniform(0, 10) for ecu in NETWORK["drive"]}
    if is_on:
        silent = dict.fromkeys(silent, 8.0)
    frames = traffic(
        ["drive"], rng, 80, lambda b, e, i, t: t < silent[e] or t > wakes[e],
        lambda i, t: int(is_on or not off <= t < 40),
    )  # fmt: skip
    codes, told, _ = run(config, frames, 80)
    assert codes == ({"drive.bus_silent"} if is_on else set())
    assert causes(told) == ({("bus drive",)} if is_on else set())


@pytest.mark.evidence("Healthy parts: low voltage")
def test_under_a_low_voltage_nobody_is_accused(tmp_path):
    """While the engine starts, other ECUs reset; after the voltage is good again they have time to come."""
    power = """[power]
voltage = { signal = "drive.M102.Value", min = 90 }
"""
    rng = random.Random(1)
    config = config_of(tmp_path, ["drive", "body"], power)
    frames = traffic(
        ["drive", "body"], rng, 40, lambda b, e, i, t: e == "Engine" or not 5.1 <= t < 10.0,
        lambda i, t: 60 if 5.0 <= t < 6.0 else 120,
    )  # fmt: skip
    assert run(config, frames, 40)[:2] == (set(), [])
    without = config_of(tmp_path, ["drive", "body"])
    assert run(without, frames, 40)[0]


# A reload, and frames that were lost here -----------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(amount(40, 3)))
def test_a_reload_during_a_silence_changes_nothing(tmp_path, seed):
    """While a bus is silent, before that is told or behind it: the same codes and the same cause."""
    rng = random.Random(600 + seed)
    config = config_of(tmp_path, ["drive", "body"])
    cut, back = rng.uniform(3, 8), rng.uniform(14, 20)
    frames = traffic(["drive", "body"], rng, 40, lambda b, e, i, t: b != "drive" or t < cut or t > back)
    whole = run(config, frames, 40, step_s=0.05)
    times = [round(cut + rng.uniform(0.0, 0.5), 3), round(cut + rng.uniform(0.6, 5.0), 3)]
    again = run(config, frames, 40, step_s=0.05, changes=[(t, config) for t in times])
    assert whole[0] == again[0] == {"drive.bus_silent"}
    assert causes(whole[1]) == causes(again[1]) == {("bus drive",)}
    assert again[1][-1]["groups"] == []


@pytest.mark.parametrize("seed", range(amount(40, 3)))
def test_a_loss_while_a_timeout_waits_accuses_nobody(tmp_path, seed):
    """All buses pause; in the pause frames were lost here, too: nothing says that a sender was away."""
    rng = random.Random(700 + seed)
    config = config_of(tmp_path, ["drive", "body"])
    begin = rng.uniform(3, 8)
    end = begin + rng.uniform(0.05, 3.0)
    frames = traffic(["drive", "body"], rng, 20, lambda b, e, i, t: not begin <= t < end)
    at_ns = round((begin + rng.uniform(0.1, 0.9) * (end - begin)) * 1e9)
    frames = np.concatenate([frames, *(condition_frame(at_ns, bus, LOSS, 5) for bus in range(2))])
    codes, told, _ = run(config, frames[np.argsort(frames["t_ns"], kind="stable")], 20)
    assert {code.rpartition(".")[2] for code in codes} <= {"bus_overflow"}  # that is the gateway's own
    assert told == []
