"""A stranger's monitor that steps once a sample: what it gets of frames that are late, overtaken or lost."""

from dataclasses import replace
from typing import Annotated

import numpy as np
import pytest
from amount import examples
from hypothesis import given, settings
from hypothesis import strategies as st

from gateway.bus.frames import empty, put
from gateway.engine.adopt import adopt
from gateway.engine.build import build_engine
from gateway.engine.instances import MonitorInstance
from gateway.monitors import contract
from gateway.monitors.conformance import check_type
from gateway.monitors.contract import TIMER, Fault, Monitor, MonitorParams, Sampled, Signal
from gateway.monitors.sampling import Sampling
from gateway.signals.database import load_database
from gateway_fdi.errors import InputError
from gateway_fdi.jit import Record, f8s, i8, kernel

DBC = """VERSION ""
NS_ :
BS_:
BU_: A
BO_ 256 VOLTS: 8 A
 SG_ Volts : 0|16@1+ (1,0) [0|0] "V" A
 SG_ Count : 16|8@1+ (1,0) [0|0] "" A
BO_ 257 AMPS: 8 A
 SG_ Amps : 0|16@1+ (1,0) [0|0] "A" A
 SG_ Count : 16|8@1+ (1,0) [0|0] "" A
BO_ 258 CAR: 8 A
 SG_ Speed : 0|16@1+ (1,0) [0|0] "km/h" A
"""
MS = 1_000_000
BEGIN = 1000 * MS
ROOM = 2000
NEVER_MS = 1e9


class Params(MonitorParams):
    by: str = "counter"
    window_ms: float = 30.0


class State(Record):
    count: i8
    timers: i8
    seen: Annotated[f8s, ROOM, 8]


class Inputs(contract.SampledInputs):
    volts: Annotated[f8s, 1]
    amps: Annotated[f8s, 1]
    speed: Annotated[f8s, 1]


@kernel
def step(s, c, u, out):
    if u.trigger == TIMER:
        s.timers += 1
        return
    row = s.seen[s.count]
    row[0], row[1], row[2] = u.volts[0], u.amps[0], u.speed[0]
    row[3], row[4], row[5], row[6] = u.gap, u.missing, u.waited[0], u.waited[1]
    row[7] = u.t_ns
    s.count += 1
    out.wake_ns = u.t_ns + 50_000_000


@kernel
def step_of_two(s, c, u, out):
    row = s.seen[s.count]
    row[0], row[1], row[3], row[4], row[5], row[7] = u.volts[0], u.amps[0], u.gap, u.which, u.missing, u.t_ns
    s.count += 1


def sampling(p):
    return Sampling(
        p.by,
        10.0,
        np.inf if p.window_ms == NEVER_MS else p.window_ms,
        1000.0,
        ("VOLTS.Count", "AMPS.Count"),
        spare=True,
    )


MONITOR = Monitor(
    type="load",
    api=2,
    params=Params,
    state=State,
    const=State,
    inputs=Inputs,
    step=step,
    connect=lambda _: {
        "volts": [Signal("VOLTS.Volts", triggers=True, optional=True)],
        "amps": [Signal("AMPS.Amps", triggers=True, optional=True)],
        "speed": [Signal("CAR.Speed", optional=True)],
    },
    prepare=lambda _p, _s, _c: None,
    faults=lambda _: (Fault("low", "P0562-16", "too low"),),
    capabilities=(Sampled(sampling),),
)


def engine_of(folder, **params):
    (folder / "a.dbc").write_text(DBC)
    return build_engine([(0, load_database([folder / "a.dbc"]))], [MonitorInstance("m", MONITOR, Params(**params))], [])


def feed(engine, arrivals):
    """Feed (time [ms], message 0 to 2, value, counter) in order of time; returns what the steps saw so far."""
    frames = empty(len(arrivals))
    for k, (t_ms, message, value, count) in enumerate(arrivals):
        data = int(value).to_bytes(2, "little") + bytes([count % 256]) + bytes(5)
        put(frames, k, BEGIN + round(t_ms * MS), 256 + message, data)
    engine.process(frames, lambda _: None)
    state = engine.state_of(0)[0]
    return np.array(state["seen"][: state["count"]])


