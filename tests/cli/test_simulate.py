"""``gateway simulate`` in real time: where the machine is late, and how long it waits for what it expects."""

from importlib import import_module
from types import SimpleNamespace

import pytest

from gateway.config.load import load_config
from gateway_bench.vecu.expectations import Judge
from gateway_bench.vecu.player import Player
from gateway_bench.vecu.scenario import load_scenario
from gateway_fdi.common.resources import shipped

simulate = import_module("gateway_bench.cli.simulate")


class Machine:
    """Its clock goes on while somebody waits, and now and then stands still for the simulator."""

    def __init__(self, scenario):
        self.now = 100.0
        self.judge = Judge(scenario)
        self.sent = []  # (time, scenario's time, frames)
        self.begun = None
        self.pauses = {}
        self.answers = []  # (time, DTC, status)

    # What the simulator uses of its tester, bus and clock

    @property
    def waits_until_s(self):
        return self.judge.waits_until_s

    def listen(self, timeout_s):
        self.now += timeout_s
        while self.answers and self.answers[0][0] <= self.now:
            _, dtc, status = self.answers.pop(0)
            self.judge.report(self.now - self.begun, dtc, status, 1)
        return 0

    def monotonic(self):
        return self.now

    def send(self, _, frames):
        self.sent.append((self.now, self.now - self.begun, len(frames)))
        self.now += self.pauses.pop(len(self.sent), 0.0)


@pytest.fixture
def machine(monkeypatch):
    scenario = load_scenario(shipped("scenarios/pedal_emergency.toml"))
    machine = Machine(scenario)
    config = load_config(scenario.config)
    machine.player = Player(scenario, {bus.name: k for k, bus in enumerate(config.bus)})
    monkeypatch.setattr(simulate, "time", SimpleNamespace(monotonic=machine.monotonic))
    monkeypatch.setattr(simulate, "_send", machine.send)
    return machine


def play(machine, *, patient=True):
    begun = machine.now
    simulate._play(machine.player, [], machine, None, lambda: False, patient=patient)
    return machine.now - begun


def test_who_is_late_does_not_send_faster_than_an_ecu(machine, capsys):
    machine.pauses = {100: 2.5, 300: 0.7, 400: 0.015}
    lasted = play(machine, patient=False)
    steps = [b[0] - a[0] for a, b in zip(machine.sent, machine.sent[1:], strict=False)]
    assert min(steps) > 0.0, "not two steps at once"
    assert sum(step < 0.0099 for step in steps) == 1, "15 ms are caught up"
    assert [round(step, 2) for step in steps if step > 0.02] == [2.5, 0.7]
    assert lasted == pytest.approx(6.0 + 0.5 + 2.5 + 0.7 - 2 * 0.01, abs=0.02)
    places = [place for _, place, _ in machine.sent]
    assert places[-1] == pytest.approx(6.0, abs=0.02), "by the scenario's clock nothing is late"
    assert "stood still for 3.2 s" in capsys.readouterr().err


def test_who_is_in_time_says_nothing(machine, capsys):
    assert play(machine, patient=False) == pytest.approx(6.5, abs=0.02)
    assert capsys.readouterr().err == ""


def test_it_waits_for_what_is_expected_to_the_deadline_and_no_longer(machine):
    (expected,) = machine.judge._scenario.expect
    late = expected.model_copy(update={"by_s": 20.0, "healed_by_s": 30.0})
    machine.judge._scenario = machine.judge._scenario.model_copy(update={"expect": (late,)})
    assert machine.judge.waits_until_s == 20.0
    machine.answers = [(111.0, late.dtc, 0x2F), (115.0, late.dtc, 0x2E)]
    assert play(machine) == pytest.approx(15.0, abs=0.11), "healed 15 s after the begin"
    assert all(finding.good for finding in machine.judge.findings())
    machine.judge = Judge(machine.judge._scenario)
    assert play(machine) == pytest.approx(20.0, abs=0.11), "never set"
    assert not any(finding.good for finding in machine.judge.findings())


def test_who_is_not_asked_to_check_does_not_wait(machine):
    assert machine.judge.waits_until_s > 0
    (expected,) = machine.judge._scenario.expect
    late = expected.model_copy(update={"by_s": 20.0})
    machine.judge._scenario = machine.judge._scenario.model_copy(update={"expect": (late,)})
    assert play(machine, patient=False) == pytest.approx(6.5, abs=0.02)
