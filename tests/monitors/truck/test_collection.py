"""Sets of four frames that come at their own times: collected by their counters, or counted as apart."""

import numpy as np
import pytest
from amount import examples
from hypothesis import given, settings
from hypothesis import strategies as st
from truck_runs import driven, run

from gateway.jit import COMPILED
from gateway.monitors.truck import collection
from gateway.monitors.truck.messages import MESSAGES, Inputs

COUNTERS = ("count_pt", "count_veh", "count_elec", "count_mech")
ORDER = ("HEV_CTRL_PT", "HEV_CTRL_VEH", "HEV_SENS_ELEC", "HEV_SENS_MECH")


def records():
    state, inputs = np.zeros(1, collection.State.dtype), np.zeros(1, Inputs.dtype)
    for name in COUNTERS:
        inputs[name] = np.nan
    s, u = state.view(np.recarray)[0], inputs.view(np.recarray)[0]
    s.last[:], s.number[:] = -1, -1
    return s, u, (state, inputs)


@settings(max_examples=examples(60), deadline=None)
@given(
    st.lists(st.tuples(st.integers(0, 3), st.integers(0, 3), st.booleans()), min_size=20, max_size=400),
    st.integers(0, 255),
)
def test_a_set_is_whole_when_the_last_of_its_frames_has_come(delays, first):
    """Beside a dictionary: every set of which four frames come within three periods, in any order, with its values."""
    arrivals = []
    for k in range(len(delays)):
        for message in range(4):
            late = delays[(k * 7 + message * 3) % len(delays)]
            if late[2] or message != late[0]:  # else this frame is lost
                arrivals.append((10.0 * k + 9.0 * late[1] * (message == late[0]), message, k))
    arrivals.sort(key=lambda each: each[0])
    s, u, _kept = records()
    newest, came, wanted = [-1] * 4, {}, []
    found = []
    for t, message, k in arrivals:
        if k <= newest[message]:
            continue  # frames of one message do not overtake each other
        newest[message] = k
        u.t_ns = round(t * 1e6)
        for name in MESSAGES[ORDER[message]]:
            u[name] = 1000.0 * k + message
        u[COUNTERS[message]] = (first + k) % 256
        place = collection.collect(s, u, 0.01)
        came.setdefault(k, set()).add(message)
        oldest = max(newest) - 3
        if len(came[k]) == 4 and min(newest) >= oldest:
            wanted.append(k)
        if place >= 0:
            found.append(k)
            held = s.held[place]
            assert s.number[place] == (first + k) % 256
            for at, name in enumerate(("gear", "alpha", "I_em_sens", "charge")):
                assert held[name] == 1000.0 * k + at
    assert set(wanted) <= set(found)
    assert all(len(came[k]) == 4 for k in found)
    assert len(found) == len(set(found))


def skewed(most_ms, seed):
    """Have each frame come late by chance, by message in order."""

    def change(frames):
        rng = np.random.default_rng(seed)
        late = frames.copy()
        late["t_ns"] += (rng.uniform(0, most_ms, len(late)) * 1e6).astype(np.int64)
        for can_id in np.unique(late["can_id"]):
            mine = late["can_id"] == can_id
            late["t_ns"][mine] = np.maximum.accumulate(late["t_ns"][mine])
        return late[np.argsort(late["t_ns"], kind="stable")]

    return change


@pytest.mark.skipif(not COMPILED, reason="minutes of driving")
@pytest.mark.parametrize("most_ms", [8.0, 20.0])
def test_frames_that_come_up_to_two_periods_late_are_used(most_ms):
    print("seed 7")
    _, sets, events = run(driven(seconds=60.0), 7, change=skewed(most_ms, 7))
    assert sets > 0.95 * 6000
    assert events == []
    _, sets, events = run(driven("machine_resistance", 150.0, 220.0), 7, change=skewed(most_ms, 7))
    assert "P1A13-64" in [dtc for _, dtc, failed in events if failed]
    others = {"P1A10-01", "P1A11-64", "P1A12-64", "P1A14-64"}
    assert not others & {dtc for _, dtc, _ in events}


@pytest.mark.skipif(not COMPILED, reason="minutes of driving")
@pytest.mark.parametrize("missing", [257, 1000])
def test_a_gap_is_one_though_the_counter_has_come_round(missing):
    """Behind 257 sets the counter is two ahead, as behind one: the dynamic tests begin anew all the same."""

    def silent(frames):
        return np.concatenate([frames[: 4 * 3000], frames[4 * (3000 + missing) :]])

    peak, sets, events = run(driven(seconds=90.0), 7, change=silent)
    assert sets == 9000 - missing
    assert {code[0] for _, code, _ in events} == {"U"}, "missing messages, and no part of the truck"
    assert max(peak.values()) < 1.0