def test_a_step_has_all_of_one_sample_and_the_newest_of_the_rest(tmp_path):
    arrivals = []
    for k in range(40):
        arrivals += [(10 * k, 0, k, k), (10 * k + 1, 1, 100 + k, k), (10 * k + 2, 2, 200 + k, 0)]
    seen = feed(engine_of(tmp_path), arrivals)
    assert seen[:, 0].tolist() == list(range(40))
    assert seen[:, 1].tolist() == [100 + k for k in range(40)]
    assert seen[1:, 2].tolist() == [200 + k - 1 for k in range(1, 40)]
    assert np.isnan(seen[0, 2])
    assert (seen[:, 3] == 1).all()
    assert (seen[:, 4] == 0).all()
    np.testing.assert_allclose(seen[:, 5], 0.001)
    np.testing.assert_allclose(seen[:, 6], 0.0, atol=1e-12)


def test_the_first_sample_is_whole_though_its_first_frame_comes_before_all_inputs_are_there(tmp_path):
    """Inputs that are not optional are not valid until each has come: no step, but the frame counts."""
    volts, amps = Signal("VOLTS.Volts", triggers=True), Signal("AMPS.Amps", triggers=True)
    needs = replace(MONITOR, connect=lambda _: {"volts": [volts], "amps": [amps], "speed": None})
    (tmp_path / "a.dbc").write_text(DBC)
    engine = build_engine([(0, load_database([tmp_path / "a.dbc"]))], [MonitorInstance("m", needs, Params())], [])
    seen = feed(engine, [(10 * k + m, m, k + 1, k) for k in range(5) for m in (0, 1)])
    assert seen[:, 0].tolist() == [1, 2, 3, 4, 5]


@pytest.mark.costly
@settings(max_examples=examples(40), deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0, 0.15), st.integers(0, 40), st.integers(0, 255))
def test_by_counter_what_belongs_together_comes_together(tmp_path_factory, seed, loss, late_ms, first):
    """Frames come up to two periods late each, those of one message in order: a set is of one time."""
    rng = np.random.default_rng(seed)
    arrivals = []
    lost = rng.random((200, 2)) < loss
    for message in (0, 1):
        late = np.minimum(rng.uniform(0, late_ms, 200), 20.0)
        t = np.maximum.accumulate(10.0 * np.arange(200) + late)
        arrivals += [(t[k], message, k + 1, first + k) for k in range(200) if not lost[k, message]]
    whole = [k + 1 for k in range(200) if not lost[k].any()]
    arrivals.sort(key=lambda each: each[0])
    seen = feed(engine_of(tmp_path_factory.mktemp("e"), window_ms=NEVER_MS), arrivals)
    told = seen[:, 0].astype(int)
    assert (seen[:, 0] == seen[:, 1]).all()
    assert set(told) <= set(whole)
    assert len(told) >= 0.9 * len(whole) - 4, (len(told), len(whole))
    assert (np.diff(told) == seen[1:, 3]).all(), "the gap says what is missing between"
    assert ((seen[:, 5:7] > -0.0101) & (seen[:, 5:7] <= 0.0401)).all()


@pytest.mark.parametrize("by", ["counter", "set"])
def test_a_message_that_stays_away_is_missing(tmp_path, by):
    """And comes again: its values with it, and nothing old is told as new."""
    arrivals = []
    for k in range(60):
        arrivals.append((10 * k, 0, k, k))
        if not 20 <= k < 40:
            arrivals.append((10 * k + 1, 1, 100 + k, k))
    seen = feed(engine_of(tmp_path, by=by), arrivals)
    gone = seen[seen[:, 4] == 2]
    assert 15 <= len(gone) <= 18, "it is waited for three periods, once"
    assert np.isnan(gone[:, 1]).all()
    assert np.isnan(gone[:, 6]).all()
    there = seen[seen[:, 4] == 0]
    assert (there[:, 1] == there[:, 0] + 100).all()
    assert seen[:, 3].sum() == 60


