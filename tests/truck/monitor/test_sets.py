"""Sets of four frames that come at their own times are put together; gaps that no counter tells."""

import numpy as np
import pytest
from truck_runs import driven, run

from gateway_fdi.jit import COMPILED


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
