"""Asleep, waking, running, falling asleep: who is late, stops with others or alone, and what is told of it."""

import random
from itertools import pairwise

import networks
import numpy as np
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
RATE = "most = {{ frames = 80, ms = {window}, cycle_ms = {cycle} }}\nlength = 8\n"
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


def test_ecus_that_wake_late_are_no_lost_frames(tmp_path):
    """The rate was weighed over the time before they came, and over the sleep."""
    rng = random.Random(20)
    late = drawn(rng, 5.0)
    frames = traffic(NETWORK, rng, 50, lambda b, e, i, t: late[e] < t < 10 or t > 40 + late[e])
    config = networks.config_of(tmp_path, NETWORK, 5.0, health=SLEEPS, check=RATE)
    codes, told, events = run(config, frames, 50)
    assert (codes, told) == (set(), [])
    assert [e for e in events if e["event"] == "lossy"] == []


def test_a_message_that_comes_twelve_times_too_seldom_is_told(tmp_path):
    """Each time it stops for less than an engine takes to crank, and comes again before the bus has settled."""
    frames = traffic(
        NETWORK, random.Random(23), 30, lambda b, e, i, t: i != 0x110 or t < 8 or round(t / 0.02) % 12 == 0
    )
    codes, told, _ = run(config_of(tmp_path), frames, 30)
    assert codes == {"drive.M110.timeout"}
    assert causes(told) <= {("message drive.M110",), ("ecu drive.Gears",)}


