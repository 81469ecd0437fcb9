"""Deaths of the process with cycles of signals: what the bus says in between decides, and nothing else."""

import pytest
from rig import MS, Rig, write_config

from gateway.bus.frames import empty, put

IGNITION = """
[cycle.ignition]
begins = { signal = "M2.Value", min = 10.0 }
ends = { signal = "M2.Value", max = 1.0 }
"""
FAULTS = {0: 'cycle = "ignition"\naging_cycles = 4\nindicator = true\nhealing_cycles = 3\n'}
ON, BETWEEN, OFF = 20.0, 5.0, 0.5


class Car:
    """A gateway in one process after another, on the bus of a car whose ignition the test turns."""

    def __init__(self, folder, **options):
        self.config = write_config(folder, extra=IGNITION, faults=FAULTS, **options)
        self.memory = folder / "m.sqlite"
        self.begin()

    def begin(self, boot=""):
        self.rig = Rig(self.config, self.memory, start=False)
        self.rig.gateway.note_restart(0, boot)
        self.rig.gateway.start(0)

    def die(self, boot=""):
        """The process is gone; what it had committed is there."""
        self.rig.gateway.memory.commit()
        self.rig.close()
        self.begin(boot)

    def stop(self):
        self.rig.gateway.stop(self.rig.now)
        self.rig.close()
        self.begin()

    def ignition(self, volts):
        self.rig.value(2, volts)

    def drive(self, failed):
        """The ignition goes on, the test runs, the ignition goes off."""
        self.ignition(ON)
        (self.rig.fail if failed else self.rig.heal)(0)
        self.ignition(OFF)

    @property
    def number(self):
        return self.rig.gateway.memory.cycle_number("ignition")

    @property
    def record(self):
        return self.rig.gateway.memory.record(self.rig.fault(0))

    @property
    def told(self):
        return [(e["state"], e["number"]) for e in self.rig.events if e["event"] == "cycle"]


@pytest.fixture
def car(tmp_path):
    made = Car(tmp_path)
    yield made
    made.rig.close()


def test_eight_deaths_with_the_ignition_on_are_one_cycle(car):
    car.drive(True)
    car.ignition(ON)
    car.rig.heal(0)
    before = int(car.record.status), car.record.cycles
    assert before[0] & 0x88 == 0x88, "confirmed, and asks for the MIL"
    for _ in range(8):
        car.die()
        car.ignition(ON)
        assert car.told == [("goes on", 2)]
        car.rig.heal(0)
    assert (int(car.record.status), car.record.cycles) == before
    car.ignition(OFF)
    assert car.record.cycles.passed == 1, "the ignition completes it"


def test_a_death_with_the_ignition_on_that_finds_it_off_has_ended_the_cycle(car):
    car.drive(True)
    car.ignition(ON)
    car.rig.heal(0)
    car.die()
    assert car.record.cycles.passed == 0
    car.ignition(OFF)
    assert car.told == [("ended", 2)]
    assert car.record.cycles.passed == 1, "the car has ended it while nobody looked"
    car.ignition(ON)
    assert car.told[1:] == [("began", 3)]


def test_off_and_on_within_one_batch_is_a_new_cycle(car):
    car.ignition(ON)
    car.die()
    frames = empty(2)
    for k, volts in enumerate((OFF, ON)):
        put(frames, k, (k + 1) * MS, 258, round(volts * 2).to_bytes(2, "little") + bytes(6))
    car.rig.gateway.feed(frames)
    assert car.told == [("ended", 1), ("began", 2)]


def test_no_result_counts_until_the_ignition_is_seen(car):
    car.ignition(ON)
    car.die()
    car.rig.fail(0)
    assert car.rig.status(0) == 0x50, "the car may stand since yesterday"
    car.ignition(BETWEEN)
    car.rig.fail(0)
    assert (car.rig.status(0), car.told) == (0x50, []), "neither on nor off"
    car.ignition(ON)
    car.rig.fail(0)
    assert car.rig.status(0) & 0x2F == 0x2F
    assert car.told == [("goes on", 1)]


def test_the_power_goes_with_the_key_each_time_and_the_dtc_ages_all_the_same(car):
    """The process never hears the ignition go off, and finds it off when it comes back."""
    car.drive(True)
    for k in range(2, 12):
        car.ignition(OFF)
        car.ignition(ON)
        assert car.number == k
        car.rig.heal(0)
        car.die()
    assert car.rig.gateway.memory.entries() == []


@pytest.mark.parametrize("supplies", [False, True])
def test_terminal_15_that_supplies_the_gateway_completes_by_power_cuts_where_the_configuration_says_so(car, supplies):
    """It is on whenever it is first heard; only another boot of the machine tells a power cut from a death."""
    more = "supplies = true\n" if supplies else ""
    text = car.config.read_text()
    car.config.write_text(text.replace("max = 1.0 }\n", f"max = 1.0 }}\n{more}"))
    for k in range(1, 4):
        car.die(f"boot {k}")
        car.ignition(ON)
        car.rig.heal(0)
        car.die(f"boot {k}")
        car.ignition(ON)
        assert car.told == [("goes on", k if supplies else 1)], "a death"
    assert car.record.cycles.passed == (2 if supplies else 0)


def test_deaths_while_the_ignition_is_off_count_nothing(car):
    car.drive(True)
    car.drive(False)
    before = car.record.cycles
    for _ in range(8):
        car.die()
        car.ignition(OFF)
        car.rig.heal(0)
    assert (car.record.cycles, car.told, car.number) == (before, [], 2)


def test_a_stop_in_order_completes_both_cycles_also_one_that_a_death_left_open(car):
    car.drive(True)
    car.ignition(ON)
    car.rig.heal(0)
    car.die()
    car.stop()
    assert car.record.cycles.passed == 1
    car.ignition(ON)
    assert car.told == [("began", 3)]


def test_a_testers_reset_completes_what_a_death_left_open(car):
    car.ignition(ON)
    car.die()
    car.rig.gateway.controls.restart_cycle()
    car.ignition(ON)
    assert car.told == [("began", 2)]


def test_a_warm_up_cycle_goes_on_without_another_rise(tmp_path):
    warm_up = """
[cycle.ignition]
begins = { signal = "M2.Value", min = 70.0, rise = 22.0 }
ends = { signal = "M1.Value", max = 1.0 }
"""
    folder = tmp_path
    config = write_config(folder, extra=warm_up, faults=FAULTS)
    rig = Rig(config, folder / "m.sqlite")
    for value in (20.0, 90.0):
        rig.value(2, value)
    rig.close()
    rig = Rig(config, folder / "m.sqlite")
    rig.value(2, 92.0)
    rig.fail(0)
    assert rig.status(0) & 1, "it is as warm as before"
    rig.value(1, 0.0)
    rig.value(2, 93.0)
    assert [e["state"] for e in rig.events if e["event"] == "cycle"] == ["goes on", "ended"], "now it has to rise again"
    rig.close()
