"""Random networks: one cause where one thing is wrong, none where nothing is, whatever ECUs, cycles and timeouts."""

import random

import networks
import pytest
from amount import amount
from networks import causes, run

from gateway.engine.checks.bus_sleep import MOST_PARKS

#: Cycles of messages [ms]; timeouts in cycles.
CYCLES, TIMEOUTS = (10, 20, 50, 100, 200, 500, 1000), (1.5, 2.0, 2.5, 3.5)
FIRST = 500


def a_network(rng):
    """Return a network of 1 to 3 buses with 2 to 4 ECUs each, and its timeouts in cycles.

    Of a bus that one sender alone is watched of nobody can say whether the bus is silent, or its sender.
    """
    can_id, made = 0x100, {}
    for bus in range(rng.randint(1, 3)):
        ecus = {}
        for ecu in range(rng.randint(2, 4)):
            own = [(can_id + k, rng.choice(CYCLES)) for k in range(rng.randint(1, 4))]
            can_id += len(own)
            ecus[f"E{ecu}"] = own
        made[f"b{bus}"] = ecus
    return made, rng.choice(TIMEOUTS)


def messages_of(network, bus, ecu=None):
    ecus = network[bus] if ecu is None else {ecu: network[bus][ecu]}
    return {f"{bus}.M{can_id:X}.timeout" for own in ecus.values() for can_id, _ in own}


@pytest.mark.evidence("Healthy parts: networks")
@pytest.mark.parametrize("seed", range(FIRST, FIRST + amount(40, 4)))
def test_healthy(tmp_path, seed):
    rng = random.Random(seed)
    network, timeout = a_network(rng)
    config = networks.config_of(tmp_path, network, timeout)
    assert run(config, networks.traffic(network, rng, 30, lambda *_: True), 30)[:2] == (set(), [])


@pytest.mark.parametrize("seed", range(FIRST, FIRST + amount(40, 6)))
def test_a_recorder_that_pauses_accuses_no_message(tmp_path, seed):
    """Where there is one bus, it is that bus, or nobody; else nobody.

    A pause that is no longer than the shortest timeout looks like a frame that is lost.
    """
    rng = random.Random(seed)
    network, timeout = a_network(rng)
    config = networks.config_of(tmp_path, network, timeout)
    shortest = timeout * max(min(c for own in ecus.values() for _, c in own) for ecus in network.values()) * 1e-3
    pauses = [(t, t + max(10 ** rng.uniform(-2, 1.0), 1.1 * shortest)) for t in (6, 25, 42)]
    is_there = lambda b, e, i, t: not any(a <= t < z for a, z in pauses)  # noqa: E731
    codes, told, _ = run(config, networks.traffic(network, rng, 60, is_there), 60)
    only = next(iter(network))
    assert codes <= ({f"{only}.bus_silent"} if len(network) == 1 else set()), network
    assert causes(told) <= {(f"bus {only}",)}


@pytest.mark.evidence("Healthy parts: dead ECU")
@pytest.mark.parametrize("seed", range(FIRST, FIRST + amount(40, 6)))
def test_an_ecu_that_dies_is_one_cause(tmp_path, seed):
    """Told in time: each timeout comes, and the cause behind the slowest."""
    rng = random.Random(seed)
    network, timeout = a_network(rng)
    config = networks.config_of(tmp_path, network, timeout)
    bus = rng.choice(list(network))
    dead, cut = rng.choice(list(network[bus])), rng.uniform(4, 8)
    frames = networks.traffic(network, rng, 30, lambda b, e, i, t: (b, e) != (bus, dead) or t < cut)
    codes, told, events = run(config, frames, 30)
    assert codes == messages_of(network, bus, dead), network
    (group,) = told[-1]["groups"]
    assert group["causes"][0]["components"] in ([f"ecu {bus}.{dead}"], [f"message {bus}.M{network[bus][dead][0][0]:X}"])
    assert {name for each in causes(told) for name in each} <= {f"ecu {bus}.{dead}"}
    slowest = max(cycle for _, cycle in network[bus][dead]) * 1e-3
    others = min(cycle for ecu, own in network[bus].items() if ecu != dead for _, cycle in own) * 1e-3
    late = max(e["t_ns"] for e in events if e["event"] == "dtc" and e["status"] & 1) * 1e-9 - cut
    # So often a silence, until somebody else is heard, may be the bus's.
    assert late < (MOST_PARKS + 1) * (timeout * slowest + 1.2 * others) + 0.1, network


@pytest.mark.parametrize("seed", range(FIRST, FIRST + amount(40, 4)))
def test_a_bus_that_is_cut_off_is_one_cause(tmp_path, seed):
    rng = random.Random(seed)
    network, timeout = a_network(rng)
    while len(network) < 2:
        network, timeout = a_network(rng)
    config = networks.config_of(tmp_path, network, timeout)
    bus = rng.choice(list(network))
    cut = rng.uniform(4, 8)
    frames = networks.traffic(network, rng, 30, lambda b, e, i, t: b != bus or t < cut)
    codes, told, _ = run(config, frames, 30)
    assert codes == {f"{bus}.bus_silent"}, network
    assert causes(told) == {(f"bus {bus}",)}
