"""Operation cycles over deaths of the process: a death completes nothing, the next end in order does."""

import random
import shutil
import tempfile
from pathlib import Path

import pytest
from amount import amount
from fault_examples import catalogue, event, nothing
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from gateway.faults.memory import FaultMemory
from gateway.faults.status import Status
from gateway.faults.store import Store


class Life:
    """One memory on a disk, in one process after another."""

    def __init__(self, path, made=None):
        self.path, self.catalogue, self.t_ns = path, catalogue() if made is None else made, 0
        self.open()

    def open(self):
        self.store = Store(self.path)
        self.memory = FaultMemory(self.catalogue, self.store)

    def start(self, name="power"):
        self.t_ns += 1
        self.memory.start_cycle(self.t_ns, name)

    def end(self, name="power"):
        self.t_ns += 1
        self.memory.end_cycle(self.t_ns, name)

    def result(self, fault, failed):
        self.t_ns += 1
        self.memory.apply(event(fault, failed, self.t_ns), nothing)

    def die(self):
        """The process dies after a commit, and another one opens the memory."""
        self.memory.commit()
        self.store.close()
        self.open()

    def state(self):
        return [
            (int(record.status), record.cycles, record.occurrence)
            for record in map(self.memory.record, (definition.id for definition in self.catalogue))
        ]

    def close(self):
        self.store.close()


@pytest.fixture
def life(tmp_path):
    made = Life(tmp_path / "f.sqlite")
    yield made
    made.close()


@pytest.mark.parametrize("deaths", [8, 200])
def test_deaths_in_a_row_age_and_heal_nothing(life, deaths):
    """Each start finds the test passed; the second fault asks for the MIL, heals after 2 cycles, ages after 3."""
    life.start()
    for fault in (0, 1):
        life.result(fault, True)
    life.end()
    life.start()
    life.result(1, True)  # confirmed by its second cycle
    life.end()
    assert life.memory.is_mil_on()
    life.start()
    for fault in (0, 1):
        life.result(fault, False)
    before, number = life.state(), life.memory.cycle_number()
    for _ in range(deaths):
        life.die()
        life.start()
        for fault in (0, 1):
            life.result(fault, False)
    assert life.state() == before
    assert life.memory.cycle_number() == number, "the cycle goes on"
    assert life.memory.is_mil_on()
    for _ in range(2):
        life.end()
        life.start()
        life.result(1, False)
    life.memory.commit()
    assert not life.memory.is_mil_on(), "two cycles that ended in order heal it"


def test_failures_on_both_sides_of_a_death_are_of_one_cycle(life):
    """The third fault is confirmed by its third cycle with a failure."""
    for _ in range(5):
        life.start()
        life.result(2, True)
        life.result(2, False)
        life.die()
    life.start()
    assert not life.memory.status("m.f2") & Status.CONFIRMED_DTC
    assert life.memory.record("m.f2").cycles.failed == 1


def test_a_test_that_was_complete_stays_so_over_a_death(life):
    life.start()
    life.result(0, False)
    life.die()
    life.start()
    assert not life.memory.status("m.f0") & Status.NOT_COMPLETED_THIS_CYCLE
    life.end()
    life.start()
    assert life.memory.status("m.f0") & Status.NOT_COMPLETED_THIS_CYCLE, "a new cycle"


def test_a_permanent_dtc_does_not_go_by_deaths(tmp_path):
    life = Life(tmp_path / "f.sqlite", catalogue(permanent=(False, True, False)))
    for failed in (True, True, False):
        life.start()
        life.result(1, failed)
        if failed:
            life.end()
    for _ in range(8):
        life.die()
        life.start()
        life.result(1, False)
    assert [each.fault for each in life.memory.permanent()] == ["m.f1"]
    life.close()


DRIVING = {"cycle": ("power", "driving", "driving"), "aging_cycle": ("power", "driving", "driving")}


def test_a_cycle_of_signals_goes_on_or_ends_as_its_signals_say(tmp_path):
    life = Life(tmp_path / "f.sqlite", catalogue(**DRIVING))
    life.start()
    life.start("driving")
    life.result(1, True)
    life.die()
    life.start()
    assert life.memory.cycles.is_left_open("driving")
    assert life.memory.cycle_number("driving") == 1
    assert life.memory.cycles.go_on("driving"), "the signal is as it was"
    assert not life.memory.cycles.is_left_open("driving")
    assert not life.memory.cycles.go_on("driving"), "once"
    assert life.memory.status_now("m.f1") & Status.TEST_FAILED_THIS_CYCLE
    life.die()
    life.start()
    life.end("driving")  # the signal has gone off meanwhile
    assert not life.memory.cycles.go_on("driving")
    life.start("driving")
    assert life.memory.cycle_number("driving") == 2
    assert not life.memory.status_now("m.f1") & Status.TEST_FAILED_THIS_CYCLE
    life.die()
    life.start()
    life.start("driving")  # a begin completes what was left open
    assert life.memory.cycle_number("driving") == 3
    life.die()
    life.start()
    life.end()  # in order: all that is open
    assert not any(cycle.open for cycle in life.store.cycles().values())
    life.start()
    assert not life.memory.cycles.is_left_open("driving")
    life.close()


