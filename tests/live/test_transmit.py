"""What waits for a full queue: by rank, in order, nothing lost, nothing stale."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.bus.base import Bus, send_all
from gateway.bus.frames import ANSWER, CYCLIC, URGENT, empty, put
from gateway.live.transmit import MOST, Transmitter
from gateway_fdi.errors import BusError


class Full(Bus):
    """Takes only as many frames as it has room for."""

    def __init__(self, room=0):
        super().__init__("test:full", 0)
        self.room = room
        self.taken = []

    def fileno(self):
        return -1

    def receive(self, out):
        return 0

    def send(self, frames):
        count = min(len(frames), self.room)
        self.room -= count
        self.taken += [(int(f["rank"]), int(f["can_id"]), int(f["data"][0])) for f in frames[:count]]
        return count

    def close(self):
        pass


def frames(*parts):
    out = empty(len(parts))
    for k, (rank, can_id, mark) in enumerate(parts):
        put(out, k, 0, can_id, bytes([mark]))
        out[k]["rank"] = rank
    return out


def test_dtcs_go_first_then_answers_then_the_latest_of_each_cyclic_message():
    bus, waiting = Full(), Transmitter()
    waiting.send(bus, frames((CYCLIC, 0x100, 1), (CYCLIC, 0x101, 1), (ANSWER, 0x7E8, 1)))
    waiting.send(bus, frames((ANSWER, 0x7E8, 2), (URGENT, 0x6F0, 1), (CYCLIC, 0x100, 2)))
    assert not bus.taken
    assert len(waiting) == 5
    assert waiting.given_up == 1, "the cyclic message that was replaced"
    bus.room = 2
    waiting.flush(bus)
    assert bus.taken == [(URGENT, 0x6F0, 1), (ANSWER, 0x7E8, 1)]
    bus.room = 100
    waiting.send(bus, frames((URGENT, 0x6F0, 2)))
    assert bus.taken[2:] == [
        (URGENT, 0x6F0, 2),
        (ANSWER, 0x7E8, 2),
        (CYCLIC, 0x101, 1),
        (CYCLIC, 0x100, 2),
    ]
    assert len(waiting) == 0


@pytest.mark.evidence("Bounded: send queue")
def test_a_bus_that_takes_nothing_costs_bounded_memory_and_the_urgent_last():
    bus, waiting = Full(), Transmitter()
    waiting.send(bus, frames(*[(ANSWER, 0x7E8, 0)] * MOST))
    waiting.send(bus, frames((ANSWER, 0x7E8, 1)))
    assert (len(waiting), waiting.given_up) == (MOST, 1)
    waiting.send(bus, frames((URGENT, 0x6F0, 1)))
    bus.room = 1
    waiting.flush(bus)
    assert bus.taken == [(URGENT, 0x6F0, 1)]
    before = waiting.given_up + len(waiting)
    waiting.give_up()
    assert (len(waiting), waiting.given_up) == (0, before)


@given(
    st.lists(
        st.tuples(
            st.lists(st.tuples(st.sampled_from([ANSWER, URGENT, CYCLIC]), st.integers(0, 3)), max_size=6),
            st.integers(0, 5),
        ),
        max_size=20,
    )
)
def test_nothing_is_lost_doubled_or_out_of_order(steps):
    """Whatever comes and however little the bus takes: each frame is sent, waits, or was given up."""
    bus, waiting = Full(), Transmitter()
    made = 0
    for parts, room in steps:
        bus.room = room
        batch = frames(*((rank, 0x100 * rank + k, 0) for rank, k in parts))
        for frame in batch:
            frame["data"][0] = made % 256
            made += 1
        waiting.send(bus, batch)
        assert len(bus.taken) + len(waiting) + waiting.given_up == made
    bus.room = 10**6
    waiting.flush(bus)
    assert len(waiting) == 0
    assert len(bus.taken) + waiting.given_up == made
    for rank in (ANSWER, URGENT):
        marks = [mark for r, _, mark in bus.taken if r == rank]
        assert marks == sorted(marks)
    assert len(set(bus.taken)) == len(bus.taken) or made > 256


def test_send_all_waits_for_a_full_queue():
    class Slow(Full):
        def send(self, frames):
            self.room = 1
            return super().send(frames)

    bus = Slow()
    send_all(bus, frames(*((ANSWER, 0x10, k) for k in range(5))))
    assert np.array([mark for _, _, mark in bus.taken]).tolist() == [0, 1, 2, 3, 4]


class Gone(Full):
    """Takes nothing more."""

    def send(self, frames):
        raise BusError("gone")


@pytest.mark.parametrize("rank", [URGENT, ANSWER, CYCLIC])
def test_one_frame_alone_waits_for_a_full_queue_and_is_counted_when_the_bus_is_gone(rank):
    bus, waiting = Full(), Transmitter()
    waiting.send(bus, frames((rank, 0x6F0, 1)))
    assert len(waiting) == 1
    bus.room = 1
    waiting.flush(bus)
    assert bus.taken == [(rank, 0x6F0, 1)]
    with pytest.raises(BusError):
        waiting.send(Gone(), frames((rank, 0x6F0, 2)))
    waiting.give_up()
    assert waiting.given_up == 1
    assert not len(waiting)
