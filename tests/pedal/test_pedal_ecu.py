"""The virtual pedal: strokes, sensors, faults, frames, and what a scenario may not say."""

import cantools
import crccheck
import numpy as np
import pytest

from gateway.bus.frames import payload
from gateway_bench.vecu.contract import Run
from gateway_bench.vecu.scenario import load_scenario
from gateway_bench.vecu.sensor_faults import digitised
from gateway_fdi.common.resources import shipped
from gateway_fdi.errors import InputErrors
from gateway_plants.pedal.ecu import strokes
from gateway_plants.pedal.ecu.ecu import ECU
from gateway_plants.pedal.ecu.params import PedalParams, SensorFault

DATABASE = cantools.database.load_file(shipped("dbc/pedal.dbc"))


def readings(*faults, seconds=2.0, seed=1, **params):
    """Return (decoded channels, shape (n, 2) [V], truth)."""
    chosen = PedalParams(**params)
    frames, truth = ECU.frames(chosen, faults, Run(seconds, 0, np.random.default_rng(seed)))
    message = DATABASE.get_message_by_name(chosen.message)
    rows = [message.decode(payload(frame)) for frame in frames]
    return np.array([[row[s.signal] for s in chosen.sensors] for row in rows]), truth, frames


def test_the_papers_stroke_has_the_samples_it_quotes():
    v = 5 * strokes.exponential(np.arange(1000) * 1e-3)
    assert v[42] == pytest.approx(1.80, abs=0.001)
    assert v[746] == pytest.approx(2.11, abs=0.005)
    assert v[999] == pytest.approx(0.57, abs=0.005)


@pytest.mark.parametrize("seed", range(5))
def test_driving_is_a_foots(seed):
    """In 0 to 1, at rest often, faster than nobody: 20 travels a second is what the monitor allows."""
    print("seed", seed)
    t = np.arange(60_000) * 1e-3
    x = strokes.driving(t, np.random.default_rng(seed))
    assert (x.min(), x.max() <= 1) == (0, True)
    assert x.max() > 0.4
    assert np.abs(np.diff(x)).max() < 0.02
    assert np.abs(np.diff(x, 2)).max() < 1e-3
    assert 0.05 < (x < 0.01).mean() < 0.9
    np.testing.assert_array_equal(x, strokes.driving(t, np.random.default_rng(seed)))


def test_frames_are_counted_protected_and_a_millisecond_apart():
    _, _, frames = readings(seconds=1.0)
    message = DATABASE.get_message_by_name("PED_Brake")
    assert len(frames) == 1000
    assert (np.diff(frames["t_ns"]) > 0).all()
    assert np.abs(frames["t_ns"] - np.arange(1000) * 1_000_000).max() <= 200_000
    for k, frame in enumerate(frames[:50]):
        data = payload(frame)
        assert message.decode(data)["FrameCnt"] == k % 16
        covered = data[1:] + message.frame_id.to_bytes(2, "little")
        assert crccheck.crc.Crc8SaeJ1850.calc(covered) == data[0]


def test_channels_of_the_brake_go_opposite_ways_and_add_up():
    y, truth, _ = readings(stroke="exponential", at_s=(0.2,))
    assert truth == []
    np.testing.assert_allclose(y.sum(1), 5.0, atol=0.02)
    assert np.ptp(y[:, 0]) > 3