@pytest.mark.parametrize("by", ["counter", "set"])
def test_an_overtaken_frame_is_not_told_as_the_newest(tmp_path, by):
    arrivals = [(10 * k + m, m, 100 * m + k, k) for k in range(20) for m in (0, 1)]
    arrivals += [(200, 0, 21, 21), (200.1, 0, 20, 20), (201, 1, 121, 21)]
    seen = feed(engine_of(tmp_path, by=by), arrivals)
    assert seen[-1, :2].tolist() == [21, 121]
    assert seen[-1, 3] == 2


def test_a_sender_that_begins_anew_with_another_counter_is_followed(tmp_path):
    """Behind a pause that no counter bridges both messages agree again, whichever comes first."""
    for pause_ms, shift in ((2000.0, 77), (1003.0, 8), (5004.9, 0)):
        arrivals = [(10 * k + m, m, k, k) for k in range(30) for m in (0, 1)]
        arrivals += [(300 + pause_ms + 10 * k + 4 * (1 - m), m, 30 + k, shift + k) for k in range(30) for m in (1, 0)]
        seen = feed(engine_of(tmp_path, window_ms=NEVER_MS), arrivals)
        assert (seen[:, 0] == seen[:, 1]).all()
        assert seen[-1, 0] == 59
        assert len(seen) >= 58


def test_frames_that_complete_nothing_put_no_alarm_off(tmp_path):
    """A monitor sleeps until its own time, whatever comes that is no sample."""
    engine = engine_of(tmp_path, window_ms=NEVER_MS)
    feed(engine, [(0, 0, 1, 0), (1, 1, 1, 0), *((10 * k, 0, k, k) for k in range(1, 8))])
    assert engine.state_of(0)[0]["timers"] == 1


def test_a_reload_keeps_what_has_come_of_a_sample(tmp_path):
    begun, gone_on = engine_of(tmp_path), engine_of(tmp_path)
    arrivals = [(10 * k + m, m, 100 * m + k, k) for k in range(20) for m in (0, 1)]
    feed(begun, arrivals[:-1])
    adopt(gone_on, begun, {0: 0}, {})
    seen = feed(gone_on, arrivals[-1:])
    assert seen[-1, :2].tolist() == [19, 119]
    assert seen[-1, 3] == 1


def test_messages_with_periods_of_their_own_make_samples_of_their_own(tmp_path):
    """volts each 10 ms by counter, amps each 25 ms by the clock: a step for each, and `which` says of what it is."""
    two = (
        Sampling("counter", 10.0, np.inf, 1000.0, ("VOLTS.Count",), inputs=("volts",)),
        Sampling("clock", 25.0, np.inf, 1000.0, inputs=("amps",)),
    )
    both = replace(MONITOR, step=step_of_two, capabilities=(Sampled(lambda _: two),))
    (tmp_path / "a.dbc").write_text(DBC)
    engine = build_engine([(0, load_database([tmp_path / "a.dbc"]))], [MonitorInstance("m", both, Params())], [])
    arrivals = [(10 * k, 0, k, k) for k in range(20) if k != 7] + [(25 * k + 1, 1, 100 + k, 0) for k in range(8)]
    seen = feed(engine, sorted(arrivals))
    volts, amps = seen[seen[:, 4] == 0], seen[seen[:, 4] == 1]
    assert volts[:, 0].tolist() == [k for k in range(20) if k != 7]
    assert volts[:, 3].tolist() == [2 if k == 8 else 1 for k in range(20) if k != 7]
    assert amps[:, 1].tolist() == [100 + k for k in range(8)]
    assert (amps[:, 3] == 1).all()
    # the other's input is that of its newest sample
    assert all(row[0] == volts[volts[:, 7] < row[7]][-1, 0] for row in amps)


