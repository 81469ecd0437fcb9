"""The status byte against a reference model written from the bits' definitions, not from our code."""

import shutil
import tempfile
from pathlib import Path

import pytest
from amount import amount
from fault_examples import RULES, AtOnce, catalogue, event, nothing
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from gateway.faults import status as transition
from gateway.faults.memory import FaultMemory
from gateway.faults.status import CLEARED, Status
from gateway.faults.store import Store


class Model:
    """ISO 14229-1 D.2 and AUTOSAR's healing and aging, from the history since the last clear.

    Every bit is worked out anew from the list of what happened, so no transition is written down.
    """

    def __init__(self, rules):
        self.rules = rules
        self.history = []  # "F", "P", "start", "end"

    def cycles(self):
        """The history cut into cycles; the last one may be running."""
        found, current = [], None
        for item in self.history:
            if item == "start":
                current = []
                found.append(current)
            elif item == "end":
                current = None
            elif current is not None:
                current.append(item)
        return found

    def byte(self):
        results = [item for item in self.history if item in "FP"]
        cycles = self.cycles()
        # Since a start the running (or last) cycle's results; before the first start: none.
        this = cycles[-1] if cycles else []
        if "start" not in self.history:
            this = results
        value = 0
        if results and results[-1] == "F":
            value |= 0x01
        if "F" in this:
            value |= 0x02
        if not results:
            value |= 0x10
        if "F" in results:
            value |= 0x20
        if not this:
            value |= 0x40
        pending, confirmed, lit, _ = self.memory_bits()
        value |= 0x04 if pending else 0
        value |= 0x08 if confirmed else 0
        return value | (0x80 if lit else 0)

    def memory_bits(self):
        """Pending, confirmed, indicator, and whether there is an entry: cycle by cycle, each judged whole."""
        pending = confirmed = lit = stored = False
        trips = healed = aged = 0
        ended = self.history.count("end")
        for number, cycle in enumerate(self.cycles()):
            before = pending or lit
            if "F" in cycle:
                pending, stored, trips = True, True, trips + 1
                healed = aged = 0
                if trips >= self.rules.confirm_cycles:
                    confirmed = True
                    lit = lit or self.rules.indicator
            elif cycle and number < ended:
                healed += 1
                pending, trips = False, 0
                lit = lit and healed < self.rules.healing_cycles
                if stored and not before:
                    aged += 1
                    if aged >= self.rules.aging_cycles:
                        confirmed = stored = False
                        aged = 0
        return pending, confirmed, lit, stored