def test_a_successor_in_the_same_process_knows_what_was_left_open(tmp_path):
    life = Life(tmp_path / "f.sqlite", catalogue(**DRIVING))
    life.start()
    life.start("driving")
    life.die()
    life.start()
    reloaded = FaultMemory(life.catalogue, life.store)
    reloaded.succeed(life.memory)
    assert reloaded.cycles.is_left_open("driving")
    reloaded.start_cycle(9)
    assert reloaded.cycle_number() == 2, "power was begun by this process: a further start is a new cycle"
    life.close()


def test_a_death_while_a_cycle_ends_and_the_next_begins_leaves_either_whole(tmp_path):
    """The files before and after each commit: number, state, counter and status byte go together."""
    life = Life(tmp_path / "f.sqlite")
    images = []
    save = Store.save

    def snapshot(store, changes, whole=None):
        images.append(copy_of(life.path, tmp_path / f"{len(images)}.sqlite"))
        save(store, changes, whole)
        images.append(copy_of(life.path, tmp_path / f"{len(images)}.sqlite"))

    life.start()
    life.result(0, True)
    life.end()
    life.start()
    life.result(0, False)
    life.memory.commit()
    Store.save = snapshot
    try:
        life.end()
        life.start()
    finally:
        Store.save = save
    life.close()
    seen = set()
    for image in images:
        store = Store(image)
        cycle, record = store.cycles()["power"], FaultMemory(catalogue(), store).record("m.f0")
        seen.add((cycle.number, cycle.open, record.cycles.passed, record.status & 0x44))
        store.close()
    assert seen == {(2, True, 0, 0x04), (2, False, 1, 0), (3, True, 1, 0x40)}


def copy_of(path, image):
    for suffix in ("", "-wal"):
        source = Path(f"{path}{suffix}")
        if source.exists():
            shutil.copyfile(source, f"{image}{suffix}")
    return image


class Reference:
    """Counters of one fault, by the words of the standards; a death is not among its calls."""

    def __init__(self, rules):
        self.rules = rules
        self.open = False
        self.clear()

    def clear(self):
        self.pending = self.confirmed = self.lit = self.stored = self.now = False
        self.failed = self.passed = self.aged = 0
        self.failed_here = self.tested_here = False

    def begin(self):
        if self.open:
            self.end()
        self.open = True
        self.failed_here = self.tested_here = False

    def end(self):
        if not self.open:
            return
        self.open = False
        if not self.tested_here or self.failed_here:
            return
        quiet = self.stored and not (self.lit or self.pending or self.now)
        self.pending, self.failed, self.passed = False, 0, self.passed + 1
        if self.passed >= self.rules.healing_cycles:
            self.lit = False
        if quiet:
            self.aged += 1
            if self.aged >= self.rules.aging_cycles:
                self.confirmed = self.stored = False
                self.failed = self.aged = 0
                self.passed = 1

    def result(self, failed):
        if not self.open:
            return
        self.tested_here = True
        self.now = failed
        if not failed:
            return
        self.failed += not self.failed_here
        self.failed_here = self.pending = self.stored = True
        self.passed = self.aged = 0
        if self.failed >= self.rules.confirm_cycles:
            self.confirmed = True
            self.lit = self.lit or self.rules.indicator

    def state(self):
        return (
            self.now, self.failed_here, self.pending, self.confirmed, not self.tested_here, self.lit, self.stored,
            self.aged, self.failed,
        )  # fmt: skip


def state_of(record):
    bits = (0x01, 0x02, 0x04, 0x08, 0x40, 0x80)
    flags = tuple(bool(record.status & bit) for bit in bits)
    return (*flags, record.occurrence > 0, record.cycles.aged, record.cycles.failed)


