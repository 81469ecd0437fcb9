"""What the gateway sends itself: ranked for the bus, and known again when it comes back."""

import numpy as np

from gateway.app import Gateway
from gateway.bus.frames import ANSWER, CYCLIC, OWN, URGENT, empty, put
from gateway.config import load_config
from gateway.resources import shipped
from gateway.vecu.player import Player
from gateway.vecu.scenario import load_scenario

DTC, ENGINE, UDS = 0x6F0, 0x6F1, 0x7E8


def drive(*, echo):
    """Play a missed tooth to a gateway; what it sends comes back marked, or not."""
    scenario = load_scenario(shipped("scenarios/crank_missed_tooth.toml"))
    frames = Player(scenario.model_copy(update={"duration_s": 5.0}), {"powertrain": 0}).frames
    gateway = Gateway(load_config(scenario.config))
    events, sent = [], []
    gateway.listen(events.append)
    gateway.start(0)
    for k in range(0, len(frames), 50):
        made = gateway.feed(frames[k : k + 50])
        sent.append(made)
        if echo and len(made):
            back = made.copy()
            back["flags"] |= OWN
            gateway.feed(back)
    ask = empty(1)
    put(ask, 0, int(frames[-1]["t_ns"]), 0x7E0, bytes.fromhex("023e000000000000"))
    sent.append(gateway.feed(ask))
    return events, np.concatenate(sent), gateway


def test_frames_are_ranked_by_what_must_go_first():
    _, sent, gateway = drive(echo=False)
    ranks = {
        int(can_id): set(sent[sent["can_id"] == can_id]["rank"]) for can_id in set(sent["can_id"])
    }
    assert ranks == {DTC: {URGENT}, ENGINE: {CYCLIC}, UDS: {ANSWER}}
    assert gateway.engine.emitted == [ENGINE]


def test_own_frames_that_come_back_change_nothing():
    events, sent, gateway = drive(echo=False)
    with_echo, sent_too, other = drive(echo=True)
    assert with_echo == events
    np.testing.assert_array_equal(sent_too, sent)
    assert other.engine.counters()["decoded"] == gateway.engine.counters()["decoded"]
