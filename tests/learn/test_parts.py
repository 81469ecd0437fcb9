"""What logs are looked at for: how messages are sent, how long signals rest, which of them follow each other."""

import tomllib
from types import SimpleNamespace

import numpy as np
import pytest

from gateway.bus.frames import empty
from gateway_fleet.learn.course import Courses
from gateway_fleet.learn.document import BusAsked
from gateway_fleet.learn.figures import Everyday
from gateway_fleet.learn.gaps import CYCLIC, MIXED, ON_CHANGE, TOO_FEW, Gaps, sending, shows_loss, timeout_ms
from gateway_fleet.learn.lines import CHECK, RULE, SIGNAL, Learned, Line
from gateway_fleet.learn.merge import File, merged, read
from gateway_fleet.learn.relations import relations
from gateway_fleet.learn.report import _faults, _size
from gateway_fleet.learn.samples import Samples
from gateway_fleet.learn.state import Kept
from gateway_fleet.learn.trial import OFFSETS, Smallest, _smallest
from gateway_fleet.learn.update import add_before
from gateway_fleet.study.learn.drive import late_host

MS = 1_000_000


def gaps_of(steps_ms):
    gaps = Gaps()
    stamps = np.rint(np.cumsum([0.0, *steps_ms]) * MS).astype(np.int64) + 10**15
    for part in np.array_split(stamps, 7):
        if len(part):
            gaps.add(part)
    return gaps


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize(
    ("kind", "steps"),
    [
        (CYCLIC, lambda rng: rng.uniform(9, 13, 2000)),
        (MIXED, lambda rng: rng.choice([3.0, 100.0], 2000, p=[0.6, 0.4])),
        (ON_CHANGE, lambda rng: rng.exponential(200.0, 2000)),
        (TOO_FEW, lambda rng: rng.uniform(9, 13, 6)),
    ],
)
def test_how_a_message_is_sent(kind, steps, seed):
    gaps = gaps_of(steps(np.random.default_rng(seed)))
    assert sending(gaps) == kind
    limit = timeout_ms(gaps)
    assert (limit is None) == (kind in (ON_CHANGE, TOO_FEW))
    if limit is not None:
        assert 2 * gaps.largest_ns <= limit * MS <= 10 * gaps.largest_ns
    assert Gaps.of(gaps.data()).quantile_ns(0.5) == gaps.quantile_ns(0.5)


def test_few_frames_by_chance_are_no_cycle():
    """1000 messages that come when they like, with 10 to 37 gaps."""
    rng = np.random.default_rng(31)
    assert not [n for n in range(10, 40, 3) for _ in range(100) if timeout_ms(gaps_of(rng.exponential(4000.0, n)))], (
        "31"
    )
    assert timeout_ms(gaps_of(rng.normal(3000.0, 10.0, 12))) > 9000.0, "twelve gaps alike are"


def test_where_few_frames_come_nobody_shows_a_loss_and_a_timeout_is_longer():
    """At a loss of three in ten, five frames in a row are lost each minute or two, ten in a row in days."""
    slow, fast = (gaps_of(np.full(400, cycle)) for cycle in (500.0, 20.0))
    assert not shows_loss([slow, gaps_of(np.random.default_rng(8).exponential(20.0, 400))]), "on change: no cycle"
    assert shows_loss([slow, fast])
    assert timeout_ms(slow) == pytest.approx(2500.0, rel=0.05)
    assert timeout_ms(slow, shown=False) == pytest.approx(5000.0, rel=0.05)


def test_a_gap_between_two_logs_is_none():
    gaps = gaps_of([10.0] * 50)
    gaps.begin()
    gaps.add(np.array([10**18, 10**18 + 10 * MS]))
    assert gaps.count == 51
    assert gaps.largest_ns == 10 * MS


