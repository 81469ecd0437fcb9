"""The live loop: what the taps get, what the gateway gets, and in what order work is done."""

import gc
import os
import weakref

import pytest

from gateway.bus.base import Bus
from gateway.bus.conditions import STEPPED
from gateway.bus.frames import ERROR, OWN, empty, put
from gateway.live.clock import Clock
from gateway.live.link import Link
from gateway.live.loop import Live, collect_and_freeze
from gateway.runtime.fast_path_conditions import FastPathConditions
from gateway_commands.recording import Nobody


class Queue(Bus):
    """Gives what was put in; may return what it sends."""

    def __init__(self, uri, index, *, echoing=False):
        super().__init__(uri, index)
        self._event = os.eventfd(1)
        self.waiting = []
        self.sent = []
        self.echoing = echoing
        self.filters = []

    def fileno(self):
        return self._event

    def receive(self, out):
        part, self.waiting = self.waiting[: len(out)], self.waiting[len(out) :]
        for k, (can_id, flags) in enumerate(part):
            put(out, k, 10**9 + k, can_id, b"", bus=self.index, flags=flags)
        self.statistics.received += len(part)
        return len(part)

    def send(self, frames):
        self.sent += frames["can_id"].tolist()
        return len(frames)

    def set_filters(self, can_ids):
        self.filters.append(can_ids)

    def set_echo(self, on):
        return on and self.echoing

    def close(self):
        os.close(self._event)


class Talker(Nobody):
    """Sends a frame for each batch, and wants one identifier."""

    def __init__(self):
        super().__init__()
        self.got = []
        self.noted = []
        self.advanced = 0

    def feed(self, frames):
        self.got += frames["can_id"].tolist()
        out = empty(1)
        put(out, 0, 0, 0x6F0, b"")
        return out

    def advance(self, t_ns):
        self.advanced += 1
        return empty(0)

    def identifiers_on(self, bus):
        return [0x10]

    def note_buses(self, states):
        self.noted.append(states)


class Tap:
    def __init__(self):
        self.got = []

    def write(self, frames):
        self.got += [(int(f["can_id"]), bool(f["flags"] & OWN)) for f in frames]


class Door:
    """Nobody comes; somebody may watch."""

    watched = False

    def __init__(self):
        self._event = os.eventfd(0)

    def fileno(self):
        return self._event

    def listening(self):
        return self.watched

    def on_frames(self, frames):
        pass

    def turn(self, now_s, *, wanted):
        pass


def rig(*, echoing=False, taps=(), tick_s=0.0, door=None):
    queues = []

    def opener(uri, index):
        queues.append(Queue(uri, index, echoing=echoing))
        return queues[-1]

    clock = Clock()
    link = Link("test:queue", 0, "b", opener, clock)
    link.start()
    gateway, events = Talker(), []
    live = Live(gateway, [link], events.append, taps=taps, clock=clock, tick_s=tick_s, door=door)
    live.turn()
    return live, gateway, queues[0], events, link


def test_time_does_not_overtake_frames_that_wait():
    """After a pause of the process more is queued than one turn takes: no timer may run ahead of it."""
    live, gateway, queue, _, _ = rig()
    queue.waiting = [(0x10, 0)] * 5000
    while queue.waiting:
        live.turn()
    assert len(gateway.got) == 1 + 5000
    assert gateway.advanced == 0
    os.eventfd_read(queue.fileno())
    live.turn()
    assert gateway.advanced == 1, "without traffic it passes"


def test_a_quiet_bus_is_waited_for_unless_something_else_is():
    live, gateway, queue, _, _ = rig(tick_s=0.01, door=Door())
    os.eventfd_read(queue.fileno())
    run, left = live._pump.run, []

    def noted(buses, door, clock, quiet, *, leave_ns, **more):
        left.append(leave_ns - clock.now())
        return run(buses, door, clock, quiet, leave_ns=0, **more)

    live._pump.run = noted

    def waits(*, idle, watched=False):
        gateway.quiet, live._door.watched = lambda: FastPathConditions(idle=idle), watched
        live._poll = live._monotonic() + 1.0
        live.turn()
        return round(left[-1] / 1e9, 2)

    assert waits(idle=False) == 0.01, "something else than time is waited for"
    assert waits(idle=True) == 0.1, "other processes may ask for something"
    assert waits(idle=True, watched=True) == 0.01, "who watches is shown the time"


def test_without_taps_the_bus_is_filtered_and_with_them_it_is_not():
    live, _, queue, _, _ = rig()
    assert queue.filters[-1] == [0x10]
    tap = Tap()
    live, gateway, queue, _, _ = rig(taps=[tap])
    assert queue.filters[-1] is None
    live.replace(gateway, live.links, [])
    assert queue.filters[-1] == [0x10], "the recording has ended"