class MemoryAgainstModel(RuleBasedStateMachine):
    """Random lives of three faults, on a real file, with restarts and kills.

    The third fault has an operation cycle of its own, within that of the others. Results come at any time; the model
    decides which of them count: those of a running cycle.
    """

    steps = 0

    def __init__(self):
        super().__init__()
        # A file in memory is as good for this: a kill loses nothing that the kernel has.
        fast = Path("/dev/shm")
        self.folder = Path(tempfile.mkdtemp(dir=fast if fast.is_dir() else None))
        self.path = self.folder / "0.sqlite"
        self.catalogue = catalogue(cycle=("power", "power", "driving"), aging_cycle=("power", "power", "driving"))
        self.open()
        self.models = [Model(rules) for rules in RULES]
        self.durable = [[] for _ in RULES]
        self.running = {"power": False, "driving": False}
        self.begun = False
        self.t_ns = self.files = 0

    def open(self):
        self.store = Store(self.path)
        self.memory = FaultMemory(self.catalogue, self.store)
        self.left_open = True  # by the process before, if there was one

    def teardown(self):
        self.store.close()
        shutil.rmtree(self.folder)

    def tell(self, item, cycle):
        self.running[cycle] = item == "start"
        for definition, model in zip(self.catalogue, self.models, strict=True):
            if definition.cycle == cycle:
                model.history.append(item)

    def end_running(self, *cycles):
        for cycle in cycles:
            if self.running[cycle]:
                self.tell("end", cycle)

    def committed(self):
        """What the models know now is what a kill must leave."""
        self.durable = [list(model.history) for model in self.models]
        self.durable_running = dict(self.running)

    @rule(fault=st.integers(0, 2), failed=st.booleans())
    def result(self, fault, failed):
        if not self.begun:
            return
        self.t_ns += 1
        self.memory.apply(event(fault, failed, self.t_ns), nothing)
        if self.running[self.catalogue[fault].cycle]:
            self.models[fault].history.append("F" if failed else "P")

    @rule(fault=st.integers(0, 2), cycles=st.integers(1, 5))
    def quiet_cycles(self, fault, cycles):
        """Cycles in which one test passes: healing and aging come about."""
        for _ in range(cycles):
            self.start()
            self.drive()
            self.result(fault, False)
        self.end()

    @rule()
    def commit(self):
        self.memory.commit()
        self.committed()

    @rule()
    def start(self):
        self.memory.start_cycle(self.t_ns)
        if not (self.left_open and self.running["power"]):  # else it goes on: a death ends nothing
            self.end_running("driving", "power")
            self.tell("start", "power")
        self.left_open = False
        self.begun = True
        self.committed()

    @rule()
    def end(self):
        if self.running["power"]:
            self.memory.end_cycle(self.t_ns)
            self.end_running("driving", "power")
            self.committed()

    @rule()
    def drive(self):
        if self.running["power"]:
            self.end_running("driving")
            self.memory.start_cycle(self.t_ns, "driving")
            self.tell("start", "driving")
            self.committed()

    @rule()
    def park(self):
        self.memory.end_cycle(self.t_ns, "driving")
        self.end_running("driving")
        self.committed()

    @rule()
    def restart(self):
        """The process ends after a commit, and another one opens the memory."""
        self.commit()
        self.store.close()
        self.open()

    @rule()
    def kill(self):
        """kill -9: what the files hold at this moment is all there is; nothing is flushed or closed."""
        if not any(self.durable):
            self.commit()
        self.files += 1
        image = self.folder / f"{self.files}.sqlite"
        for suffix in ("", "-wal"):
            source = Path(f"{self.path}{suffix}")
            if source.exists():
                shutil.copyfile(source, f"{image}{suffix}")
        self.store.close()
        self.path = image
        self.open()
        for model, history in zip(self.models, self.durable, strict=True):
            model.history = list(history)
        self.running = dict(self.durable_running)

    @rule(fault=st.integers(0, 3))
    def clear(self, fault):
        group = 0xFFFFFF if fault == 3 else self.catalogue[fault].dtc.value
        self.memory.clear(group)
        for k in range(3) if fault == 3 else [fault]:
            # What a clear keeps of the past is only whether a cycle runs, nothing completed in it.
            running = self.running[self.catalogue[k].cycle]
            self.models[k].history = ["start"] if running else ["start", "end"]
        self.committed()

    @invariant()
    def bytes_agree(self):
        MemoryAgainstModel.steps += 1
        for definition, model in zip(self.catalogue, self.models, strict=True):
            ours = int(self.memory.status_now(definition.id))  # reading would commit
            assert ours == model.byte(), (
                definition.id,
                hex(ours),
                hex(model.byte()),
                model.history,
            )

    @invariant()
    def bits_that_imply_each_other(self):
        for definition in self.catalogue:
            status = self.memory.status_now(definition.id)
            if status & Status.TEST_FAILED:
                assert status & Status.FAILED_SINCE_CLEAR
            if status & Status.TEST_FAILED_THIS_CYCLE:
                assert status & Status.PENDING_DTC
                assert not status & Status.NOT_COMPLETED_THIS_CYCLE
            if status & Status.CONFIRMED_DTC:
                assert status & Status.FAILED_SINCE_CLEAR
            if status & Status.WARNING_INDICATOR:
                assert definition.indicator
                assert status & Status.CONFIRMED_DTC


@pytest.mark.evidence("AUTOSAR DEM: status byte")
@pytest.mark.long
def test_random_lives_agree_with_the_model():
    """100 000 steps if all of it is run."""
    MemoryAgainstModel.steps = 0
    MemoryAgainstModel.TestCase.settings = settings(
        max_examples=amount(1200, 30, 15), stateful_step_count=100, deadline=None, derandomize=True
    )
    MemoryAgainstModel.TestCase().runTest()
    print(f"{MemoryAgainstModel.steps} steps")
    assert MemoryAgainstModel.steps >= amount(100_000, 1_800, 900)


@pytest.mark.evidence("AUTOSAR DEM: failure")
def test_a_failure_and_its_healing_by_hand():
    memory = AtOnce(catalogue(), Store(None))
    assert memory.status("m.f0") == CLEARED == 0x50
    memory.start_cycle(0)
    assert memory.status("m.f0") == 0x50
    memory.apply(event(0, False), nothing)
    assert memory.status("m.f0") == 0x00
    memory.apply(event(0, True), nothing)
    assert memory.status("m.f0") == 0x2F
    memory.apply(event(0, False), nothing)
    assert memory.status("m.f0") == 0x2E
    memory.end_cycle(1)
    memory.start_cycle(2)
    assert memory.status("m.f0") == 0x6C
    memory.apply(event(0, False), nothing)
    memory.end_cycle(3)
    assert memory.status("m.f0") == 0x28
    memory.clear()
    assert memory.status("m.f0") == 0x50


