"""Ranges of signals: as far as a drive knows, not farther than the database says."""

import cantools
import numpy as np
import pytest

from gateway_fdi.tails import exceeded_once, shape_of
from gateway_fleet.learn import tails
from gateway_fleet.learn.course import Course
from gateway_fleet.learn.novelty import in_words, per_minute
from gateway_fleet.learn.ranges import LASTS_S, SWINGS, Shown, is_careful, range_of, waiting
from gateway_fleet.learn.snapshots import Snapshots
from gateway_fleet.learn.standards import standard
from gateway_fleet.learn.tails import Rate, wandering

DBC = (
    'VERSION ""\nNS_ :\nBS_:\nBU_: A\nBO_ 256 M: 8 A\n SG_ Yaw : 0|16@1- (0.01,0) [0|0] "deg/s" A\n'
    ' SG_ Level : 16|16@1+ (1,0) [0|1000] "" A\n SG_ Wrong : 32|8@1- (1,0) [0|255] "" A\n'
    'BO_ 512 Coolant: 8 A\n SG_ Temp : 0|8@1+ (1,-40) [-40|150] "degC" A\n SG_ Oil : 8|8@1+ (1,-40) [0|0] "degC" A\n'
    ' SG_ BatteryVoltage : 16|16@1+ (0.01,0) [0|30] "V" A\nBO_ 768 F: 4 A\n SG_ Flow : 0|32@1- (1,0) [0|0] "" A\n'
    "SIG_VALTYPE_ 768 Flow : 1;\n"
)
BASE = cantools.database.load_string(DBC)
SIGNALS = {signal.name: signal for message in BASE.messages for signal in message.signals}


def seen(values):
    course = Course(count=len(values), lowest=values.min(), highest=values.max())
    course.values = set(np.unique(values)[:25].tolist())
    course.measure(values)
    return course


def found(name, values, *, step_s=0.05, every_s=0.05, rate=Rate(1e-3, 100), careful=True):
    values = np.asarray(values, np.float64)
    drive = Shown(values[:, None], step_s, rate, careful)
    return range_of(None, SIGNALS[name], seen(values), values, every_s, drive)


def swinging(seed, seconds, step_s, spread=1.0):
    """A signal that comes back each few seconds."""
    count, width = round(seconds / step_s), max(round(1.0 / step_s), 6)
    noise = np.random.default_rng(seed).normal(0, 1, count + width)
    return spread * np.convolve(noise, np.ones(width) / np.sqrt(width), "valid")[:count]


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("step_s", [0.05, 1.0])
@pytest.mark.parametrize("name", ["Yaw", "Flow"])
def test_a_signal_that_swings_often_gets_a_limit_that_hours_of_it_keep(seed, step_s, name):
    ends, why = found(name, swinging(seed, max(600.0, 7200.0 * step_s), step_s), step_s=step_s, every_s=step_s)
    more = swinging(seed + 100, 36_000.0, step_s)
    assert ends is not None, why
    assert ends[0] < more.min() < more.max() < ends[1], f"seed {seed}"
    assert max(-ends[0], ends[1]) < 16.0, "and it sees what is five times as large as any"


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_noise_about_one_value_says_nothing_of_where_it_goes(seed):
    """A brake that nobody pressed for 340 s, in each second: a range of its noise accused it once it was pressed."""
    still = np.random.default_rng(seed).normal(519.0, 8.0, 340).round()
    course = seen(still)
    assert course.swings >= SWINGS > course.ways
    assert found("Level", still, step_s=1.0, every_s=1.0)[0] == (-100.0, 1100.0), "but what the database says"
    assert found("Yaw", still / 100.0, step_s=1.0, every_s=1.0)[0] is None
    assert f"{course.ways} of 8 ways" in waiting(SIGNALS["Level"], course, 340.0), "and it is told"
    assert found("Yaw", still / 100.0, step_s=1.0, every_s=1.0, rate=Rate(36.0, 2))[0] is not None, "ten minutes' rate"


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_level_of_one_drive_is_no_limit_of_another(seed):
    """A race car's cell: 4.109 to 4.114 V in 190 s, through its span 15 times; 4.03 and 4.168 V in other drives."""
    cell = 411.1 + swinging(seed, 600.0, 0.1, spread=0.5).round(2)
    course = seen(cell)
    assert course.ways >= SWINGS
    assert found("Yaw", cell, step_s=0.1, every_s=0.1)[0] is None
    assert "near one level" in waiting(SIGNALS["Yaw"], course, 600.0)
    assert found("Yaw", cell - 411.1, step_s=0.1, every_s=0.1)[0] is not None, "about zero it shows how far it goes"


