"""A multiplexed input is missing until its page has come (docs/monitors.md), and after its message was away again."""

import numpy as np
import pytest
from battery_bus import PERIOD_NS, battery_database

from gateway.bus.frames import empty, put
from gateway.engine.adopt import adopt
from gateway.engine.build import build_engine
from gateway.engine.checks.communication import CheckInstance
from gateway.engine.checks.message import Params
from gateway.engine.instances import MonitorInstance
from gateway.monitors import contract
from gateway.monitors.contract import Fault, Monitor, MonitorParams, Signal, report
from gateway_fdi.jit import Record, f8, i8, kernel

TIMEOUT_MS = 10.0


class State(Record):
    steps: i8
    first: f8
    second: f8


class Inputs(contract.Inputs):
    first: f8
    second: f8


@kernel
def step(s, c, u, out):
    s.steps += 1
    s.first, s.second = u.first, u.second
    report(out, 0, u.first > 20.0, u.first, 20.0)


def monitor(first="First", second="Second", **optional):
    signals = {"first": first, "second": second}
    return Monitor(
        type="pages",
        api=2,
        params=MonitorParams,
        state=State,
        const=State,
        inputs=Inputs,
        step=step,
        connect=lambda _: {
            name: Signal(f"CELLS.{signal}", triggers=True, **optional) for name, signal in signals.items()
        },
        prepare=lambda *_: None,
        faults=lambda _: (Fault("high", "P0563-17", "too high"),),
    )


@pytest.fixture(scope="module")
def database(tmp_path_factory):
    return battery_database(tmp_path_factory.mktemp("dbc"))


class Rig:
    """An engine with a monitor of two pages, and one of the first only; takes pages with their values."""

    def __init__(self, database, both, checked=True):
        check = Params(message="CELLS", timeout_ms=TIMEOUT_MS)
        one = monitor(second="First")
        self.monitors = [MonitorInstance(name, m, MonitorParams()) for name, m in (("both", both), ("one", one))]
        self.database, self.checks = database, [CheckInstance(check, 0, "b.CELLS")] if checked else []
        self.engine, self.t_ns = self.made(), 0

    def made(self):
        return build_engine([(0, self.database)], self.monitors, self.checks)

    def feed(self, *pages):
        frames = empty(len(pages))
        for k, (page, value) in enumerate(pages):
            self.t_ns += PERIOD_NS
            raw = np.float32(value).tobytes() if page == 2 else round(100 * value).to_bytes(2, "little")
            put(frames, k, self.t_ns, 259, (bytes([page]) + raw).ljust(8, b"\0"))
        self.engine.process(frames, lambda _: None)
        return self

    def wait(self, ns):
        self.t_ns += ns
        self.engine.advance(self.t_ns, lambda _: None)
        return self

    def of(self, name):
        """Steps, and times it was not tested."""
        handler = self.engine.tables.handlers[self.engine.place_of(name)]
        return int(handler["steps"]), int(handler["skipped"])

    def seen(self):
        state = self.engine.state_of(self.engine.place_of("both"))[0]
        return float(state["first"]), float(state["second"])


def test_it_is_not_tested_until_each_of_its_pages_has_come(database):
    rig = Rig(database, monitor()).feed((0, 10.0), (0, 11.0))
    assert (rig.of("both"), rig.of("one")) == ((0, 2), (2, 0))
    rig.feed((1, 12.0), (0, 13.0))
    assert (rig.of("both"), rig.of("one")) == ((2, 2), (4, 0))
    assert rig.seen() == (13.0, 12.0)


def test_after_its_message_was_away_each_page_has_to_come_again(database):
    rig = Rig(database, monitor()).feed((0, 10.0), (1, 12.0))
    before = rig.of("both")
    rig.wait(round(3e6 * TIMEOUT_MS)).feed((1, 14.0), (1, 14.0))
    assert rig.of("both") == (before[0], before[1] + 2), "the first is from before"
    rig.feed((0, 15.0))
    assert rig.of("both")[0] == before[0] + 1
    assert rig.seen() == (15.0, 14.0)


def test_without_a_timeout_its_message_is_never_away(database):
    rig = Rig(database, monitor(), checked=False).feed((0, 10.0), (1, 12.0))
    rig.wait(round(3e6 * TIMEOUT_MS)).feed((1, 14.0))
    assert rig.of("both") == (2, 1)


def test_a_page_that_need_not_come_is_no_number_until_it_does(database):
    rig = Rig(database, monitor(optional=True)).feed((0, 10.0))
    assert rig.of("both") == (1, 0)
    assert rig.seen()[0] == 10.0
    assert np.isnan(rig.seen()[1])


def test_a_page_without_a_value_has_not_come(database):
    rig = Rig(database, monitor(second="Third")).feed((0, 10.0), (2, float("nan")), (0, 11.0))
    assert rig.of("both") == (0, 3)
    rig.feed((2, 12.0))
    assert rig.of("both") == (1, 3)


def test_the_selector_comes_with_each_frame(database):
    rig = Rig(database, monitor(first="Page", second="Page")).feed((1, 10.0))
    assert rig.of("both") == (1, 0)


def test_over_a_reload_a_page_that_has_come_stays(database):
    rig = Rig(database, monitor()).feed((0, 10.0))
    old, rig.engine = rig.engine, rig.made()
    adopt(rig.engine, old, {0: 0}, {})
    rig.feed((1, 12.0))
    assert rig.of("both") == (1, 1)
    assert rig.seen() == (10.0, 12.0)
