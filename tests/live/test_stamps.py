"""The engine's clock, and the stamps of a bus, whatever is done to the wall clock."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.bus.conditions import ERROR, LOST, are_steps, condition_frame, step_frame, step_ns_of
from gateway.bus.frames import OWN, empty
from gateway.bus.timeline import DISORDER_NS, LogTime, spans, to_wall
from gateway.live.clock import Clock
from gateway.live.stamps import Stamps

MS = 1_000_000
S = 1_000_000_000


class Clocks:
    def __init__(self, **options):
        self.true, self.ahead, self.slow = 5 * S, 1_700_000_000 * S, []
        self.clock = Clock(self.wall, self.monotonic, **options)
        self.zero = self.clock.now() - self.true

    def wall(self):
        if self.slow:
            self.true += self.slow.pop()
        return self.true + self.ahead

    def monotonic(self):
        return self.true


def batch(stamps, bus=0, can_id=0x100):
    out = empty(len(stamps))
    out["t_ns"], out["bus"], out["can_id"] = stamps, bus, can_id
    return out


@given(st.lists(st.tuples(st.integers(1, 3 * S), st.integers(-4000, 4000)), max_size=30))
def test_time_goes_on_evenly_and_steps_are_told(moves):
    """Steps of 0, or so great that they cannot be slewing in the 3 s at most between two looks."""
    c = Clocks()
    steps = []
    for passed, step in moves:
        c.true += passed
        c.ahead += step * 12 * MS
        assert c.clock.now() == c.true + c.zero
        steps += [step * 12 * MS] if step else []
        assert c.clock.wall() == c.true + c.ahead
    assert [step.step_ns for step in c.clock.untold] == steps
    assert c.clock.offset_ns == sum(steps)
    assert c.clock.reported_offset_ns == 0


def test_a_reading_that_was_interrupted_is_no_step():
    c = Clocks()
    for _ in range(50):
        c.slow = [50 * MS] * 5  # between the clocks, at each of the tries
        c.clock.now()
    assert c.clock.untold == []


def test_what_is_within_the_tolerance_is_followed_and_adds_up():
    c = Clocks()
    before = c.clock.now()
    c.ahead -= 9 * MS
    assert c.clock.now() == before, "never back"
    c.ahead -= 2 * MS
    c.clock.now()
    (step,) = c.clock.untold
    assert step.step_ns == pytest.approx(-11 * MS, abs=1 * MS)
    c = Clocks(tolerance_ns=S)
    c.ahead += 900 * MS
    c.clock.now()
    assert c.clock.untold == []


def test_slewing_is_followed_however_long_it_takes():
    c = Clocks()
    for _ in range(10_000):
        c.true += 10 * MS
        c.ahead += 5000  # 500 ppm
        c.clock.now()
    assert c.clock.untold == []
    assert c.clock.now() == c.true + c.zero + 10_000 * 5000, "time is the wall clock's"


@given(
    st.lists(st.integers(1 * MS, 40 * MS), min_size=5, max_size=120),
    st.lists(
        st.tuples(st.integers(0, 4 * S), st.sampled_from([1, -1]), st.integers(300, 5_000_000)),
        max_size=3,
    ),
    st.lists(st.integers(1 * MS, 250 * MS), min_size=1, max_size=30),
    st.sampled_from([7, 10_000]),
    st.booleans(),
)
def test_frames_get_their_true_times_wherever_the_clock_is_set(gaps, steps, waits, room, own):
    """Traffic denser than the steps, read in uneven pieces: which was stamped after a step is always found."""
    c = Clocks()
    start = c.true
    at = np.cumsum(gaps) + start
    steps = sorted((start + when, sign * ms * MS) for when, sign, ms in steps)
    steps = [s for k, s in enumerate(steps) if not k or s[0] - steps[k - 1][0] > 300 * MS]
    stamps = [int(t) + c.ahead + sum(step for when, step in steps if when < t) for t in at]
    link = Stamps(c.clock, own_clock=own)
    done, got, base = 0, [], c.ahead
    for wait in [*waits, *[250 * MS] * 60]:
        c.true += wait
        c.ahead = base + sum(step for when, step in steps if when <= c.true)
        c.clock.now()
        while True:
            until = int(np.searchsorted(at, c.true, side="right"))
            part = batch(stamps[done : min(until, done + room)])
            more = done + room < until
            done += len(part)
            link.apply(part, more=more)
            got += part["t_ns"].tolist()
            if not more:
                break
    assert got == (at + c.zero).tolist()
    assert not link.aligned
    told = [step.t_ns - c.zero for step in c.clock.untold]
    assert len(told) == len(steps)
    for (when, _), place in zip(steps, told, strict=True):
        assert all(t <= place for t in at.tolist() if t <= when), "after all before it"
        assert all(t >= place for t in at.tolist() if t > when), "and before all after it"


@given(st.integers(-(10**6), 10**6), st.integers(-200, 200), st.integers(0, 2**32 - 1))
def test_another_clock_is_aligned_and_its_drift_followed(zero_ms, ppm, seed):
    """Frames each 20 ms that need 1 to 4 ms to come: their time is right to what the way varies, and never of later."""
    c = Clocks()
    rng = np.random.default_rng(seed)
    link = Stamps(c.clock, own_clock=True)
    worst = 0
    for k in range(500):
        c.true += 20 * MS
        true = c.true - int(rng.integers(1 * MS, 4 * MS))
        stamp = zero_ms * MS + true + round((true - 5 * S) * ppm * 1e-6)
        frames = batch([stamp])
        link.apply(frames, more=False)
        now = c.clock.now()
        assert frames["t_ns"][0] <= now
        if k > 100:
            worst = max(worst, abs(int(frames["t_ns"][0]) - (true + c.zero)))
    assert link.aligned
    assert worst < 5 * MS


def test_another_clock_that_is_set_is_aligned_again():
    c = Clocks()
    link = Stamps(c.clock, own_clock=True)
    for ahead in (0, 7200 * S, -3 * S):
        for _ in range(3):
            c.true += 20 * MS
            frames = batch([ahead + c.true - 10 * MS, ahead + c.true])
            link.apply(frames, more=False)
            assert frames["t_ns"][1] == c.clock.now()
            assert frames["t_ns"][0] <= frames["t_ns"][1]


def as_logged(at, steps):
    """Frames of even time with what tells of steps among them."""
    parts = [batch([t]) for t in at]
    for when, us in steps:
        place = int(np.searchsorted(at, when))
        parts[place] = np.concatenate([step_frame(max(when, 0), us), parts[place]])
    return np.concatenate(parts)


@given(
    st.lists(st.integers(0, 3 * S), min_size=1, max_size=40),
    st.lists(st.integers(-(10**10), 10**10), max_size=4),
    st.integers(1, 9),
)
def test_a_log_that_tells_of_its_steps_gives_the_times_of_the_live_run(gaps, steps, chunk):
    at = np.cumsum(gaps) + 10**15
    places = [(int(at[k * len(at) // 5]), us) for k, us in enumerate(steps)]
    frames = as_logged(at, places)
    logged, _ = to_wall(frames, 0)
    time = LogTime()
    back = [time.apply(logged[k : k + chunk]) for k in range(0, len(logged), chunk)]
    np.testing.assert_array_equal(np.concatenate(back), frames)
    assert sum(offset != 0 for _, offset in spans(frames, 0)) <= len(steps)


@given(st.integers(-(2**55), 2**55 - 1))
def test_a_step_is_what_its_frame_says(us):
    (frame,) = step_frame(0, us)
    assert step_ns_of(frame) == us * 1000
    assert are_steps(step_frame(0, us)).tolist() == [True]
    assert are_steps(condition_frame(0, 0, LOST)).tolist() == [False]


def evened(*parts):
    time = LogTime()
    return np.concatenate([time.apply(part) for part in parts])


def test_of_two_buses_in_a_log_each_steps_when_its_stamps_do():
    """The other bus's frames come a little later, stamped still by the clock as it was."""
    a = batch([100 * S + k * 20 * MS for k in range(5)])
    a2 = batch([40 * S + k * 20 * MS for k in range(5)])
    b, b_late, b2 = batch([100 * S], 1), batch([100 * S + 81 * MS], 1), batch([40 * S + 10 * MS], 1)
    out = evened(np.concatenate([b, a, a2[:1], b_late, b2, a2[1:]]))
    (step,) = np.flatnonzero(are_steps(out))
    assert step_ns_of(out[step]) == -60 * S - 80 * MS
    times = (out["t_ns"] - 100 * S) // MS
    assert times.tolist() == [0, 0, 20, 40, 60, 80, 80, 80, 81, 90, 100, 120, 140, 160]


