"""A monitor whose signals come on several buses: joined by time stamp, whatever the buses' delays are."""

import os

import numpy as np
import pytest

from gateway.bus.base import Bus
from gateway.bus.frames import empty
from gateway.config.load import load_config
from gateway.live.clock import Clock
from gateway.live.link import Link
from gateway.live.loop import Live
from gateway.runtime.app import Gateway
from gateway_bench.vecu.player import Player
from gateway_bench.vecu.scenario import load_scenario
from gateway_fdi.common.resources import shipped
from gateway_fdi.errors import InputError, InputErrors

CHANNELS = """
[[monitor.channel]]
signal = "{first}PED_Brake.Ch1"
at_rest = 0.5
at_full = 4.5
low = 0.25
high = 4.75
noise = 0.002
resolution = 0.001220703125

[[monitor.channel]]
signal = "{second}PED_Brake.Ch2"
at_rest = 4.5
at_full = 0.5
low = 0.25
high = 4.75
noise = 0.002
resolution = 0.001220703125
"""

BUS = """
[[bus]]
name = "{name}"
uri = "virtual:{name}"
database = ["dbc/pedal.dbc"]
"""

MONITOR = """
[[monitor]]
name = "brake"
type = "redundant_pair"
preset = "brake"
bus = "{bus}"
"""

STEP_NS = 300_000


def config_of(tmp_path, buses, first="", second=""):
    path = tmp_path / f"{len(buses)}.toml"
    text = "".join(BUS.format(name=name) for name in buses)
    text += MONITOR.format(bus=buses[0]) + CHANNELS.format(first=first, second=second)
    path.write_text(text)
    return load_config(path)


@pytest.fixture(scope="module")
def drive():
    scenario = load_scenario(shipped("scenarios/pedal_faults.toml"))
    short = scenario.model_copy(update={"duration_s": 9.0})
    return Player(short, {"chassis": 0}).frames


class Script(Bus):
    """A bus whose frames come late, each at its stamp and a delay."""

    def __init__(self, index, frames, clock, delay_ns):
        super().__init__("test:script", index)
        self._frames, self._clock, self._delay = frames, clock, delay_ns
        self._event = os.eventfd(1)
        self.at = 0

    def fileno(self):
        return self._event

    def receive(self, out):
        until = np.searchsorted(self._frames["t_ns"], self._clock() - self._delay, side="right")
        part = self._frames[self.at : min(until, self.at + len(out))]
        out[: len(part)] = part
        out["bus"][: len(part)] = self.index
        self.at += len(part)
        return len(part)

    def send(self, frames):
        return len(frames)

    def close(self):
        os.close(self._event)


def run(config, streams, *, steps_ns, delays_ns):
    """Feed streams through the live loop with a clock that advances in uneven steps."""
    now = 0
    events = []
    gateway = Gateway(config)
    gateway.listen(events.append)
    scripts = []

    def opener(uri, index):
        scripts.append(Script(index, streams[index], lambda: now, delays_ns[index]))
        return scripts[-1]

    clock = Clock(lambda: now, lambda: now)
    links = [Link(bus.uri, k, bus.name, opener, clock) for k, bus in enumerate(config.bus)]
    for link in links:
        link.start()
    gateway.start(0)
    live = Live(gateway, links, events.append, clock=clock)
    rng = np.random.default_rng(6)
    end = int(streams[0]["t_ns"].max()) + 10**8
    while now < end:
        now += int(rng.choice(steps_ns))
        live.turn()
    live.drain()
    counters = gateway.engine.counters()
    for link in links:
        link.close()
    gateway.close()
    return events, counters


def dtcs(events, shift_ns=0):
    return [
        (e["t_ns"] - shift_ns, e["fault"], e["status"] & 1)
        for e in events
        if e["event"] == "dtc" and e["fault"].startswith("brake")
    ]


@pytest.mark.evidence("Live is replay: buses")
@pytest.mark.long
def test_two_buses_give_what_one_gives(tmp_path, drive):
    """The second channel's bus lags 0.3 ms: the verdicts are those of one bus, that much later."""
    one = config_of(tmp_path, ["chassis"])
    alone, _ = run(one, [drive], steps_ns=[2_000_000], delays_ns=[0])
    expected = dtcs(alone)
    assert len(expected) >= 4, "two channels fail and heal"
    lagging = drive.copy()
    lagging["t_ns"] += STEP_NS
    two = config_of(tmp_path, ["chassis", "other"], "chassis.", "other.")
    for delays in ([0, 0], [100_000, 0], [0, 150_000]):
        events, counters = run(two, [drive, lagging], steps_ns=[100_000, 3_000_000, 40_000_000], delays_ns=delays)
        assert dtcs(events, STEP_NS) == expected, delays
        assert counters["late"] == 0
        assert counters["frames"] == 2 * len(drive) + 2, "and the condition of each bus"


def test_without_the_merging_the_same_frames_come_late(tmp_path, drive):
    """What the test above would miss if it could not fail: bus after bus, time goes back."""
    two = config_of(tmp_path, ["chassis", "other"], "chassis.", "other.")
    gateway = Gateway(two)
    lagging = drive.copy()
    lagging["t_ns"] += STEP_NS
    lagging["bus"] = 1
    gateway.start(0)
    for k in range(0, 400, 40):
        gateway.feed(drive[k : k + 40])
        gateway.feed(lagging[k : k + 40])
    assert gateway.engine.counters()["late"] > 300
    gateway.close()


@pytest.mark.parametrize(
    ("second", "match"),
    [("nowhere.", "the buses are chassis, other"), ("other.x", "no message")],
)
def test_a_signal_of_no_bus_is_named(tmp_path, second, match):
    config = config_of(tmp_path, ["chassis", "other"], "chassis.", second)
    with pytest.raises((InputError, InputErrors), match=match) as error:
        Gateway(config)
    assert "monitor[0].channel[1].signal" in str(error.value), "where the file has it"
    assert "PED_Brake.Ch2" in str(error.value)


def test_what_is_held_back_is_fed_at_the_end(tmp_path, drive):
    two = config_of(tmp_path, ["chassis", "other"], "chassis.", "other.")
    last = drive[:300].copy()
    last["t_ns"][-1] = int(last["t_ns"].max()) + 2 * 10**8 - 1  # as the loop ends, too new to be sure of
    _, counters = run(two, [last, empty(1)], steps_ns=[int(last["t_ns"][-1]) + 1], delays_ns=[0, 0])
    assert counters["frames"] >= 300


def test_an_empty_bus_holds_nobody_back(tmp_path, drive):
    two = config_of(tmp_path, ["chassis", "other"])
    silent = empty(1)
    silent["t_ns"] = 10**15
    config_events, counters = run(two, [drive[:500], silent[:1]], steps_ns=[10**9], delays_ns=[0, 0])
    assert counters["frames"] >= 500
    assert config_events