def test_a_rate_that_the_drive_itself_shows_is_taken_from_it():
    """An alarm each 200 s: no limit for years of it, but the one that is exceeded as often."""
    values, more = swinging(5, 1800.0, 1.0), swinging(6, 36_000.0, 1.0)
    ends, _ = found("Flow", values, step_s=1.0, every_s=1.0, rate=Rate(36.0, 2))
    beyond = (more < ends[0]) | (more > ends[1])
    lasting = beyond[1:] & beyond[:-1]
    alarms = np.count_nonzero(np.diff(lasting.astype(int)) > 0)
    assert 30 < alarms < 1000, "360 asked for"


def test_a_drive_that_shows_too_little_supports_no_limit_and_is_told():
    climbs = np.linspace(0.0, 20.0, 12_000).round(2)
    assert found("Yaw", climbs)[0] is None
    assert "of 8 ways through its span" in waiting(SIGNALS["Yaw"], seen(climbs), 600.0)
    assert found("Yaw", swinging(1, 20.0, 0.05))[0] is None, "20 s"
    ends, why = found("Flow", climbs)
    assert ends == (-200.0, 220.0), "of a float what is wild is told all the same"
    assert "ten times" in why
    assert seen(swinging(1, 600.0, 0.05)).swings >= SWINGS


@pytest.mark.parametrize("seed", [1, 2, 3, 4])
@pytest.mark.parametrize("step_s", [0.05, 1.0])
@pytest.mark.parametrize("name", ["Yaw", "Flow"])
def test_a_level_that_moves_all_the_time_gets_room_for_where_it_goes(seed, step_s, name):
    """It swings through its span with noise, but its mean climbs: a limit that holds tomorrow leaves room for it."""
    noise = swinging(seed, max(1200.0, 14_400.0 * step_s), step_s)
    climbs = noise + np.linspace(0.0, 4.0, len(noise))
    learned, more = np.split(climbs, 2)
    course, rate = seen(learned), Rate(4.0 if step_s < 1.0 else 1.0 / 30.0, 1)
    assert course.swings >= SWINGS
    assert course.walk > 1.0, f"seed {seed}"
    ends, why = found(name, learned, step_s=step_s, every_s=step_s, rate=rate)
    lasting = np.lib.stride_tricks.sliding_window_view(more, round(max(LASTS_S, step_s) / step_s) + 1).min(axis=1)
    assert lasting.max() < ends[1], f"seed {seed}"
    assert f"its level still moved after {10 if step_s < 1.0 else 120} min" in why
    hours, _ = found(name, learned, step_s=step_s, every_s=step_s)
    assert hours is None or hours[1] >= 9.0 * np.abs(learned).max(), "no such drive says where it is in 1e5 h"
    assert waiting(SIGNALS["Yaw"], course, 600.0) == "its level still moves"


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_random_walk_is_left_as_seldom_as_was_asked_for(seed, monkeypatch):
    """In its own law: a share of 1 - 1/e leaves within a time what is exceeded once in it."""
    rng = np.random.default_rng(seed)
    walks = np.cumsum(rng.normal(0.0, 1.0, (400, 2000)), axis=1)
    learned, later = walks[:, :500], walks[:, 500:]
    still = rng.normal(0.0, 1.0, (400, 500))
    refused = [wandering(walk) > 0.0 or seen(walk).swings < SWINGS for walk in learned]
    assert np.mean(refused) > 0.95, f"seed {seed}"
    assert np.mean([wandering(one) > 0.0 for one in still]) < 0.1, "noise is taken for it by chance only"
    assert wandering(np.ones(500)) == wandering(np.zeros(1)) == 0.0
    monkeypatch.setattr(tails, "MOVED", 0.0)
    once = np.sqrt(3.0 * np.mean([wandering(walk) ** 2 for walk in learned]))  # three times as long
    left = np.abs(later - learned[:, -1:]).max(axis=1) > once
    assert left.mean() == pytest.approx(1.0 - np.exp(-1.0), abs=0.1), f"seed {seed}"