@pytest.mark.parametrize("batch", [1, 7, 1000])
def test_a_course_beside_its_values(batch):
    """Whatever the batches: extremes and steepness without the first second, changes, the longest rest and no value."""
    t = np.arange(1000, dtype=np.int64) * 10 * MS
    x = np.repeat(np.arange(100.0), 10)
    x[:50], x[300:400], x[600:650] = 900.0, 30.0, 255.0
    courses = Courses([(255.0,)])
    courses.begin(0)
    for k in range(0, 1000, batch):
        courses.add(t[k : k + batch], x[k : k + batch, None].copy())
    (course,) = courses.each
    assert (course.lowest, course.highest) == (10.0, 99.0)
    assert course.none == 50
    assert course.none_s == pytest.approx(0.5, abs=0.011)
    assert course.rest_s == pytest.approx(1.0, abs=0.011)
    assert course.steepest == pytest.approx(1000.0), "40 - 30 behind the rest, in 10 ms"
    assert not course.states


def road(seed, count=3000):
    """Speeds with hills, as no two waves have them by chance."""
    rng = np.random.default_rng(seed)
    return 60.0 + np.cumsum(np.convolve(rng.normal(0, 0.4, count + 40), np.ones(41) / 6.4, "valid"))[:count] * 0.3


@pytest.mark.parametrize("seed", [11, 12, 13])
def test_what_follows_another_and_what_only_seems_to(seed):
    rng = np.random.default_rng(seed)
    v, turn = road(seed), road(seed + 100) - 60.0
    turn *= 0.02 * v.std() / turn.std()
    left, right = v - turn, v + turn
    t = np.arange(len(v)) * 0.05
    signals = {
        "left": left,
        "right": right,
        "speed": 3.6 * v + 2.0,
        "copy": 1.8 * v - 5.0,
        "yaw": 40.0 * (right - left) - 1.0,
        "wave": np.sin(t / 60.0),
        "like": 2.0 * np.sin(t / 60.5) + 0.1,
        "grows": t,
        "wears": 100.0 - 0.01 * t - 1e-7 * t**2,
        "noise": rng.normal(0, 1, len(v)),
    }
    names = list(signals)
    values = np.column_stack(list(signals.values())) + rng.normal(0, 1e-3, (len(v), len(names)))
    values[::17, 0] = np.nan
    found = {(names[r.of], tuple(names[k] for k in r.by)): r for r in relations(values, [True] * len(names))}
    pairs = {frozenset({of, *by}) for of, by in found if len(by) == 1}
    assert all(pair <= {"left", "right", "speed", "copy"} for pair in pairs)
    assert any("copy" in pair for pair in pairs)
    (yaw,) = [relation for (of, by), relation in found.items() if len(by) == 2 and of == "yaw"]
    assert abs(yaw.slope) > 1.0
    assert {of for of, by in found if len(by) == 2} == {"yaw"}


def test_what_healthy_logs_broke_stays_out_when_others_are_added():
    """The new drive keeps to the limit: that says nothing against the one that did not."""
    lines = [
        Line("b", CHECK, "M", {"message": "M", "timeout_ms": 50.0}, ""),
        Line("b", SIGNAL, "M.X", {"signal": "M.X", "gradient": 3.0}, ""),
        Line("b", RULE, "r", {"name": "r", "holds": "M.X == M.Y", "tolerance": 1.0}, ""),
    ]
    learned = Learned({line.place: line for line in lines})
    kept = Kept(refused={(lines[0].place, "timeout_ms"), (lines[1].place, "gradient"), (lines[2].place, "holds")})
    nothing = File([], {}, {})
    assert add_before(learned, kept, nothing, (BusAsked("b", "virtual:x", ()),)) == set()
    assert [line.keys for line in learned.lines.values()] == [{"message": "M"}]
    assert "earlier logs broke it" in learned.lines[lines[0].place].why