class LivesAgainstReference(RuleBasedStateMachine):
    """Any sequence of results, ends in order, deaths, reloads, clears, and begins and ends by signals."""

    steps = deaths = 0

    def __init__(self):
        super().__init__()
        fast = Path("/dev/shm")
        self.folder = Path(tempfile.mkdtemp(dir=fast if fast.is_dir() else None))
        self.life = Life(self.folder / "f.sqlite", catalogue(**DRIVING))
        self.models = [Reference(definition.rules) for definition in self.life.catalogue]
        self.cycles = [definition.cycle for definition in self.life.catalogue]
        self.number = {"power": 0, "driving": 0}
        self.is_open = {"power": False, "driving": False}
        self.left = False  # whether the driving cycle was left open, and nothing is known of it
        self.start()

    def teardown(self):
        self.life.close()
        shutil.rmtree(self.folder)

    def of(self, *names):
        return [model for name, model in zip(self.cycles, self.models, strict=True) if name in names]

    def model_end(self, name):
        for model in self.of(name):
            model.end()
        self.is_open[name] = False

    def model_begin(self, name):
        for model in self.of(name):
            model.begin()
        self.number[name] += 1
        self.is_open[name] = True

    def start(self):
        """A process begins, or a tester asks for the next cycle."""
        if self.is_open["power"]:
            self.end()
        self.life.start()
        self.model_begin("power")

    @rule()
    def end(self):
        """An end in order ends all cycles."""
        if self.is_open["power"]:
            self.life.end()
            self.model_end("driving")
            self.model_end("power")
            self.left = False

    @rule()
    def stop_and_start(self):
        self.end()
        self.life.die()
        self.start()

    @rule()
    def death(self):
        LivesAgainstReference.deaths += 1
        self.life.die()
        self.left = self.is_open["driving"]
        if self.is_open["power"]:
            self.life.start()
        else:
            self.start()

    @rule()
    def reload(self):
        successor = FaultMemory(self.life.catalogue, self.life.store)
        successor.succeed(self.life.memory)
        self.life.memory = successor

    @rule(seen_on=st.booleans())
    def signal(self, seen_on):
        """The signal of the driving cycle is heard, as the gateway takes it."""
        if not self.is_open["power"]:
            return
        if self.left and seen_on:
            assert self.life.memory.cycles.go_on("driving")
        elif seen_on and not self.is_open["driving"]:
            self.life.start("driving")
            self.model_begin("driving")
        elif not seen_on and self.is_open["driving"]:
            self.life.end("driving")
            self.model_end("driving")
        self.left = False

    @rule(fault=st.integers(0, 2), failed=st.booleans())
    def result(self, fault, failed):
        if self.cycles[fault] == "driving" and self.left:
            return  # the engine's gate is closed
        self.life.result(fault, failed)
        self.models[fault].result(failed)

    @rule(fault=st.integers(0, 2), count=st.integers(1, 4))
    def quiet_cycles(self, fault, count):
        for _ in range(count):
            self.end()
            self.start()
            self.signal(True)
            self.result(fault, False)

    @rule(fault=st.integers(0, 3))
    def clear(self, fault):
        group = 0xFFFFFF if fault == 3 else self.life.catalogue[fault].dtc.value
        self.life.memory.clear(group)
        for k in range(3) if fault == 3 else [fault]:
            self.models[k].clear()

    @invariant()
    def agree(self):
        LivesAgainstReference.steps += 1
        memory = self.life.memory
        assert {name: memory.cycle_number(name) for name in self.number} == self.number
        assert memory.cycles.is_left_open("driving") == self.left
        for definition, model in zip(self.life.catalogue, self.models, strict=True):
            assert state_of(memory.record(definition.id)) == model.state(), definition.id


@pytest.mark.long
def test_a_death_is_neutral_in_any_life():
    LivesAgainstReference.steps = LivesAgainstReference.deaths = 0
    LivesAgainstReference.TestCase.settings = settings(
        max_examples=amount(600, 30, 10), stateful_step_count=60, deadline=None, derandomize=True
    )
    LivesAgainstReference.TestCase().runTest()
    print(f"{LivesAgainstReference.steps} steps, {LivesAgainstReference.deaths} deaths")
    assert LivesAgainstReference.deaths


@pytest.mark.long
def test_a_thousand_deaths_among_results_leave_what_one_cycle_leaves(tmp_path):
    rng = random.Random(6501)
    print("seed 6501")
    results = [(rng.randrange(3), rng.random() < 0.3) for _ in range(amount(1000, 300, 100))]
    lives = [Life(tmp_path / f"{k}.sqlite") for k in range(2)]
    for life, dies in zip(lives, (True, False), strict=True):
        life.start()
        for fault, failed in results:
            life.result(fault, failed)
            if dies:
                life.die()
                life.start()
        life.end()
    assert lives[0].state() == lives[1].state()
    for life in lives:
        life.close()