@pytest.mark.parametrize("seed", [1, 2, 3, 4])
@pytest.mark.parametrize("drift", [0.0, 3.0])
@pytest.mark.parametrize("name", ["Yaw", "Flow"])
def test_fewer_false_alarms_never_make_a_limit_narrower(seed, drift, name):
    values = swinging(seed, 900.0, 0.1) + np.linspace(0.0, drift, 9000)
    widths = []
    for per_hour in (3000.0, 400.0, 100.0, 60.0, 40.0, 20.0, 9.0, 8.0, 7.0, 1.0, 0.1, 1e-3, 1e-6):
        low, high = found(name, values, step_s=0.1, every_s=0.1, rate=Rate(per_hour, 2))[0] or (-327.68, 327.67)
        widths.append((high, -low))
    assert widths == sorted(widths), f"seed {seed}"
    assert all(np.all(np.diff(np.array(widths), axis=0) >= 0.0, axis=1)), f"seed {seed}"
    assert widths[0] < widths[-1] or seen(values).swings < SWINGS


def test_a_database_is_a_bound_where_its_ranges_are_kept():
    values = np.clip(swinging(3, 600.0, 0.05, 60.0) + 300.0, 5, 995).round()
    ends, why = found("Level", values)
    assert ends[0] >= -100.0
    assert ends[1] <= 1100.0
    assert "database" in why
    still = np.full(1000, 7.0)
    assert found("Level", still)[0] == (-100.0, 1100.0)
    assert found("Level", still, careful=False)[0] is None, "ranges that others break say nothing of what stands"
    course = seen(np.arange(0.0, 100.0))
    assert is_careful([(SIGNALS["Level"], course)] * 3)
    assert not is_careful([(SIGNALS["Wrong"], course)]), "8 bits with a sign are never 255"
    assert not is_careful([(SIGNALS["Level"], seen(np.arange(0.0, 2000.0)))])


def test_coolant_and_supply_have_the_ranges_of_any_car():
    assert standard("Coolant", SIGNALS["Temp"], 84.0, 93.0).high == 130.0
    assert standard("Coolant", SIGNALS["Oil"], 84.0, 93.0) is None
    supply = standard("Battery", SIGNALS["BatteryVoltage"], 13.7, 14.1)
    assert (supply.low, supply.high) == (10.5, 16.0)
    assert supply.failed_ms == 10_000.0, "cranking takes seconds"
    assert standard("Battery", SIGNALS["BatteryVoltage"], 340.0, 401.0) is None, "a traction battery"
    assert standard("Battery", SIGNALS["BatteryVoltage"], 22.0, 28.0) is None, "a lorry's"


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_heavy_tail_is_followed_where_it_is_proven(seed):
    rng = np.random.default_rng(seed)
    heavy = (rng.random(4000) ** -0.3 - 1.0) / 0.3
    wanted = (1e6**0.3 - 1.0) / 0.3
    assert exceeded_once(heavy, 1e6, heavy=True) == pytest.approx(wanted, rel=0.6), f"seed {seed}"
    assert exceeded_once(heavy, 1e6) < 0.5 * wanted
    assert shape_of(np.sort(rng.exponential(size=200))) < 0.25


def test_each_minute_says_what_it_has_shown_that_none_before_had():
    seen, step = Snapshots(4), 1_000_000_000
    ends = (10.0, 20.0, 20.1, 5.0, 12.0, 30.0, *[7.0] * 6)  # farther in the first, the second and the sixth minute
    for minute, end in enumerate(ends):
        t_ns = np.arange(60, dtype=np.int64) * step + minute * 60 * step
        seen.grid(int(t_ns[0]), int(t_ns[-1]))
        values = np.stack([np.linspace(0.0, end, 60), -np.linspace(0.0, end, 60), np.full(60, 3.0)], 1)
        seen.put(slice(0, 3), t_ns, values)
        if minute >= 3:
            seen.put(slice(3, 4), t_ns, np.ones((60, 1)))  # a constant that comes late
        seen.end()
    assert per_minute(seen) == [3, 2, 0, 1, 0, 2, 0, 0, 0, 0, 0, 0]
    assert "none for 6 min: on drives like these at most one in 2.0 min (95 %)" in in_words(per_minute(seen))
    assert in_words([9, 4, 1, 0, 0]).endswith("more drive teaches more")
    assert in_words([*range(20, 0, -1)]).count(",") == 12
    assert per_minute(Snapshots(2)) == []
    seen._step_ns = 200 * step  # drives of weeks: a row is longer than a minute
    assert len(per_minute(seen)) == len(seen.matrix())
