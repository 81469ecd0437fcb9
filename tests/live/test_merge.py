"""Frames of several buses in one order of time, whenever and in whatever pieces they are read."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.bus.frames import empty
from gateway.live.fast_path import FastPath
from gateway.live.fast_path_kernel import LONGEST_NS, MOST_WAITING, SETTLE_NS
from gateway.runtime.fast_path_conditions import FastPathConditions

MS = 1_000_000


def batch(bus, *stamps):
    out = empty(len(stamps))
    out["t_ns"], out["bus"] = stamps, bus
    return out


class Merger:
    """A pump without an engine, into which frames are handed."""

    def __init__(self, buses=2):
        self.pump = FastPath(None, buses)

    def take(self, parts, read_ns):
        return self.pump.hand_in(parts, empty(0), read_ns, FastPathConditions()).batch.copy()

    @property
    def holding(self):
        return self.pump.holding


def test_a_frame_is_held_until_no_earlier_one_can_come():
    merger = Merger()
    got = merger.take([(batch(0, 10 * MS, 11 * MS), False), (batch(1), False)], 11 * MS)
    assert got["t_ns"].tolist() == [10 * MS]
    assert merger.holding
    got = merger.take([(batch(0), False), (batch(1, 10_900_000), False)], 11 * MS + SETTLE_NS)
    assert got["t_ns"].tolist() == [10_900_000, 11 * MS]
    assert not merger.holding


def test_a_bus_with_more_to_read_holds_the_others_back():
    merger = Merger()
    got = merger.take([(batch(0, 1 * MS, 2 * MS), True), (batch(1, 5 * MS), False)], 9 * MS)
    assert got["t_ns"].tolist() == [1 * MS, 2 * MS]
    got = merger.take([(batch(0, 3 * MS), False), (batch(1), False)], 10 * MS)
    assert got["t_ns"].tolist() == [3 * MS, 5 * MS]


def test_a_clock_in_the_future_holds_nobody_for_long():
    merger = Merger()
    ahead = 10**12
    assert not len(merger.take([(batch(0, ahead), False), (batch(1), False)], 0))
    for k in range(1, 6):  # the other bus has traffic all the time
        got = merger.take([(batch(0), False), (batch(1, k * MS - SETTLE_NS), False)], k * MS)
        assert got["t_ns"].tolist() == [k * MS - SETTLE_NS]
    got = merger.take([(batch(0), False), (batch(1), False)], LONGEST_NS + MS)
    assert got["t_ns"].tolist() == [ahead]


@pytest.mark.evidence("Live is replay: order")
@given(
    st.lists(st.tuples(st.integers(0, 2), st.integers(1, 400_000)), min_size=1, max_size=60),
    st.lists(st.integers(1, 900_000), min_size=1, max_size=60),
)
def test_the_order_is_that_of_the_stamps_however_it_is_read(arrivals, waits):
    """Each bus is read up to the time of the reading; what was stamped in the last 0.2 ms may still be on its way."""
    times = np.cumsum([gap for _, gap in arrivals])
    buses = np.array([bus for bus, _ in arrivals])
    merger, now, seen = Merger(3), 0, []
    read = np.zeros(len(times), bool)
    for k, wait in enumerate([*waits, 10**9, 10**9]):
        now += wait
        parts = []
        for bus in range(3):
            # This bus's last frames come late, up to what is allowed for.
            late = SETTLE_NS if (k + bus) % 2 else 0
            mine = (buses == bus) & ~read & (times <= now - late)
            read |= mine
            parts.append((batch(bus, *times[mine]), False))
        seen += merger.take(parts, now)["t_ns"].tolist()
    assert seen == sorted(times.tolist())


def test_a_bus_that_lags_is_waited_for_and_the_others_are_not_read_meanwhile():
    """After a pause one bus has thousands of frames, another a few that are later: these wait as long as it takes."""
    merger, now, seen = Merger(), 10**12, []
    slow, fast = np.arange(0, 40_000_000, 10_000), np.arange(5_000, 40_000_000, 20_000)
    at = [0, 0]
    while at[0] < len(slow) or at[1] < len(fast) or merger.holding:
        now += 2 * MS
        parts = []
        for bus, stamps in enumerate((slow, fast)):
            count = 0 if merger.pump.is_far_ahead(bus) else (100, 256)[bus]
            mine = stamps[at[bus] : at[bus] + count]
            at[bus] += len(mine)
            parts.append((batch(bus, *mine), at[bus] < len(stamps)))
        seen += merger.take(parts, now)["t_ns"].tolist()
        assert merger.holding < 2 * MOST_WAITING
    assert seen == sorted([*slow.tolist(), *fast.tolist()])
