"""The status byte against a reference model written from the bits' definitions, not from our code."""

import pytest
from fault_examples import catalogue, event, nothing
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from gateway.faults.memory import FaultMemory
from gateway.faults.status import CLEARED, Status
from gateway.faults.store import Store


class Model:
    """ISO 14229-1 D.2, bit by bit, from the history since the last clear.

    Every bit is worked out anew from the list of what happened, so no transition is written down.
    """

    def __init__(self, confirm):
        self.confirm = confirm
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
        pending, trips, confirmed = False, 0, False
        counted = False
        completed = failed = False
        for item in self.history:
            if item == "F":
                pending = True
                completed = failed = True
                if not counted:
                    trips += 1
                    counted = True
                confirmed = confirmed or trips >= self.confirm
            elif item == "P":
                completed = True
            elif item == "start":
                completed = failed = counted = False
            elif item == "end" and completed and not failed:
                pending, trips = False, 0
        value |= 0x04 if pending else 0
        value |= 0x08 if confirmed else 0
        return value


class MemoryAgainstModel(RuleBasedStateMachine):
    def __init__(self):
        super().__init__()
        self.catalogue = catalogue()
        self.store = Store(None)
        self.memory = FaultMemory(self.catalogue, self.store)
        self.models = [Model(definition.confirm_cycles) for definition in self.catalogue]
        self.running = False
        self.t_ns = 0

    def tell(self, item):
        for model in self.models:
            model.history.append(item)

    @rule(fault=st.integers(0, 2), failed=st.booleans())
    def result(self, fault, failed):
        if not self.running:
            return
        self.t_ns += 1
        self.memory.apply(event(fault, failed, self.t_ns), nothing)
        self.models[fault].history.append("F" if failed else "P")

    @rule()
    def start(self):
        if self.running:  # as after kill -9: the open cycle is ended first
            self.tell("end")
        self.memory.start_cycle(self.t_ns)
        self.tell("start")
        self.running = True

    @rule()
    def end(self):
        if self.running:
            self.memory.end_cycle(self.t_ns)
            self.tell("end")
            self.running = False

    @rule()
    def restart(self):
        """The process ends after a commit, and another one opens the memory."""
        self.memory.commit()
        self.memory = FaultMemory(self.catalogue, self.store)

    @rule(fault=st.integers(0, 3))
    def clear(self, fault):
        group = 0xFFFFFF if fault == 3 else self.catalogue[fault].dtc.value
        self.memory.clear(group)
        for k in range(3) if fault == 3 else [fault]:
            # What a clear keeps of the past is only whether a cycle runs, nothing completed in it.
            self.models[k].history = ["start"] if self.running else ["start", "end"]

    @invariant()
    def bytes_agree(self):
        for definition, model in zip(self.catalogue, self.models, strict=True):
            ours = int(self.memory.status(definition.id)) & 0x7F
            assert ours == model.byte(), (definition.id, model.history)

    @invariant()
    def bits_that_imply_each_other(self):
        for definition in self.catalogue:
            status = self.memory.status(definition.id)
            if status & Status.TEST_FAILED:
                assert status & Status.FAILED_SINCE_CLEAR
            if status & Status.TEST_FAILED_THIS_CYCLE:
                assert status & Status.PENDING_DTC
                assert not status & Status.NOT_COMPLETED_THIS_CYCLE
            if status & Status.CONFIRMED_DTC:
                assert status & Status.FAILED_SINCE_CLEAR
            assert bool(status & Status.WARNING_INDICATOR) == (
                definition.indicator and bool(status & Status.CONFIRMED_DTC)
            )


MemoryAgainstModel.TestCase.settings = settings(
    max_examples=150, stateful_step_count=40, deadline=None
)
TestMemoryAgainstModel = MemoryAgainstModel.TestCase


def test_a_failure_and_its_healing_by_hand():
    memory = FaultMemory(catalogue((1,)), Store(None))
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


@pytest.mark.parametrize("confirm", [2, 3])
def test_confirmation_takes_failed_cycles(confirm):
    memory = FaultMemory(catalogue((confirm,)), Store(None))
    for cycle in range(1, confirm + 1):
        memory.start_cycle(cycle)
        for _ in range(5):
            memory.apply(event(0, True), nothing)
            memory.apply(event(0, False), nothing)
        confirmed = bool(memory.status("m.f0") & Status.CONFIRMED_DTC)
        assert confirmed == (cycle == confirm)
        memory.end_cycle(cycle)


def test_a_good_cycle_starts_the_count_anew():
    memory = FaultMemory(catalogue((2,)), Store(None))
    for results in ([True], [False], [True]):
        memory.start_cycle(0)
        for failed in results:
            memory.apply(event(0, failed), nothing)
        memory.end_cycle(0)
    assert not memory.status("m.f0") & Status.CONFIRMED_DTC