@pytest.mark.parametrize(
    ("kind", "expected"),
    [
        ("short_to_ground", lambda bad, good: (bad == 0).all()),
        ("open", lambda bad, good: (bad == 0).all()),
        ("short_to_supply", lambda bad, good: (bad > 4.99).all()),
        ("stuck", lambda bad, good: np.ptp(bad) == 0),
        ("offset", lambda bad, good: np.allclose(bad - good, 0.5, atol=0.03)),
        ("drift", lambda bad, good: (bad - good)[-1] == pytest.approx(0.25, abs=0.02)),
        ("noise", lambda bad, good: 0.3 < np.std(bad - good) < 0.6),
        ("garbage", lambda bad, good: np.ptp(bad) > 4.5),
        ("impulses", lambda bad, good: 0.1 < (np.abs(bad - good) > 0.02).mean() < 0.2),
    ],
)
def test_each_fault_is_what_it_says_while_it_lasts(kind, expected):
    fault = SensorFault(kind=kind, channel=(1,), from_s=1.0, to_s=1.5, size=0.1)
    points = ((0.0, 0.3), (2.0, 0.5))
    y, truth, _ = readings(fault, stroke="points", points=points)
    healthy = 5 - y[:, 1]
    inside = slice(1000, 1500)
    assert [(t.t_ns, t.kind, t.count) for t in truth] == [(1_000_000_000, kind, 500)]
    assert expected(y[inside, 0], healthy[inside])
    np.testing.assert_allclose(y[:1000, 0], healthy[:1000], atol=0.02)
    np.testing.assert_allclose(y[1500:, 0], healthy[1500:], atol=0.02)


def test_common_errors_are_the_same_on_all_channels_and_others_are_not():
    for common in (True, False):
        fault = SensorFault(kind="noise", channel=(1, 2), size=0.1, common=common)
        y, _, _ = readings(fault, stroke="points", points=((0.0, 0.5), (2.0, 0.5)))
        correlation = np.corrcoef(y.T)[0, 1]
        assert correlation > 0.99 if common else abs(correlation) < 0.1


def test_an_adc_has_so_many_codes():
    codes = np.unique(digitised(np.linspace(-1, 6, 100_000), 5.0, 10))
    assert len(codes) == 1024
    assert (codes[0], codes[-1]) == (0, 5 * 1023 / 1024)
    np.testing.assert_array_equal(digitised(np.array([-1.0, 2.5, 7.0]), 5.0, 0), [0, 2.5, 5])


SCENARIO = """
name = "x"
duration_s = 1.0
config = "c.toml"
[[ecu]]
type = "pedal"
"""


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("period_ms = 0\n", r"ecu\[0\]\.period_ms = 0"),
        ('[[fault]]\nkind = "stuck"\nsize = "x"\n', r"fault\[0\]\.size = 'x'"),
        ('[[ecu]]\ntype = "radio"\n', r"ecu\[1\]\.type = 'radio': there are .*\bfmu\b.*\bpedal\b"),
        ("speed = 1\n", r"ecu\[0\]\.speed: unknown key"),
        ('[[fault]]\nkind = "stuck"\nchannel = [3]\n', "no channel 3"),
        ('[[fault]]\nkind = "stuck"\nchannel = [0]\n', "channels count from 1"),
        ('[[fault]]\nkind = "missed_pulses"\necu = "pedal"\nat_s = 1.0\n', "no missed_pulses"),
        ('[[fault]]\nkind = "stuck"\nfrom_s = 2.0\nto_s = 1.0\n', "to_s must lie after"),
        ('[[fault]]\nkind = "loose"\n', "loose"),
        ('stroke = "points"\n', "needs points"),
        ('stroke = "points"\npoints = [[0.0, 0.0], [0.0, 1.0]]\n', "must rise"),
        ('stroke = "points"\npoints = [[0.0, 2.0]]\n', "between 0 and 1"),
        (
            'sensor = [{ signal = "Ch9", at_rest = 0.5, at_full = 4.5 }]\n',
            "has the signals Ch1, Ch2",
        ),
    ],
)
def test_a_wrong_scenario_is_refused_with_its_key(tmp_path, text, says):
    path = tmp_path / "wrong.toml"
    path.write_text(SCENARIO + text)
    with pytest.raises(InputErrors, match=says) as caught:
        load_scenario(path)
    assert len(str(caught.value).splitlines()) == 1, "one mistake, one line"
    assert "wrong.toml" in str(caught.value)