@pytest.mark.parametrize("step_ms", [15, -15, 40, 500, -500])
@pytest.mark.parametrize("at", [0.05, 0.5, 0.99])
def test_a_small_step_in_a_long_backlog_is_found(step_ms, at):
    """The loop stood still for 2 s; it reads what waits in pieces, and is behind when it comes to now."""
    c = Clocks()
    stamps = Stamps(c.clock)
    stamps.apply(batch([]), more=False)
    begun = c.true
    c.true += 2 * S
    set_at = begun + round(at * 2 * S)
    c.ahead += step_ms * MS
    noticed = c.true
    waiting = [begun + k * MS for k in range(1, 2001)]
    while waiting:
        read, waiting = waiting[:160], waiting[160:]
        true = np.asarray(read)
        ahead = c.ahead - np.where(true < set_at, step_ms * MS, 0)
        frames = batch(true + ahead)
        stamps.apply(frames, more=bool(waiting))
        error = frames["t_ns"].astype(np.int64) - c.zero - true
        assert np.abs(error).max() <= abs(step_ms) * MS
        assert (error[true > noticed] == 0).all()
        waiting += [waiting[-1] + k * MS for k in range(1, 6)] if waiting and c.true < 10 * S else []
        c.true += 5 * MS
    assert error[-1] == 0


