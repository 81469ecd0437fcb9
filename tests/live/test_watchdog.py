"""A step that does not return: the watchdog ends the process, names the monitor, and the next start leaves it off."""

import json
import sys

import numpy as np
import pytest

from gateway.faults.hung_monitors import file_beside, hung_beside
from gateway.live.watchdog import ASKED_LIMIT_S, HUNG_EXIT, LIMIT_S, LOOKS, Watchdog
from gateway_fdi.common.resources import shipped


class Instance:
    name = "slips"

    def __init__(self, monitor):
        self.monitor = monitor


class Engine:
    """Says of itself what a loop does: which monitor is stepped."""

    def __init__(self, monitor):
        self.monitors = [None, Instance(monitor)]
        self.tables = self
        self.clock = np.zeros(1, [("stepping", "<i8")])
        self.timers = np.zeros(4, [("index", "<i4")])
        self.timers["index"][3] = 1
        self.handlers = np.zeros(2, [("steps", "<i8")])


@pytest.fixture
def rig(tmp_path):
    sys.path.insert(0, str(shipped("examples/battery_voltage")))
    from battery_voltage import MONITOR

    engine, now, left, asked = Engine(MONITOR), [0.0], [], [False]
    watchdog = Watchdog(
        lambda: engine, lambda: tmp_path / "faults.sqlite", asked=lambda: asked[0], leave=left.append,
        monotonic=lambda: now[0],
    )  # fmt: skip

    def look(seconds):
        now[0] += seconds
        watchdog.look()
        return list(left)

    yield engine, look, asked, tmp_path / "faults.sqlite.hung.json"
    sys.path.pop(0)


@pytest.mark.evidence("Nothing is silent: watchdog")
def test_who_does_not_return_is_named_and_noted(rig, capsys):
    engine, look, _, file = rig
    engine.clock["stepping"] = 4
    for _ in range(LOOKS):
        assert look(LIMIT_S / LOOKS - 0.01) == []
    assert look(2.0) == [HUNG_EXIT]
    said = capsys.readouterr().err
    assert "monitor slips (type battery_voltage, " in said
    assert "battery_voltage.py): its step did not return" in said
    assert set(json.loads(file.read_text())["monitors"]) == {"slips"}


def test_steps_that_end_and_loops_that_wait_are_left_alone(rig):
    engine, look, _, file = rig
    engine.clock["stepping"] = 4
    for _ in range(100):
        engine.handlers["steps"] += 1
        assert look(1.0) == []
    engine.clock["stepping"] = 0
    assert not any(look(LIMIT_S) for _ in range(10))
    assert not file.exists()


def test_a_machine_that_slept_proves_nothing(rig):
    engine, look, _, _ = rig
    engine.clock["stepping"] = 4
    assert look(0.25) == []
    assert look(3600.0) == []


def test_who_was_asked_to_end_waits_less(rig):
    engine, look, asked, _ = rig
    engine.clock["stepping"] = 4
    asked[0] = True
    results = [look(ASKED_LIMIT_S / 2) for _ in range(LOOKS + 1)]
    assert results[-1] == [HUNG_EXIT]


@pytest.mark.parametrize("text", ["[" * 100_000, "{", "[]", '{"monitors": [1]}', '{"monitors": {"a": 1}}'])
def test_a_file_of_hung_monitors_that_cannot_be_read_keeps_nobody_off(tmp_path, text):
    memory = tmp_path / "f.sqlite"
    file_beside(memory).write_text(text)
    assert hung_beside(memory).monitors == {}
