"""A bus that comes and goes."""

import numpy as np
import pytest

from gateway.bus.base import Bus
from gateway.bus.conditions import LOSS, LOST, RUNNING
from gateway.bus.frames import ERROR, empty, put
from gateway.live.clock import Clock
from gateway.live.link import LONGEST_WAIT_S, Link
from gateway_fdi.errors import BusError, InputError, UnsupportedError


class Cable(Bus):
    """A bus whose plug can be pulled."""

    def __init__(self, world, uri, index):
        super().__init__(uri, index)
        if not world.plugged:
            raise BusError(f"{uri}: no such device")
        self.world = world
        world.opened += 1

    def fileno(self):
        return 0

    def receive(self, out):
        waiting, self.world.waiting = self.world.waiting, []
        for k, can_id in enumerate(waiting):
            put(out, k, self.world.now_ns + k, can_id, b"", bus=self.index)
        self.losses, self.world.losses = self.world.losses, []
        self.statistics.received += len(waiting)
        self.statistics.overflow += sum(lost for _, lost in self.losses)
        if not self.world.plugged and not waiting:
            raise BusError("network is down")
        return len(waiting)

    def send(self, frames):
        if not self.world.plugged:
            raise BusError("network is down")
        self.world.sent += len(frames)
        self.statistics.sent += len(frames)
        return len(frames)

    def set_filters(self, can_ids):
        if self.world.refusing:
            raise BusError("network is down")
        self.world.filters.append(can_ids)

    def close(self):
        self.world.closed += 1


class World:
    def __init__(self):
        self.plugged, self.now_ns, self.now_s = True, 1000, 0.0
        self.waiting, self.losses, self.filters = [], [], []
        self.opened = self.closed = self.sent = 0
        self.refusing = False

    def link(self):
        return Link(
            "test:cable", 0, "chassis",
            lambda uri, index: Cable(self, uri, index),
            Clock(lambda: self.now_ns, lambda: self.now_ns),
            monotonic=lambda: self.now_s,
        )  # fmt: skip


def conditions(frames):
    return [int(f["data"][0]) if f["can_id"] == ERROR else hex(int(f["can_id"])) for f in frames]


def test_a_bus_that_is_missing_at_the_start_is_waited_for():
    world = World()
    world.plugged = False
    link = world.link()
    link.start()
    frames, more = link.receive()
    assert conditions(frames) == [LOST]
    assert not more
    assert (link.running, link.fileno(), link.reason) == (False, None, "test:cable: no such device")
    tries = 0
    while world.now_s < 20:
        world.now_s += 0.01
        if link.due_s <= 0:
            tries += 1
            link.attend()
    assert 20 / LONGEST_WAIT_S <= tries <= 20 / LONGEST_WAIT_S + 6, "with back-off"
    world.plugged = True
    waited = world.now_s
    while not link.running:
        world.now_s += 0.01
        link.attend()
    assert world.now_s - waited <= LONGEST_WAIT_S + 0.02
    assert conditions(link.receive()[0]) == [RUNNING]
    assert (link.losses, link.reason, world.opened) == (1, "", 1)


def test_what_was_received_before_the_loss_still_comes_then_the_loss():
    world = World()
    link = world.link()
    link.start()
    link.listen_to([0x10], echo=False)
    assert conditions(link.receive()[0]) == [RUNNING]
    world.waiting, world.plugged = [0x10, 0x11], False
    frames = link.receive()[0].copy()
    frames = np.concatenate([frames, link.receive()[0]])
    assert conditions(frames) == ["0x10", "0x11", LOST]
    assert link.receive()[0].size == 0
    link.send(empty(3))
    assert link.unsent == 3
    world.plugged, world.now_s = True, 1.0
    link.attend()
    world.waiting = [0x10]
    assert conditions(link.receive()[0]) == [RUNNING, "0x10"]
    assert link.statistics.received == 3, "counted over both lives"
    assert world.filters == [None, [0x10], [0x10]], "asked for anew"
    assert (world.opened, world.closed) == (2, 1)


def test_what_links_and_clocks_do_is_not_for_others_to_say():
    """A client of the hub could say that the bus is lost: nothing would be overdue any more."""
    world = World()
    link = world.link()
    link.start()
    link.receive()
    world.waiting, world.losses = [1, ERROR, 2, ERROR, 3], [(4, 7)]
    frames = link.receive()[0]
    assert conditions(frames) == ["0x1", "0x2", LOSS, "0x3"]
    assert link.statistics.rejected == 2


def test_a_link_may_get_another_index():
    world = World()
    link = world.link()
    link.start()
    link.receive()
    link.index = 3
    world.waiting, world.losses = [1], [(0, 2)]
    assert link.receive()[0]["bus"].tolist() == [3, 3]
    world.plugged = False
    assert link.receive()[0]["bus"].tolist() == [3]


def test_a_loss_noticed_while_sending():
    world = World()
    link = world.link()
    link.start()
    link.receive()
    world.plugged = False
    link.send(empty(2))
    assert not link.running
    assert link.unsent == 2
    assert conditions(link.receive()[0]) == [LOST]


def test_what_was_received_before_sending_failed_still_comes_then_the_loss():
    """Frames that wait in the queue of a bus that takes none any more: they came, and nobody would count them."""
    world = World()
    link = world.link()
    link.start()
    link.receive()
    world.waiting = [0x100, 0x101]
    world.plugged = False
    link.send(empty(3))
    link.send(empty(2))
    assert not link.running
    assert link.unsent == 5
    assert link.due_s == 0.0, "the rest is read without waiting"
    link.attend()
    frames, more = link.receive()
    assert (conditions(frames), more) == (["0x100", "0x101", LOST], False)
    assert link.statistics.received == 2
    assert (link.losses, world.closed) == (1, 1)


def test_a_bus_that_goes_again_while_it_is_opened_is_tried_again_and_told_when_it_is_there():
    world = World()
    world.plugged = False
    link = world.link()
    link.start()
    assert conditions(link.receive()[0]) == [LOST]
    world.plugged = world.refusing = True
    world.now_s = 1.0
    link.attend()
    assert not link.running
    assert world.closed == 1
    world.refusing, world.now_s = False, 3.0
    link.attend()
    assert conditions(link.receive()[0]) == [RUNNING]


@pytest.mark.evidence("Nothing is silent: lost frames")
def test_lost_frames_are_told_where_they_are_missing():
    world = World()
    link = world.link()
    link.start()
    link.receive()
    world.waiting, world.losses = [1, 2, 3], [(1, 70_000), (3, 5)]
    frames = link.receive()[0]
    assert conditions(frames) == ["0x1", LOSS, "0x2", "0x3", LOSS]
    assert int.from_bytes(bytes(frames[1]["data"][4:8]), "little") == 70_000
    assert frames[1]["t_ns"] == frames[2]["t_ns"]
    assert link.statistics.overflow == 70_005


@pytest.mark.parametrize("error", [UnsupportedError("no CAN here"), InputError("not a URI")])
def test_what_waiting_does_not_mend_is_an_error_at_once(error):
    def refuse(uri, index):
        raise error

    with pytest.raises(type(error)):
        Link("test:never", 0, "chassis", refuse, Clock()).start()