@pytest.mark.parametrize(
    ("named", "found", "cell"),
    [
        ({1.0: 4, 0.5: 4, 0.25: 3}, Smallest(5.0, 4, 4), "5 V"),
        ({1.0: 3, 2.0: 4}, Smallest(20.0, 4, 4), "20 V"),
        ({4.0: 2}, Smallest(40.0, 2, 4), "40 V at 2 of 4"),
        ({}, None, "-"),
    ],
)
def test_a_size_is_seen_that_is_named_at_each_moment(named, found, cell):
    bench = SimpleNamespace(share=lambda size: Smallest(10.0 * size, named.get(size, 0), 4))
    smallest = _smallest(bench, OFFSETS, lambda size: size)
    assert smallest == found
    assert _size(smallest, " V") == cell


def test_frames_of_a_late_host_keep_their_order_and_are_never_too_early():
    frames = empty(5000)
    frames["t_ns"] = np.cumsum(np.random.default_rng(4).integers(0, 2 * MS, 5000))  # seed 4
    late = late_host(frames, 0.1, 5)["t_ns"] - frames["t_ns"]
    assert 0 == late.min() < late.max() <= 100 * MS
    assert (np.diff(frames["t_ns"] + late) >= 0).all()


def test_a_table_of_faults_has_as_many_cells_in_each_line():
    outcomes = [
        SimpleNamespace(
            named=named,
            frames=9,
            trial=SimpleNamespace(message=message, injection=SimpleNamespace(kind=kind, signal=None)),
        )
        for message, kind, named in (
            ("A", "drop", True),
            ("A", "drop", False),
            ("A", "flip", True),
            ("B", "noise", True),
        )
    ]
    found = Everyday("offset", "b.A.x +3", ("x.high",), named=True, accused=False)
    silent = Everyday("offset", "b.A.y +2", (), named=False, accused=False)
    trials = SimpleNamespace(left=0, seeing=(), unwatched=(), everyday=[found, silent])
    text = "\n".join(_faults(SimpleNamespace(outcomes=outcomes, trials=trials)))
    assert "| offset | 2 | 1 | 1 | 1 |" in text
    assert "- offset: b.A.y +2" in text, "what is silent is told"
    assert [line for line in text.splitlines() if line.startswith("|")][3:] == [
        "| message | drop | flip | noise |",
        "|---|---|---|---|",
        "| A | 1/2 | 1/1 |  |",
        "| B |  |  | 1/1 |",
    ]
    assert "- drop of A: nothing was set (9 frames)" in text


def test_causes_are_added_to_a_file_that_has_none_and_are_there_once_after_the_next_time():
    buses = (BusAsked("b", "virtual:x", ()),)
    lines = [
        Line("b", SIGNAL, "M.X", {"signal": "M.X", "gradient": 3.0}, ""),
        Line("b", RULE, "r", {"name": "r", "holds": "M.X == M.Y", "tolerance": 1.0}, ""),
    ]
    learned = Learned({line.place: line for line in lines})
    first = merged(read('[[bus]]\nname = "b"\nuri = "virtual:x"\n'), learned, {}, set(), buses)
    assert tomllib.loads(first)["fault"] == {"relations.r": {"caused_by": ["signals.X.gradient"]}}
    again = merged(read(first), learned, learned.lines, set(), buses)
    assert tomllib.loads(again) == tomllib.loads(first)


@pytest.mark.parametrize("batch", [10_000, 1000])
def test_kept_runs_of_frames_do_not_overlap_and_lie_farther_and_farther_apart(batch):
    samples, words = Samples(), np.arange(80_000, dtype=np.uint64).reshape(10_000, 8)
    for k in range(0, 10_000, batch):
        part = words[k : k + batch]
        samples.add(part, np.full(len(part), 8), np.arange(k, k + len(part)))
    assert [int(t_ns[0]) for t_ns in samples.stamps] == [0, 512, 1024, 1536, 2304, 3456, 5184, 7776]
    for run, t_ns in zip(samples.runs, samples.stamps, strict=True):
        assert len(t_ns) == min(512, batch - int(t_ns[0]) % batch)
        np.testing.assert_array_equal(run.words, words[t_ns[0] : t_ns[0] + len(t_ns)])