@pytest.mark.parametrize("mark", [{"flags": OWN}, {"can_id": ERROR}])
def test_what_the_bus_has_not_stamped_is_no_step(mark):
    """A frame that we sent is stamped as it leaves, those received before it may be read later."""
    frames = batch([10 * S, 11 * S, 10 * S + MS, 10 * S + 2 * MS])
    for name, value in mark.items():
        frames[name][1] = value
    np.testing.assert_array_equal(evened(frames), frames)
    np.testing.assert_array_equal(evened(frames[:2], frames[2:]), frames)


def test_a_little_disorder_is_no_step():
    frames = batch([10 * S, 10 * S + DISORDER_NS, 10 * S, 10 * S + 20 * MS])
    np.testing.assert_array_equal(evened(frames), frames)
    frames["t_ns"][2] -= 1
    assert are_steps(evened(frames)).any()


@given(
    st.lists(
        st.tuples(
            st.integers(-150, 150),  # ms since the frame before
            st.integers(0, 2),  # bus
            st.sampled_from([0, 0, 0, 0, 0, -5000, 7000]),  # ms that the wall clock is set by
            st.sampled_from(["frame"] * 8 + ["own", "condition", "told"]),
        ),
        min_size=1,
        max_size=60,
    ),
    st.lists(st.integers(0, 60), max_size=4),
)
def test_where_a_log_is_cut_into_batches_changes_no_time(moves, cuts):
    made, t_ns = [], 1_700_000_000 * S
    for ms, bus, step, kind in moves:
        t_ns += (ms + step) * MS
        if kind == "told":
            made.append(step_frame(t_ns, step * 1000 or 3000))
        elif kind == "condition":
            made.append(condition_frame(t_ns, bus, LOST))
        else:
            made.append(batch([t_ns], bus=bus))
            made[-1]["flags"] = OWN if kind == "own" else 0
    frames = np.concatenate(made)
    whole, parted, single = LogTime(), LogTime(), LogTime()
    expected = whole.apply(frames)
    parts = [parted.apply(part) for part in np.split(frames, sorted(min(cut, len(frames)) for cut in cuts))]
    assert np.concatenate(parts).tobytes() == expected.tobytes()
    ones = [single.apply(frames[k : k + 1]) for k in range(len(frames))]
    assert np.concatenate(ones).tobytes() == expected.tobytes()