def test_own_frames_that_come_back_are_for_the_taps_only():
    tap = Tap()
    live, gateway, queue, _, _ = rig(echoing=True, taps=[tap])
    queue.waiting = [(0x10, 0), (0x6F0, OWN), (0x11, 0)]
    live.turn()
    assert gateway.got == [ERROR, 0x10, 0x11]
    assert tap.got == [(ERROR, False), (0x10, False), (0x6F0, True), (0x11, False)]


def test_where_they_do_not_come_back_they_are_recorded_as_they_leave():
    tap = Tap()
    live, _, queue, _, link = rig(taps=[tap])
    queue.waiting = [(0x10, 0)]
    live.turn()
    assert tap.got == [(ERROR, False), (0x6F0, True), (0x10, False), (0x6F0, True)]
    assert queue.sent == [0x6F0, 0x6F0]
    link.close()
    queue.waiting = []
    live.turn()


def test_lost_frames_are_told_once_a_second_at_most_and_kept():
    live, gateway, queue, events, _ = rig()
    assert [e["state"] for e in events] == ["open"]
    for _ in range(5):
        queue.statistics.overflow += 3
        queue.losses = [(0, 3)]
        queue.waiting = [(0x10, 0)]
        live._poll = 0.0
        live.turn()
    told = [e["overflow"] for e in events if e["state"] == "overflow"]
    assert told == [3]
    assert gateway.noted[-1][0]["overflow"] >= 3
    live._told = {key: (*counts, when - 2.0) for key, (*counts, when) in live._told.items()}
    live._poll = 0.0
    live.turn()
    assert [e["overflow"] for e in events if e["state"] == "overflow"] == [3, 15]


def test_exceptions_of_a_driver_are_told_once_a_second_at_most():
    live, gateway, queue, events, _ = rig()
    for _ in range(3):
        queue.statistics.driver_errors += 1
        live._poll = 0.0
        live.turn()
    assert [e["driver_errors"] for e in events if e["state"] == "failing"] == [1]
    assert gateway.noted[-1][0]["driver_errors"] >= 1


def test_conditions_of_a_bus_are_events_but_lost_frames_are_not_one_each():
    live, _, queue, events, _ = rig()
    queue.losses = [(0, 1)]
    queue.waiting = [(0x10, 0)]
    live.turn()
    assert [e["state"] for e in events] == ["open"]


def test_where_the_clock_was_set_taps_get_its_stamps_and_who_records_is_told():
    """The recording has the stamps of the wall clock, and a frame where they begin to be of another time."""
    now = [10**12, 10**18]  # monotonic, and what the wall clock is ahead
    clock = Clock(lambda: sum(now), lambda: now[0])
    queues, events, stamps = [], [], []

    class Stamped(Queue):
        def receive(self, out):
            count = super().receive(out)
            out["t_ns"][:count] = sum(now)
            return count

    class Taker:
        def write(self, frames):
            stamps.extend((int(f["can_id"]), int(f["t_ns"]) - now[0] - 10**18) for f in frames)

    def opener(uri, index):
        queues.append(Stamped(uri, index))
        return queues[-1]

    link = Link("test:queue", 0, "b", opener, clock)
    link.start()
    live = Live(Nobody(events.append), [link], events.append, taps=[Taker()], clock=clock, tick_s=0)
    live.turn()
    for step in (0, -3600 * 10**9, 5 * 10**9):
        now[0] += 10**7
        now[1] += step
        queues[0].waiting = [(0x10, 0)]
        live.turn()
    back, on = -3600 * 10**9, -3595 * 10**9
    assert stamps == [(ERROR, 0), (0x10, 0), (ERROR, back), (0x10, back), (ERROR, on), (0x10, on)]
    told = [(e["step_s"], e["t_ns"] - 10**18) for e in events if e["event"] == "clock"]
    assert told == [(-3600.0, 10**12 + 2 * 10**7 + back), (5.0, 10**12 + 3 * 10**7 + on)]


def test_nobody_on_the_bus_sets_our_clock():
    live, gateway, queue, _, link = rig()
    queue.waiting = [(ERROR, 0), (0x10, 0)]
    original = queue.receive

    def forged(out):
        count = original(out)
        out["data"][:count, 0] = STEPPED
        return count

    queue.receive = forged
    live.turn()
    assert gateway.got == [ERROR, 0x10], "the first is of the opening"
    assert link.statistics.rejected == 1


class Knot:
    """Refers to itself."""

    def __init__(self):
        self.itself = self


def test_after_a_reload_only_what_came_since_is_looked_through():
    """All that a process has takes longer to look through than a tester waits for an answer."""
    gc.unfreeze()
    collect_and_freeze(False)
    frozen = gc.get_freeze_count()
    try:
        assert frozen > 1000
        since = Knot()
        gone = weakref.ref(since)
        del since
        collect_and_freeze(True)
        assert gone() is None
        assert gc.get_freeze_count() == pytest.approx(frozen, rel=0.01)
    finally:
        gc.unfreeze()
        gc.freeze()  # as the suite has it