def test_a_set_in_order_lacks_what_has_not_come_by_its_last_message(tmp_path):
    one = Sampling("set", 10.0, np.inf, 1000.0, ordered=True)
    ordered = replace(MONITOR, capabilities=(Sampled(lambda _: one),))
    (tmp_path / "a.dbc").write_text(DBC)
    engine = build_engine([(0, load_database([tmp_path / "a.dbc"]))], [MonitorInstance("m", ordered, Params())], [])
    lost = {(0, 5), (1, 9), (0, 12), (0, 13)}
    seen = feed(engine, [(10 * k + m, m, 100 * m + k, 0) for k in range(20) for m in (0, 1) if (m, k) not in lost])
    assert seen[:, 1].tolist() == [100 + k for k in range(20) if k != 9]
    missing = np.isnan(seen[:, 0])
    assert seen[missing, 1].tolist() == [105, 112, 113]
    assert (seen[missing, 4] == 1).all()
    assert (seen[~missing, 0] + 100 == seen[~missing, 1]).all()


def test_at_the_ticks_of_a_clock(tmp_path):
    """Held and on the line; a message that stays away is waited for, then NaN; behind a silence all begins anew."""
    (tmp_path / "a.dbc").write_text(DBC)
    for between in ("held", "interpolated"):
        grid = Sampling("clock", 10.0, 40.0, 1000.0, between=between, age_ms=30.0)
        ticks = replace(MONITOR, step=step_of_two, capabilities=(Sampled(lambda _, grid=grid: grid),))
        engine = build_engine([(0, load_database([tmp_path / "a.dbc"]))], [MonitorInstance("m", ticks, Params())], [])
        arrivals = [(7 * k + 3, 0, 7 * k + 3, 0) for k in range(200)]
        arrivals += [(25 * k + 1, 1, 25 * k + 1, 0) for k in range(56) if not 500 < 25 * k + 1 < 900]
        arrivals = [each for each in sorted(arrivals) if not 1100 < each[0] < 1300]
        seen = feed(engine, arrivals)
        at = seen[:, 7] / MS - 1000.0
        assert (at % 10.0 == 0.0).all()
        assert (np.diff(at) / 10.0 == seen[1:, 3]).all()
        there = seen[:, 5] == 0
        if between == "interpolated":
            np.testing.assert_allclose(seen[:, 0], at, atol=1e-9)
            np.testing.assert_allclose(seen[there, 1], at[there], atol=1e-9)
        else:
            assert ((at - seen[:, 0] >= 0) & (at - seen[:, 0] <= 30)).all()
            assert ((at[there] - seen[there, 1] >= 0) & (at[there] - seen[there, 1] <= 30)).all()
        gone = at[seen[:, 5] == 2]
        assert 480 <= gone[0] <= 520, "it is waited for 40 ms behind its newest frame, at 476 ms"
        assert gone[gone < 1100][-1] < 940
        assert np.isnan(seen[seen[:, 5] == 2, 1]).all()
        assert not ((at > 1150) & (at < 1290)).any()
        assert at[-1] >= 1370


def test_slips_are_told(tmp_path):
    with pytest.raises(InputError, match="go together"):
        check_type(replace(MONITOR, capabilities=()))
    wrong = replace(MONITOR, capabilities=(Sampled(lambda _: Sampling("set", 10.0, 30.0, 100.0, ("CAR.Speed",))),))
    (tmp_path / "a.dbc").write_text(DBC)
    with pytest.raises(InputError, match="frame counter of CAR, which carries none of the inputs that trigger"):
        build_engine([(0, load_database([tmp_path / "a.dbc"]))], [MonitorInstance("m", wrong, Params())], [])
    none = replace(MONITOR, capabilities=(Sampled(lambda _: "set"),))
    with pytest.raises(InputError, match="a Sampling, not str"):
        build_engine([(0, load_database([tmp_path / "a.dbc"]))], [MonitorInstance("m", none, Params())], [])