def one_cycle(memory, fault, *failed):
    memory.start_cycle(0)
    for each in failed:
        memory.apply(event(fault, each), nothing)
    memory.end_cycle(0)
    return int(memory.status(f"m.f{fault}"))


@pytest.mark.evidence("AUTOSAR DEM: healing")
def test_healing_and_aging_by_hand():
    """m.f1: confirmed by 2 failed cycles, healed by 2 good ones, aged by 3 more; it asks for the indicator."""
    memory = AtOnce(catalogue(), Store(None))
    assert one_cycle(memory, 1, True) == 0x27, "pending"
    assert one_cycle(memory, 1, True) == 0xAF, "confirmed, and lit"
    assert one_cycle(memory, 1) == 0xED, "not tested: all stays but this cycle's bits"
    assert one_cycle(memory, 1, False) == 0xA8, "no longer pending, still lit"
    assert one_cycle(memory, 1, False) == 0x28, "healed"
    assert one_cycle(memory, 1, False) == 0x28
    assert one_cycle(memory, 1) == 0x68, "a cycle without a test does not age"
    assert one_cycle(memory, 1, False) == 0x28
    assert memory.entry("m.f1").record.occurrence == 1
    assert one_cycle(memory, 1, False) == 0x20, "aged: only that it failed since the clear is known"
    assert memory.entries() == []


@pytest.mark.evidence("AUTOSAR DEM: confirmation")
@pytest.mark.parametrize("confirm", [2, 3])
def test_confirmation_takes_failed_cycles(confirm):
    memory = AtOnce(catalogue(confirm=(confirm,)), Store(None))
    for cycle in range(1, confirm + 1):
        memory.start_cycle(cycle)
        for _ in range(5):
            memory.apply(event(0, True), nothing)
            memory.apply(event(0, False), nothing)
        confirmed = bool(memory.status("m.f0") & Status.CONFIRMED_DTC)
        assert confirmed == (cycle == confirm)
        memory.end_cycle(cycle)


@pytest.mark.evidence("AUTOSAR DEM: confirmation")
def test_a_good_cycle_starts_the_count_anew():
    memory = AtOnce(catalogue(confirm=(2,)), Store(None))
    for results in ([True], [False], [True]):
        memory.start_cycle(0)
        for failed in results:
            memory.apply(event(0, failed), nothing)
        memory.end_cycle(0)
    assert not memory.status("m.f0") & Status.CONFIRMED_DTC


@pytest.mark.evidence("AUTOSAR DEM: operation cycle")
def test_a_failure_outside_its_operation_cycle_is_no_trip():
    """Two trips confirm: a failure before the drive, and one in the first drive, are one trip."""
    memory = AtOnce(catalogue(confirm=(2,), cycle=("drive",)), Store(None))
    memory.start_cycle(0)
    assert memory.apply(event(0, True), nothing) == []
    assert memory.status("m.f0") == CLEARED, "its drive has not begun"
    assert memory.entries() == []
    memory.start_cycle(1, "drive")
    memory.apply(event(0, True), nothing)
    assert int(memory.status("m.f0")) == 0x27, "the first trip"
    memory.end_cycle(2, "drive")
    memory.apply(event(0, False), nothing)
    memory.apply(event(0, True), nothing)
    assert int(memory.status("m.f0")) == 0x27, "the drive is over"
    assert memory.entry("m.f0").record.occurrence == 1
    memory.start_cycle(3, "drive")
    memory.apply(event(0, True), nothing)
    assert int(memory.status("m.f0")) == 0x2F, "the second trip"


def test_a_confirmation_that_waits_takes_nothing_back():
    """Bits 3 and 7 wait only where the DTC is not confirmed yet; all others are set as ever."""
    lit = transition.Rules(indicator=True)
    new, cycles = transition.on_failed(transition.CLEARED, transition.Cycles(), lit, wait=True)
    assert (int(new), cycles.failed) == (0x27, 1)
    assert int(transition.on_awaited(new, cycles, lit)) == 0xAF
    healed = transition.STATUS[0x28]
    again, _ = transition.on_failed(healed, transition.Cycles(), lit, wait=True)
    assert int(again) == 0xAF, "it was confirmed before: its lamp is lit anew"
    passed = transition.STATUS[0x20]
    assert transition.on_awaited(passed, transition.Cycles(), lit) == passed, "a whole cycle has passed well"
    twice = transition.Rules(confirm_cycles=2)
    assert int(transition.on_awaited(transition.STATUS[0x27], transition.Cycles(failed=1), twice)) == 0x27
