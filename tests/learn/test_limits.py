"""Limits that see: tails at a told rate, relations that hold outside of what was seen, signals that must move."""

import struct

import numpy as np
import pytest
from learning import asked, drive, quiet

from gateway.bus.logs import LogReader
from gateway.config.load import load_config
from gateway_bench.wire.replay import through
from gateway_fleet.learn.fits import delay_of, fitted
from gateway_fleet.learn.learn import learn, write
from gateway_fleet.learn.relations import SUM, TIMES, relations
from gateway_fleet.learn.tails import Rate, block_maxima, limit_above, sustained
from gateway_replay.channels import channels_of


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_limit_of_exponential_maxima_is_that_of_their_law(seed):
    """Of maxima with mean 1 in blocks of a second one in n exceeds ln n."""
    maxima = np.random.default_rng(seed).exponential(1.0, 20000)
    wanted, rate = np.log(1e5 * 3600.0), Rate(1e-3, 100)
    assert limit_above(maxima, 1.0, 0.0, rate) == pytest.approx(wanted, rel=0.12), f"seed {seed}"
    assert limit_above(maxima, 10.0, 0.0, rate) < limit_above(maxima, 1.0, 0.0, rate)
    assert limit_above(np.zeros(100), 1.0, 0.5, rate) > 5.0, "what never moved is known to its resolution only"


def test_a_deviation_counts_while_it_lasts():
    off = np.array([0.0, 5.0, -5.0, 3.0, 3.0, 4.0, 0.0, -2.0, -1.0, -3.0])
    assert sustained(off, 3).tolist() == [0.0, 0.0, 0.0, 3.0, 0.0, 0.0, 0.0, 1.0]
    assert block_maxima(off, 4).tolist() == [5.0, 4.0, -1.0]


def road(seed, count=4000):
    rng = np.random.default_rng(seed)
    return 12.0 + 6.0 * np.convolve(rng.normal(0, 1, count + 200), np.ones(201) / 14.0, "valid")[:count]


@pytest.mark.parametrize("seed", [11, 12, 13])
def test_noise_on_both_sides_bends_no_slope_and_delays_are_found(seed):
    rng = np.random.default_rng(seed)
    v = road(seed)
    noise = 0.3 * v.std()
    x, y = v + rng.normal(0, noise, len(v)), 2.0 * v + rng.normal(0, 2.0 * noise, len(v))
    y[::97] += 40.0  # slip
    assert abs(fitted(x, y)[0] - 2.0) < 0.05, f"seed {seed}"
    assert abs(np.polyfit(x, y, 1)[0] - 2.0) > 0.1, "least squares bends it"
    for delay in (-5, 0, 7):
        assert delay_of(v, 3.0 * np.roll(v, delay)) == delay, f"seed {seed}"


@pytest.mark.parametrize("seed", [17, 18])
def test_a_pedal_that_is_pressed_late_and_has_few_values_is_its_copy(seed):
    """Coasting for half of the drive; of 14 values each is that of the copy. One that is off now and then is none."""
    rng = np.random.default_rng(seed)
    pedal = np.clip(np.round(np.convolve(rng.normal(0, 4.0, 700), np.ones(20) / 4.0, "same")), 0, 13)
    pedal[:360] = 0.0
    (copy,) = relations(np.column_stack([pedal, 2.5 * pedal]), [True] * 2)
    assert abs(copy.slope) in (pytest.approx(2.5), pytest.approx(0.4))
    other = 2.5 * pedal
    other[400:700:37] += 6.0
    assert relations(np.column_stack([pedal, other]), [True] * 2) == [], f"seed {seed}"


@pytest.mark.parametrize("seed", [21, 22])
def test_laws_of_three_signals(seed):
    """The yaw rate is that of the wheels' difference, and that of speed and steering angle."""
    rng = np.random.default_rng(seed)
    v, angle = np.abs(road(seed)) + 2.0, 10.0 * (road(seed + 50) - 12.0)
    yaw = v * angle / 40.0
    left, right = v - 0.0135 * yaw, v + 0.0135 * yaw
    noise = [rng.normal(0, size, len(v)) for size in (0.002, 0.002, 0.002, 0.01, 0.01)]
    values = np.column_stack([v, left, right, angle, yaw]) + np.column_stack(noise)
    found = relations(values, [True] * 5)
    assert any(r.of == 4 and r.form == SUM and set(r.by) <= {0, 1, 2} for r in found), f"seed {seed}"
    found = relations(np.column_stack([values[:, 0], 3.6 * v, values[:, 3:]]), [True] * 4)
    law = [r for r in found if r.form == TIMES]
    assert [r for r in law if r.of == 3 and 2 in r.by], f"seed {seed}"
    assert law[0].slope == pytest.approx(1 / 40, rel=0.02)
    # What hardly changes is no factor, nor where its message came for a part of the drive only.
    trip = 100.0 + np.arange(len(v)) * 1e-3
    trip[:500], angle[:500] = np.nan, -angle[:500]
    effort = 0.02 * angle + rng.normal(0, 0.05, len(v))
    found = relations(np.column_stack([angle, angle + rng.normal(0, 0.01, len(v)), trip, effort]), [True] * 4)
    assert not [r for r in found if r.form == TIMES], f"seed {seed}"


DBC = """VERSION ""
NS_ :
BS_:
BU_: Motor
BO_ 257 Torque: 8 Motor
 SG_ Request : 0|16@1+ (4,-131072) [-131072|131068] "Nm" Motor
 SG_ Least : 16|16@1+ (4,-131072) [-131072|131068] "Nm" Motor
"""


def torques(path, seed, pressed):
    """Write an idling engine whose requested torque is the least one, until the pedal is pressed."""
    least = np.rint((41000.0 + 300.0 * (road(seed, 800) - 12.0) / 6.0) / 4.0).astype(int).tolist()
    ask = [raw + 2700 * (pressed and k > 400) for k, raw in enumerate(least)]
    return drive(path, 40.0, [(257, 0.05, lambda k: struct.pack("<HHI", ask[k], least[k], 0), 0.0)])


def test_what_is_equal_while_an_engine_idles_may_part_when_the_pedal_is_pressed(tmp_path):
    """Its values span a hundredth of their size: nothing says that one is the other times a factor."""
    (tmp_path / "car.dbc").write_text(DBC)
    log, out = torques(tmp_path / "idle.log", 41, pressed=False), tmp_path / "car.toml"
    result = learn(asked(out, log, databases=(tmp_path / "car.dbc",)), quiet)
    write(result.files(out))
    config = load_config(out)
    assert "_by_" in out.read_text(), "they are a relation"
    log = torques(tmp_path / "pressed.log", 42, pressed=True)
    said = through(config, list(LogReader(log, channels_of(config, ()))))
    assert [name for _, name, failed in said.dtcs if failed] == []
