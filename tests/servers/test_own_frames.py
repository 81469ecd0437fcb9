"""What the gateway sends itself: ranked for the bus, and known again when it comes back."""

import numpy as np
import pytest

from gateway.bus.frames import ANSWER, CYCLIC, OWN, URGENT, empty, put
from gateway.config.load import load_config
from gateway.runtime.app import Gateway
from gateway_bench.vecu.player import Player
from gateway_bench.vecu.scenario import load_scenario
from gateway_fdi.common.resources import shipped
from gateway_replay.replay import replay

DTC, ENGINE, UDS = 0x6F0, 0x6F1, 0x7E8


def drive():
    """Play a missed tooth to a gateway and ask it; returns frames, events, what it sent, and the gateway."""
    scenario = load_scenario(shipped("scenarios/crank_missed_tooth.toml"))
    frames = Player(scenario.model_copy(update={"duration_s": 5.0}), {"powertrain": 0}).frames
    ask = empty(1)
    put(ask, 0, int(frames[-1]["t_ns"]), 0x7E0, bytes.fromhex("023e000000000000"))
    frames = np.concatenate([frames, ask])
    gateway = Gateway(load_config(scenario.config))
    events, sent = [], []
    gateway.listen(events.append)
    gateway.start(int(frames[0]["t_ns"]))
    for k in range(0, len(frames), 50):
        sent.append(gateway.feed(frames[k : k + 50]))
    return frames, events, np.concatenate(sent), gateway


def test_frames_are_ranked_by_what_must_go_first():
    _, _, sent, gateway = drive()
    ids = set(sent["can_id"].tolist())
    ranks = {can_id: set(sent[sent["can_id"] == can_id]["rank"].tolist()) for can_id in ids}
    assert ranks == {DTC: {URGENT}, ENGINE: {CYCLIC}, UDS: {ANSWER}}
    assert gateway.engine.emitted == [ENGINE]


@pytest.mark.evidence("Live is replay: recording")
def test_a_recording_with_our_own_frames_replays_to_what_was():
    """As the ring has it: what we sent is in it, marked, right behind what made us send it."""
    frames, events, sent, _ = drive()
    back = sent.copy()
    back["flags"] |= OWN
    back["rank"] = 0
    both = np.concatenate([frames, back])
    both = both[np.argsort(both["t_ns"], kind="stable")]
    for recording, counted in (
        (frames, 0),
        (both, len(sent) - int((sent["can_id"] == ENGINE).sum())),
    ):
        gateway, again = Gateway(load_config(shipped("gateway.toml"))), []
        gateway.listen(again.append)
        assert replay(gateway, [recording]) == len(recording)
        assert again == events
        assert gateway.engine.counters()["frames"] == len(frames) + counted