def test_a_bus_wakes_where_its_frames_come_in_batches(tmp_path):
    """At each look the bus is silent since the batch before, and its fastest messages are late."""
    frames = traffic(NETWORK, random.Random(21), 40, lambda b, e, i, t: t < 8 or t > 20)
    frames["t_ns"] = (frames["t_ns"] // 50_000_000 + 1) * 50_000_000
    codes, told, events = run(config_of(tmp_path), frames, 40)
    assert (codes, told) == (set(), [])
    assert activities(events)[-1] == ("waking", "running")


def test_ecus_that_stop_apart_while_others_still_wake_are_switched_off(tmp_path):
    from_s, until_s = {"Steering": 2.0, "Climate": 4.4}, {"Engine": 1.3, "Gears": 3.0}
    frames = traffic(NETWORK, random.Random(22), 30, lambda b, e, i, t: from_s.get(e, 0.0) <= t < until_s.get(e, 30.0))
    codes, told, _ = run(config_of(tmp_path), frames, 30)
    assert (codes, told) == (set(), [])


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
    assert causes(told) == {(f"ecu drive.{dead}",)}


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


@pytest.mark.parametrize(("away_s", "again_s"), [(0.2, 0.1), (0.7, 0.1), (1.1, 0.1), (0.7, 0.7)])
def test_an_ecu_that_starts_again_while_cranking_is_told_only_where_it_takes_long(tmp_path, away_s, again_s):
    """A flat battery: the supply dips for a moment at the start of the engine, and once more when it fires."""
    frames = traffic(
        NETWORK,
        random.Random(7),
        20,
        lambda b, e, i, t: e != "Engine" or not (8 < t < 8 + away_s or 15 < t < 15 + again_s),
    )
    codes, told, _ = run(config_of(tmp_path), frames, 20)
    assert codes == ({"drive.M100.timeout", "drive.M101.timeout"} if max(away_s, 2 * again_s) > 1.0 else set())
    assert causes(told) <= {("ecu drive.Engine",), ("message drive.M100",)}


@pytest.mark.evidence("Healthy parts: lost frames")
@pytest.mark.parametrize("share", [0.05, 0.3])
def test_frames_that_get_lost_everywhere_are_told_and_accuse_nobody(tmp_path, share):
    """Lost in turn with good times; an ECU that is reset meanwhile is told."""
    rng = random.Random(round(100 * share))
    frames = traffic(NETWORK, rng, 36, lambda b, e, i, t: t % 20 < 8 or rng.random() > share)
    codes, told, events = run(config_of(tmp_path), frames, 36)
    assert (codes, told) == (set(), [])
    lossy = [e for e in events if e["event"] == "lossy"]
    assert [e["lossy"] for e in lossy] == [True, False, True]
    assert lossy[0]["t_ns"] * 1e-9 == pytest.approx(10, abs=3)
    assert lossy[0]["share"] == pytest.approx(share, rel=0.5)
    stamps = frames["t_ns"] * 1e-9
    gone = np.isin(frames["can_id"], (0x100, 0x101)) & (stamps > 16) & (stamps < 18)
    assert "drive.M100.timeout" in run(config_of(tmp_path), frames[~gone], 36)[0]


@pytest.mark.evidence("Healthy parts: lost frames")
@pytest.mark.parametrize("share", [0.03, 0.1, 0.3])
@pytest.mark.parametrize("seed", [902, 907])
def test_a_bus_that_loses_frames_falls_asleep_as_any_other(tmp_path, seed, share):
    """Ignition off: one ECU stops at once, others 2.5 and 5 s later, two run on."""
    rng = random.Random(seed)
    off = dict(zip(rng.sample([*NETWORK["drive"]], 5), (0.0, 2.5, 5.0, 40.0, 40.0), strict=True))
    frames = traffic(NETWORK, rng, 40, lambda b, e, i, t: t < 8 + off[e] and rng.random() > share)
    codes, told, events = run(config_of(tmp_path), frames, 40)
    assert (codes, told) == (set(), [])
    assert ("running", "falling asleep") in activities(events)


#: Name -> network, when its ECUs stop [s], share of the frames that get lost. Others run on.
SWITCHED_OFF = {
    "most of the frames": (NETWORK, {"Engine": 8.0, "Steering": 8.9}, 0.07),
    "within a timeout": ({"drive": NETWORK["drive"] | {"Doors": [(0x150, 250)]}}, {"Doors": 8.0, "Brakes": 9.0}, 0.0),
    "slow and fast": ({"drive": NETWORK["drive"] | {"Doors": [(0x150, 3000)]}}, {"Doors": 8.0, "Brakes": 17.0}, 0.0),
    "fast before slow ones": (
        {"drive": {"Engine": [(0x100, 20)], "Radio": [(0x170, 10), (0x171, 10), (0x172, 10)]}
        | {f"Seat{k}": [(0x150 + k, 500)] for k in range(4)}},
        {"Engine": 8.0} | {f"Seat{k}": 8.0 for k in range(4)},
        0.3,
    ),
}  # fmt: skip


@pytest.mark.evidence("Healthy parts: parking")
@pytest.mark.parametrize("name", SWITCHED_OFF)
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_some_ecus_are_switched_off_and_others_run_on(tmp_path, name, seed):
    """Their stops lie less than a timeout apart, or are not all known yet; the frames of the dead are not lost ones."""
    network, off, share = SWITCHED_OFF[name]
    rng = random.Random(seed)
    frames = traffic(network, rng, 24, lambda b, e, i, t: t < off.get(e, 40.0) and rng.random() >= share)
    codes, told, events = run(networks.config_of(tmp_path, network, 5.0, health=SLEEPS, check=RATE), frames, 24)
    assert (codes, told) == (set(), [])
    assert activities(events) == [("running", "falling asleep")]


@pytest.mark.parametrize(("speed", "found"), [(50, True), (2, False)], ids=["it drives on", "it stands"])
def test_two_that_stop_apart_are_switched_off_only_where_the_vehicle_may_be(tmp_path, speed, found):
    """Half a second apart, as in an after-run: while the vehicle moves it has none."""
    power = '[power]\nmoving = [{ signal = "M120.Value", min = 7 }]'
    until_s = {0x110: 8.0, 0x130: 8.5}
    frames = traffic(
        NETWORK, random.Random(5), 20, lambda b, e, i, t: t < until_s.get(i, 40.0), lambda can_id, t_s: speed
    )
    codes, _, events = run(config_of(tmp_path, power=power), frames, 20)
    assert codes == ({"drive.M110.timeout", "drive.M130.timeout"} if found else set())
    assert activities(events)[0] == ("running", "falling asleep")
    if found:
        first = min(e["t_ns"] for e in events if e["event"] == "dtc" and e["status"] & 1) * 1e-9
        assert first == pytest.approx(11.1, abs=0.2), "when the bus has settled"
        assert activities(events)[1:] == [("falling asleep", "running")]
    frames = frames[(frames["can_id"] != 0x120) | (frames["t_ns"] < 9e9)]
    assert run(config_of(tmp_path, power=power), frames, 20)[0] == set(), "nobody says any more that it moves"


def test_an_ecu_that_dies_while_another_message_is_late_is_told(tmp_path):
    """That looked like two that stop apart, and the ECU was silent for 5 minutes; it comes again, and did not stop."""
    frames = traffic(
        NETWORK,
        random.Random(9),
        20,
        lambda b, e, i, t: not (i == 0x140 and 8.0 < t < 9.5) and (e != "Gears" or t < 9.2),
    )
    codes, told, events = run(networks.config_of(tmp_path, NETWORK, 10.0, health=SLEEPS), frames, 20)
    assert activities(events) == [("running", "falling asleep"), ("falling asleep", "running")]
    assert codes == {"drive.M110.timeout", "drive.M111.timeout"}
    assert causes(told) == {("ecu drive.Gears",)}


@pytest.mark.evidence("Healthy parts: lost frames")
def test_a_bus_of_one_sender_waits_while_the_recorder_pauses(tmp_path):
    """It cannot tell that from a sender that is missing; its other bus can."""
    network, rng = NETWORK | {"body": {"Seat": [(0x210, 500)]}}, random.Random(21)
    config = networks.config_of(tmp_path, network, 5.0, health=SLEEPS)
    frames = traffic(network, rng, 30, lambda b, e, i, t: not 8 < t < 11.8)
    assert run(config, frames, 30)[:2] == (set(), [])
    frames = frames[(frames["bus"] == 0) | (frames["t_ns"] < 20e9)]
    assert run(config, frames, 30)[0] == {"body.M210.timeout"}


@pytest.mark.parametrize("seed", [900, 901, 902, 903])
@pytest.mark.parametrize("share", [0.03, 0.3])
def test_two_ecus_that_die_on_a_bus_that_loses_frames_are_not_switched_off(tmp_path, seed, share):
    rng = random.Random(seed)
    dead = rng.sample([*NETWORK["drive"]], 5)[:2]
    frames = traffic(NETWORK, rng, 40, lambda b, e, i, t: (t < 12 or e not in dead) and rng.random() > share)
    codes, _, _ = run(config_of(tmp_path), frames, 40)
    assert codes == {f"drive.M{can_id:X}.timeout" for ecu in dead for can_id, _ in NETWORK["drive"][ecu]}


@pytest.mark.evidence("Healthy parts: lost frames")
@pytest.mark.parametrize("cycles", [1.4, 2.5, 3.1, 17.0])
def test_timeouts_of_any_cycles_take_no_healthy_bus_for_a_lossy_one(tmp_path, cycles):
    """A gap counted from 5/16 of the timeout on: each frame had one, and a dead message was told minutes later.

    Learned of a recorder that loses frames a timeout has 17 cycles: no gap counted there, and parts were accused.
    """
    frames = traffic(NETWORK, random.Random(3), 40, lambda b, e, i, t: i != 0x120 or t < 30)
    check = RATE if cycles > 5.0 else ""
    config = networks.config_of(tmp_path, NETWORK, cycles, health=SLEEPS, check=check)
    codes, _, events = run(config, frames, 40)
    assert [e for e in events if e["event"] == "lossy"] == []
    assert codes == {"drive.M120.timeout"}
    (at,) = [e["t_ns"] * 1e-9 for e in events if e["event"] == "dtc" and e["status"] & 1]
    assert at == pytest.approx(33.0, abs=0.5), "when the bus has settled"
    if cycles < 2:
        return  # each lost frame is a timeout
    lost = random.Random(4)
    frames = traffic(NETWORK, lost, 40, lambda b, e, i, t: t < 20 or lost.random() > 0.2)
    codes, told, events = run(config, frames, 40)
    assert (codes, told) == (set(), [])
    assert [e["lossy"] for e in events if e["event"] == "lossy"] == [True], "where frames do get lost it is"


@pytest.mark.evidence("Healthy parts: lost frames")
def test_a_recorder_that_takes_frames_now_and_then_accuses_nobody(tmp_path):
    """Of each message it takes some frames in a row, and misses the next for half a second: six of seven."""
    rng = random.Random(8)
    taken = {
        can_id: [rng.random() < 0.15 for _ in range(400)] for each in NETWORK["drive"].values() for can_id, _ in each
    }
    frames = traffic(NETWORK, rng, 30, lambda b, e, i, t: taken[i][int(t / 0.08)])
    config = networks.config_of(tmp_path, NETWORK, 5.0, health=SLEEPS, check=RATE)
    codes, told, events = run(config, frames, 30)
    assert (codes, told) == (set(), [])
    (lossy,) = [e for e in events if e["event"] == "lossy"]
    assert lossy["lossy"]
    never = np.isin(frames["can_id"], (0x110, 0x121, 0x131))
    assert run(config, frames[~never], 30)[:2] == (set(), []), "what it never takes is not missing"
    slow = {"drive": {ecu: [(i, 4 * cycle) for i, cycle in some] for ecu, some in NETWORK["drive"].items()}}
    frames = traffic(slow, rng, 60, lambda b, e, i, t: taken[i][int(t / 0.32)])  # a fourth of the frames
    config = networks.config_of(tmp_path, slow, 5.0, health=SLEEPS, check=RATE)
    codes, told, events = run(config, frames, 60)
    assert (codes, told) == (set(), [])
    assert min(e["t_ns"] for e in events if e["event"] == "lossy") < 4e9


def test_a_log_of_some_messages_accuses_nobody_of_the_others(tmp_path):
    """A recorder that filters, or a car of which only some ECUs are awake: half of the messages never come."""
    frames = traffic(NETWORK, random.Random(9), 40, lambda b, e, i, t: e in ("Brakes", "Steering"))
    codes, told, events = run(config_of(tmp_path), frames, 40)
    assert (codes, told) == (set(), [])
    assert activities(events) == [("running", "running in part")]
    stops = frames[(frames["can_id"] < 0x130) | (frames["t_ns"] < 20e9)]
    assert run(config_of(tmp_path), stops, 40)[0] == {"drive.M130.timeout", "drive.M131.timeout"}


def test_a_log_of_slow_messages_alone_falls_asleep_as_any_other(tmp_path):
    """The fast ones never came, so that nearly all time is a silence; each look at it forgot who had stopped."""
    doors = {"Doors": [(0x150, 300), (0x151, 250)], "Seat": [(0x160, 400), (0x161, 350)]}
    network = {"drive": NETWORK["drive"] | doors}
    off = {"Climate": 20.0, "Doors": 20.7, "Seat": 32.0}
    frames = traffic(network, random.Random(18), 32, lambda b, e, i, t: t < off.get(e, 0.0))
    codes, _, events = run(networks.config_of(tmp_path, network, 5.0, health=SLEEPS), frames, 40)
    assert codes == set()
    assert ("running in part", "falling asleep") in activities(events)


BODY = {"Doors": [(0x200, 20), (0x201, 100)], "Seat": [(0x210, 50), (0x211, 1000)]}


@pytest.mark.evidence("Healthy parts: parking")
@pytest.mark.parametrize("run_on_s", [0.0, 10.0], ids=["at once", "after-run"])
def test_a_bus_is_switched_off_where_another_one_is(tmp_path, run_on_s):
    """Ignition off: one ECU of the body stops, or all of them, and the drive's one after the other."""
    network, rng = NETWORK | {"body": BODY}, random.Random(19)
    off = {"Seat": 8.0 + run_on_s, "Doors": 8.0} | {ecu: 8.2 + 0.3 * k for k, ecu in enumerate(NETWORK["drive"])}
    frames = traffic(network, rng, 20, lambda b, e, i, t: t < off[e])
    codes, told, _ = run(networks.config_of(tmp_path, network, 5.0, health=SLEEPS), frames, 40)
    assert (codes, told) == (set(), [])
    frames = traffic(network, rng, 40, lambda b, e, i, t: b == "drive" or t < off[e] or (e == "Seat" and run_on_s))
    codes, _, _ = run(networks.config_of(tmp_path, network, 5.0, health=SLEEPS), frames, 40)
    assert codes == ({"body.bus_silent"} if run_on_s == 0.0 else {"body.M200.timeout", "body.M201.timeout"})


def test_who_wakes_a_sleeping_bus_for_a_moment_accuses_nobody(tmp_path):
    """It is silent for 4 s, less than its slowest sender may be; then some ECUs come, for a door that was opened."""
    network = {"drive": NETWORK["drive"] | {"Clock": [(0x1F0, 4000)]}}
    off = drawn(random.Random(10), 2.0) | {"Clock": 0.5}
    door = ("Climate", "Steering")
    frames = traffic(network, random.Random(10), 30, lambda b, e, i, t: t < 8 + off[e] or (e in door and 15 < t < 20))
    codes, told, _ = run(networks.config_of(tmp_path, network, 5.0, health=SLEEPS), frames, 40)
    assert (codes, told) == (set(), [])


def test_an_ecu_of_another_software_is_told_as_that(tmp_path):
    """Its frames have another length and rate from the first one on; of a length that changes later it is accused."""
    frames = traffic(NETWORK, random.Random(11), 12, lambda b, e, i, t: True)
    engine = np.isin(frames["can_id"], (0x100, 0x101))
    other, late = frames.copy(), frames.copy()
    other["length"][engine] = 7
    twice = other[frames["can_id"] == 0x101].copy()
    twice["t_ns"] += 50_000_000
    both = np.concatenate([other, twice])
    both = both[np.argsort(both["t_ns"], kind="stable")]
    config = networks.config_of(tmp_path, NETWORK, 5.0, health=SLEEPS, check=RATE)
    codes, told, events = run(config, both, 12)
    assert (codes, told) == (set(), [])
    told = {(e["message"], e["what"]) for e in events if e["event"] == "other_software"}
    assert told == {("M100", "length"), ("M101", "length"), ("M101", "early")}
    late["length"][engine & (frames["t_ns"] > 6e9)] = 7
    assert run(config, late, 12)[0] == {"drive.M100.length", "drive.M101.length"}


@pytest.mark.parametrize("new_s", [0.0, 5.0])
def test_messages_that_never_come_in_a_vehicle_with_new_ones_are_not_missing(tmp_path, new_s):
    """Two identifiers that nobody knows, from the start: it has other ECUs. Later they are strangers on its bus."""
    new = {"New": [(0x180, 20), (0x181, 100)]}
    both = {"drive": NETWORK["drive"] | new}
    frames = traffic(both, random.Random(13), 30, lambda b, e, i, t: e != "Steering" and (e not in new or t >= new_s))
    config = networks.config_of(tmp_path, NETWORK, 5.0, health='health = { sleeps = true, unknown = "tell" }')
    codes, _, events = run(config, frames, 30)
    other = {(e["message"], e["what"]) for e in events if e["event"] == "other_software"}
    if new_s:
        assert (codes, other) == ({"drive.M130.timeout", "drive.M131.timeout"}, set())
    else:
        assert (codes, other) == (set(), {("M130", "timeout"), ("M131", "timeout")})


def test_a_rate_that_never_was_right_waits_for_signs_of_other_ecus(tmp_path):
    """Twice as many frames from the start; that there are new identifiers, too, is known only after a second."""
    both = {"drive": NETWORK["drive"] | {"Engine": [(0x100, 5), (0x101, 100)], "New": [(0x180, 400)]}}
    frames = traffic(both, random.Random(16), 12, lambda b, e, i, t: True)
    health = 'health = { sleeps = true, unknown = "tell" }'
    config = networks.config_of(tmp_path, NETWORK, 5.0, health=health, check=RATE)
    codes, _, events = run(config, frames, 12)
    other = {(e["message"], e["what"]) for e in events if e["event"] == "other_software"}
    assert (codes, other) == (set(), {("M100", "early")})


@pytest.mark.evidence("Healthy parts: lost frames")
@pytest.mark.parametrize("pressed", [True, False])
def test_lost_frames_make_no_second_sender(tmp_path, pressed):
    """A button is pressed again and again: where its frame is lost, others repeat. Or a rate never fitted."""
    rng = random.Random(22)
    frames = traffic(NETWORK, rng, 40, lambda b, e, i, t: True)
    more = []
    for k in range(1, 9) if pressed else [5]:
        more.append(frames[frames["can_id"] == 0x101].copy())
        more[-1]["t_ns"] += k * 10_000_000
        more[-1]["data"][:, 0] = k % 2 if pressed else 1
    both = np.concatenate([frames, *more])
    both = both[np.argsort(both["t_ns"], kind="stable")]
    check = RATE.replace("cycle} }}", "cycle}, repeats = true }}") if pressed else RATE
    config = networks.config_of(tmp_path, NETWORK, 5.0, health=SLEEPS, check=check)
    if pressed:
        assert run(config, both, 40)[0] == set()
    codes, told, events = run(config, both[[rng.random() > 0.2 for _ in both]], 40)
    assert (codes, told) == (set(), [])
    assert [e["lossy"] for e in events if e["event"] == "lossy"] == [True]


@pytest.mark.parametrize("others", ["none", "body", "drive"])
def test_loss_is_known_where_one_message_is_watched(tmp_path, others):
    """On this bus, beside four of another bus, or four of this one that never came: each fourth frame is lost."""
    rng = random.Random(17)
    network = {"drive": {"Engine": [(0x100, 10)]}}
    if others != "none":
        network.setdefault(others, {})["Doors"] = [(0x200 + k, 20) for k in range(4)]
    frames = traffic(network, rng, 60, lambda b, e, i, t: b == "body" or (e == "Engine" and rng.random() < 0.7))
    cycles, check = (17.0, RATE) if others == "drive" else (5.0, "")
    config = networks.config_of(tmp_path, network, cycles, health=SLEEPS, check=check)
    codes, _, events = run(config, frames, 60)
    assert codes == ({f"drive.M{0x200 + k:X}.timeout" for k in range(4)} if others == "drive" else set())
    assert [e["bus"] for e in events if e["event"] == "lossy"] == ["drive"]


@pytest.mark.parametrize("step", [0, 3])
@pytest.mark.parametrize("many", [1, 2])
def test_a_counter_that_never_counted_is_a_sign_unless_it_stands(tmp_path, step, many):
    """One is a fault; two that never counted are another software, two that stand still are two faults."""
    counts = {}

    def value(can_id, t_s):
        by = step if can_id in (0x100, 0x110)[:many] else 1
        counts[can_id] = (counts.get(can_id, 0) + by) % 256
        return counts[can_id]

    frames = traffic(NETWORK, random.Random(14), 6, lambda b, e, i, t: True, value)
    config = networks.config_of(tmp_path, NETWORK, 5.0, health=SLEEPS, check='counter = {{ signal = "Value" }}\n')
    codes, _, events = run(config, frames, 6)
    other = {e["message"] for e in events if e["event"] == "other_software" and e["what"] == "counter"}
    if step and many == 2:
        assert (codes, other) == (set(), {"M100", "M110"})
    else:
        assert (codes, other) == (
            {"drive.M100.counter", "drive.M110.counter"} if many == 2 else {"drive.M100.counter"},
            set(),
        )


@pytest.mark.parametrize("health", ["", SLEEPS])
def test_a_checksum_that_no_frame_ever_fitted_is_another_software_on_a_learned_bus(tmp_path, health):
    """Rules that fit are told all the same."""
    rng = random.Random(15)
    frames = traffic(NETWORK, rng, 6, lambda b, e, i, t: True, lambda can_id, t_s: rng.randrange(256))
    rule = 'checksum = {{ rule = "sum", signal = "Value" }}\n'
    codes, _, events = run(networks.config_of(tmp_path, NETWORK, 5.0, health=health, check=rule), frames, 6)
    kinds = {fault.rpartition(".")[2] for fault in codes}
    other = {e["what"] for e in events if e["event"] == "other_software"}
    assert (kinds, other) == ((set(), {"rule"}) if health else ({"rule"}, set()))
    assert {e["message"] for e in events if e["event"] == "protection"} >= {"M100", "M110", "M130"}


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
