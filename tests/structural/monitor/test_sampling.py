"""Values between two frames, held or on the line between them; jumps; what the noise makes of the filters."""

import cantools
import motor_data
import numpy as np
import pytest
from motor_data import B, J, K, R
from structural_config import configuration

from gateway.bus.frames import empty, put
from gateway.config.load import load_config
from gateway.config.monitor_types import monitor_of
from gateway.runtime.app import Gateway
from gateway_fdi import likelihood
from gateway_fdi.common.resources import shipped
from gateway_fdi.errors import GatewayError
from gateway_fdi.jit import COMPILED
from gateway_plants.structural.monitor import filters

BEGIN = 10**9
#: Time between frames of the two messages, not in step with each other or the samples [ns].
DRIVE_NS, SENSORS_NS = 13_000_000, 31_000_000


def plant(t):
    """u, i, w that fulfil the winding's equation exactly, and are straight lines for a second."""
    u = 4.0 + 5.0 * t
    w = 20.0 + 40.0 * t
    return u, (u - K * w) / R, w


def ramps(seconds, *, without=(2.0, 2.0)):
    """Frames of the two messages, each by its own clock; none of the sensors in a span of time [s]."""
    database = cantools.database.load_file(shipped("dbc/motor.dbc"))
    rows = [(k * DRIVE_NS, "Drive") for k in range(int(seconds * 1e9 / DRIVE_NS))]
    rows += [(2_000_000 + k * SENSORS_NS, "Sensors") for k in range(int(seconds * 1e9 / SENSORS_NS))]
    rows = sorted(r for r in rows if r[1] == "Drive" or not without[0] < r[0] * 1e-9 < without[1])
    frames = empty(len(rows))
    for n, (t_ns, name) in enumerate(rows):
        u, i, w = plant(t_ns * 1e-9)
        values = {"Voltage": u} if name == "Drive" else {"Current": i, "Speed": w}
        message = database.get_message_by_name(name)
        put(frames, n, BEGIN + t_ns, message.frame_id, message.encode(values, strict=False), bus=0)
    return frames


class Fed:
    """A gateway that is fed frames; what each sample was."""

    def __init__(self, config, frames):
        gateway = Gateway(load_config(config), None, file=config)
        gateway.start(BEGIN)
        self.state = gateway.engine.state_of(0)[0]
        self.rows = []
        trace = gateway.engine.state_of(0)[0]
        before = 0
        for k in range(len(frames)):
            gateway.feed(frames[k : k + 1])
            if trace.own.samples != before:
                before = int(trace.own.samples)
                self.rows.append((int(trace.own.last_ns), float(trace.own.residual[0]), before))
        gateway.close()

    @property
    def residuals(self):
        return np.array([r for _, r, _ in self.rows])


def test_a_value_is_held_for_some_cycles_of_its_message(tmp_path):
    """Sensors each 31 ms: 2.5 of these; told otherwise, as told."""
    frames = ramps(1.5, without=(1.0, 1.2))
    missed = [
        Fed(configuration(tmp_path, f"period_ms = 10\nsettle_s = 0\n{key}"), frames).state["samples_missed"]
        for key in ("", "max_age_ms = 250\n")
    ]
    assert missed[0] >= 10
    assert missed[1] == 0


@pytest.mark.parametrize("period_ms", [10.0, 50.0])
def test_a_ramp_between_frames(tmp_path, period_ms):
    """The winding's residual is 0 at every time: interpolated it is, to the signals' resolution; held it is not."""
    frames = ramps(1.5)
    keys = f"period_ms = {period_ms}\nsettle_s = 0\n"
    held = Fed(configuration(tmp_path, keys), frames)
    line = Fed(configuration(tmp_path, keys + 'between = "interpolated"\n'), frames)
    resolution = 0.01 + R * 0.01 + K * 0.1
    assert np.abs(line.residuals).max() < resolution
    assert np.abs(held.residuals).max() > 3 * resolution
    assert all(t % int(period_ms * 1e6) == 0 for t, _, _ in line.rows)
    # every sample of the clock up to the slowest signal's newest frame, several at once where it is slow
    newest = BEGIN + 2_000_000 + (int(1.5e9 / SENSORS_NS) - 1) * SENSORS_NS
    first = -(-(BEGIN + 2_000_000) // int(period_ms * 1e6))
    assert int(line.state.own.samples) == newest // int(period_ms * 1e6) - first + 1
    assert int(line.state.own.missed) == 0


def each(period_ms, begin_ms, seconds, name):
    return [(begin_ms * 1_000_000 + k * period_ms * 1_000_000, name) for k in range(int(seconds * 1e3 / period_ms))]


def ramp_frames(rows):
    """Frames at given times [ns], with the values of the ramps."""
    database = cantools.database.load_file(shipped("dbc/motor.dbc"))
    frames = empty(len(rows))
    for n, (t_ns, name) in enumerate(sorted(rows)):
        u, i, w = plant(t_ns * 1e-9)
        values = {"Voltage": u} if name == "Drive" else {"Current": i, "Speed": w}
        message = database.get_message_by_name(name)
        put(frames, n, BEGIN + t_ns, message.frame_id, message.encode(values, strict=False), bus=0)
    return frames


def test_a_fast_signal_waits_for_a_slow_one(tmp_path):
    """A hundred frames of the voltage for one of the sensors: no sample is lost for want of room."""
    rows = each(1, 0, 1.5, "Drive") + each(100, 3, 1.5, "Sensors")
    keys = 'period_ms = 10\nsettle_s = 0\nbetween = "interpolated"\n'
    fed = Fed(configuration(tmp_path, keys), ramp_frames(rows))
    assert int(fed.state.own.missed) == 0
    assert int(fed.state.own.samples) == 140  # from 10 ms, the first behind both, to 1.40 s
    assert int(fed.state.own.since_ns) == BEGIN + 10_000_000
    assert np.abs(fed.residuals).max() < 0.01 + R * 0.01 + K * 0.1


@pytest.mark.costly
def test_sets_faster_than_the_period_says(tmp_path):
    """Messages each 10 ms, period_ms = 100 by mistake: the integrals take the time that it was, not ten times of it."""
    frames = motor_data.frames_of(motor_data.drive(4.0, seed=3))
    found = {}
    for period in (10, 100):
        run = Fed(configuration(tmp_path, f'sample = "set"\nperiod_ms = {period}\nsettle_s = 0\n'), frames)
        found[period] = run.state.own.residual.copy()
        assert int(run.state.own.samples) == len(frames) // 2
    assert np.abs(found[10] - found[100]).max() < 1e-9


GROWTH = """
[unknown]
x = {}
[known]
y = {}
[fault]
f = {}
[parameter]
tau = { value = 1.0, unit = "s" }
[equation.e1]
relation = "der(x) = -x / tau"
unique = ["der(x)", "x"]
[equation.e2]
relation = "y = exp(x) + f"
unique = ["x"]
"""
FLOATS = """VERSION ""
NS_ :
BS_:
BU_: A
BO_ 256 M: 8 A
 SG_ y : 0|64@1- (1,0) [0|0] "" A
SIG_VALTYPE_ 256 y : 2;
"""


def logarithms(values):
    frames = empty(len(values))
    for n, value in enumerate(values):
        put(frames, n, BEGIN + n * 10_000_000, 256, np.float64(value).tobytes(), bus=0)
    return frames


def growth(folder):
    (folder / "growth.toml").write_text(GROWTH)
    (folder / "floats.dbc").write_text(FLOATS)
    path = folder / "gateway.toml"
    path.write_text(
        '[clock]\nwatched = false\n[[bus]]\nname = "b"\nuri = "virtual:x"\ndatabase = ["floats.dbc"]\n'
        f'health = {{ watched = false }}\n[memory]\npath = "{folder}/faults.sqlite"\n'
        '[[monitor]]\nname = "growth"\ntype = "structural"\nmodel = "growth.toml"\nperiod_ms = 10\nsample = "set"\n'
        'settle_s = 0.1\nsignals = { y = "M.y" }\nnu = { e2 = 0.1 }\nthresholds = { e2 = 10 }\n'
    )
    return path


@pytest.mark.skipif(not COMPILED, reason="log(-1) is no number there, and an error of plain Python")
def test_a_generator_without_a_number_begins_anew(tmp_path):
    """x begins at log(y), which -1 has none of: as soon as y is positive it begins, and the test settles alone."""
    values = [-1.0] * 30 + list(np.exp(np.exp(-0.01 * np.arange(200))))
    fed = Fed(growth(tmp_path), logarithms(values))
    assert np.isnan(fed.residuals[:30]).all()
    assert np.abs(fed.residuals[30:]).max() < 0.02
    assert int(fed.state.own.from_ns[0]) == BEGIN + 29 * 10_000_000
    assert int(fed.state.own.cusum[0].samples) == 200 - 9  # 0.1 s behind the last sample without a number


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_what_is_no_number_is_as_good_as_lost(tmp_path, value):
    values = np.exp(np.exp(-0.01 * np.arange(200)))
    values[100:103] = value
    fed = Fed(growth(tmp_path), logarithms(values))
    assert int(fed.state.own.samples) == 197
    assert np.isfinite(fed.residuals).all()
    assert np.abs(fed.residuals).max() < 0.1


def test_records_are_as_long_as_the_model_wants(tmp_path):
    """A motor of three inputs and four tests: not the room of a pack of 64 cells."""
    state = Fed(configuration(tmp_path), ramps(0.1)).state
    assert state.own.residual.shape == (4,)
    assert state.own.fired.shape == (1,)
    assert state.own.dtype.itemsize < 20_000


def test_no_line_over_a_gap(tmp_path):
    """The sensors are silent for 0.5 s: nothing is made up in between; what follows begins anew."""
    frames = ramps(2.0, without=(0.7, 1.2))
    keys = 'period_ms = 10\nsettle_s = 0\nmax_age_ms = 100\nbetween = "interpolated"\n'
    fed = Fed(configuration(tmp_path, keys), frames)
    times = np.array([t for t, _, _ in fed.rows])
    inside = (times > BEGIN + 720_000_000) & (times < BEGIN + 1_180_000_000)
    assert not inside.any()
    assert (times > BEGIN + 1_300_000_000).any()
    assert int(fed.state.own.missed) >= 45
    assert BEGIN + 1_180_000_000 < int(fed.state.own.since_ns) < BEGIN + 1_260_000_000


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ('between = "interpolated"\nsample = "set"\n', "between.*interpolated"),
        ('between = "interpolated"\nmax_age_ms = 700\n', r"max_age_ms.*at most 630"),
        ("noise = { q = 0.1 }\n", r"noise\.q.*known variables are u, i, w"),
        ("noise = { w = 0.0 }\n", r"noise\.w"),
        ('decision = "jumps"\n', "decision"),
    ],
)
def test_mistakes(tmp_path, keys, said):
    path = configuration(tmp_path, keys)
    with pytest.raises(GatewayError, match=said):
        Gateway(load_config(path), None, file=path)


# Jumps
# ----------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(5))
def test_the_ratio_is_that_of_all_beginnings(seed):
    """Twice the log ratio of a jump of the mean d samples ago: (sum of the last d)^2 / d, in standard deviations."""
    window = 8
    weighted, inverse = np.ones((window, 1, 1)), np.zeros((window, 1, 1))
    inverse[1:, 0, 0] = 1.0 / np.arange(1, window)
    begun, values = np.zeros((window, 1)), np.random.default_rng(seed).normal(size=60)
    for n, value in enumerate(values):
        kept = min(n + 1, window)
        found = likelihood.largest(begun, weighted, inverse, np.array([value]), n % window, kept, 1, 1)
        sums = [values[n - d + 1 : n + 1].sum() ** 2 / d for d in range(1, kept)]
        assert found == pytest.approx(max(sums, default=0.0), rel=1e-12, abs=1e-12)


def failures(config, rows):
    gateway = Gateway(load_config(config), None, file=config)
    events = []
    gateway.listen(events.append)
    gateway.start(BEGIN)
    gateway.feed(motor_data.frames_of(rows))
    gateway.close()
    return [
        ((e["t_ns"] - BEGIN) * 1e-9, e["fault"].split(".")[1])
        for e in events
        if e["event"] == "dtc" and e["status"] & 1
    ]


@pytest.mark.long
@pytest.mark.skipif(not COMPILED, reason="thousands of samples")
def test_jumps_of_the_motor(tmp_path):
    """Calibrated from a healthy drive, a fault that begins at once has its name sooner than by CUSUM; healthy: none."""
    from gateway.bus.logs import open_writer
    from gateway_calibration.cusum import learn
    from gateway_calibration.file import write
    from gateway_calibration.logs import Reading

    log = tmp_path / "healthy.log"
    writer = open_writer(log)
    writer.write(motor_data.frames_of(motor_data.drive(60, seed=11)))
    writer.close()
    delay = {}
    for decision in ("cusum", "jump"):
        keys = f'decision = "{decision}"\nactive = "omega > 20"\nsettle_s = 3\nconfirm_s = 0.1\n'
        config = configuration(tmp_path, keys, nu=None)
        write(config, learn(load_config(config), [log], Reading(config)).tables, "healthy log")
        assert failures(config, motor_data.drive(40, seed=13)) == []
        rows = motor_data.drive(20, seed=14, onset=10.0, f_w=12.0)
        found = failures(config, rows)
        assert [name for _, name in found][-1] == "f_w"
        delay[decision] = found[-1][0] - 10.0
    assert 0.1 <= delay["jump"] < delay["cusum"]


# Filters
# ----------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("bandwidth", [0.5, 5.0, 60.0])
def test_noise_of_a_slope(bandwidth):
    """What the formula says is what a low-pass leaves of white noise."""
    h, rng = 0.01, np.random.default_rng(5)
    k, low, slopes = 1.0 - np.exp(-bandwidth * h), 0.0, []
    for value in rng.normal(size=200_000) * 0.3:
        slopes.append(k * (value - low) / h)
        low += k * (value - low)
    assert np.std(slopes[2000:]) == pytest.approx(filters.slope_noise(0.3, bandwidth, h), rel=0.03)


def test_the_fitted_bandwidth_balances(tmp_path):
    for direct, slope in ((0.5, 0.02), (5.0, 0.1), (0.05, 0.002)):
        found = filters.fitted(direct, slope, 0.01, filtered=False, settle=30.0)
        assert filters.slope_noise(slope, found, 0.01) == pytest.approx(direct, rel=1e-6)
    assert filters.fitted(1e-9, 1.0, 0.01, filtered=False, settle=2.0) == pytest.approx(1.5)  # forgets within settle_s
    assert filters.fitted(1e9, 1.0, 0.01, filtered=False, settle=2.0) == pytest.approx(100.0)  # a sample


def test_noise_sets_the_motor_s_filters(tmp_path):
    """J der(w) = k i - b w, w = (u - R i) / k: noise of i in the slope of w, and in all else, as computed by hand."""
    keys = 'causality = "mixed"\nsettle_s = 600\nnoise = { i = 0.05, w = 0.3 }\n'
    path = configuration(tmp_path, keys, nu=None)
    monitor, params = monitor_of(load_config(path).monitor[0])
    (line,) = (n for n in monitor.notes(params) if n.startswith("test e3 "))
    assert "filter_bandwidth" in line
    assert "fitted to the noise" in line
    told = float(line.split("filter_bandwidth ")[1].split()[0])
    assert "by e1, e2, e4" in line  # the speed is that of the winding's equation, with the current's sensor
    direct, slope = (K + B * R / K) / J * 0.05, R / K * 0.05
    k = 1 - np.exp(-told * 0.01)
    assert direct * np.sqrt(k / (2 - k)) == pytest.approx(slope * k / 0.01 * np.sqrt(2 / (2 - k)), rel=0.01)
    given = configuration(tmp_path, keys + "filter_bandwidth = 2\n", nu=None)
    monitor, params = monitor_of(load_config(given).monitor[0])
    assert not any("fitted" in n for n in monitor.notes(params))


# Messages that stay away, and counters
# ----------------------------------------------------------------------------------------------------------------------

WITNESSES = """
[unknown]
x = {}
z = {}
[known]
a = {}
b = {}
c = {}
[fault]
f_a = {}
f_c = {}
[equation.e1]
relation = "a = x + f_a"
unique = ["x"]
[equation.e2]
relation = "b = x"
unique = ["x"]
[equation.e3]
relation = "c = z + f_c"
unique = ["z"]
[equation.e4]
relation = "b = z"
unique = ["z"]
"""


def witnesses(folder, keys):
    """Two sensors, each beside a third one: a monitor of three messages with counters."""
    (folder / "witnesses.toml").write_text(WITNESSES)
    rows = ['VERSION ""', "NS_ :", "BS_:", "BU_: A"]
    for k, name in enumerate("abc"):
        rows += [f"BO_ {256 + k} {name.upper()}: 8 A", f' SG_ {name} : 0|16@1- (0.001,0) [0|0] "" A']
        rows += [' SG_ Count : 16|4@1+ (1,0) [0|0] "" A']
    (folder / "witnesses.dbc").write_text("\n".join(rows) + "\n")
    path = folder / "gateway.toml"
    path.write_text(
        '[clock]\nwatched = false\n[[bus]]\nname = "b"\nuri = "virtual:x"\ndatabase = ["witnesses.dbc"]\n'
        f'health = {{ watched = false }}\n[memory]\npath = "{folder}/faults.sqlite"\n'
        '[[monitor]]\nname = "w"\ntype = "structural"\nmodel = "witnesses.toml"\nperiod_ms = 10\nsettle_s = 0.1\n'
        f'confirm_s = 0.1\n{keys}signals = {{ a = "A.a", b = "B.b", c = "C.c" }}\n'
    )
    tests = _tests_of(path)
    given = "".join(
        f"{key} = {{ {', '.join(f'{t} = {v}' for t in tests)} }}\n" for key, v in (("nu", 0.01), ("thresholds", 20))
    )
    path.write_text(path.read_text() + given)
    return path


def _tests_of(path):
    from gateway.monitors.contract import CusumCalibration

    monitor, _ = monitor_of(load_config(path).monitor[0])
    return [name for name, _ in monitor.capability(CusumCalibration).quantities]


def three(arrivals):
    """Frames of (time [ms], message 0 to 2, value, number)."""
    frames = empty(len(arrivals))
    for n, (t_ms, message, value, number) in enumerate(sorted(arrivals)):
        data = round(1000 * float(value)).to_bytes(2, "little", signed=True) + bytes([number % 16]) + bytes(5)
        put(frames, n, BEGIN + round(t_ms * 1e6), 256 + message, data, bus=0)
    return frames


def told(config, frames):
    """Return what was set, as (seconds, fault), and the readout."""
    gateway = Gateway(load_config(config), None, file=config)
    events = []
    gateway.listen(events.append)
    gateway.start(BEGIN)
    gateway.feed(frames)
    summary = gateway.summary(1.0)["monitors"]["w"]
    gateway.close()
    dtcs = [e for e in events if e["event"] == "dtc" and e["status"] & 1]
    return [((e["t_ns"] - BEGIN) * 1e-9, e["fault"].split(".")[1]) for e in dtcs], summary


SAMPLES = {
    "clock": "max_age_ms = 25\n",
    "line": 'between = "interpolated"\n',
    "set": 'sample = "set"\n',
    "counter": 'sample = "counter"\ncounters = ["A.Count", "B.Count", "C.Count"]\n',
}


@pytest.mark.parametrize("keys", SAMPLES.values(), ids=SAMPLES)
def test_a_message_that_stays_away_takes_its_own_tests_along_only(tmp_path, keys):
    """c falls silent at 1 s, a is off from 2 s on: found, and nothing of c; c comes again at 4 s with its fault."""
    arrivals = []
    for k in range(600):
        t, off = 10 * k, 1.0 if 200 <= k < 300 else 0.0
        arrivals += [(t + 1, 0, np.sin(0.01 * k) + off, k), (t + 2, 1, np.sin(0.01 * k), k)]
        if not 100 <= k < 400:
            arrivals.append((t + 3, 2, np.sin(0.01 * k) + (1.0 if k >= 450 else 0.0), k))
    found, summary = told(witnesses(tmp_path, keys), three(arrivals))
    assert [name for _, name in found] == ["f_a", "f_c"], found
    assert 2.0 < found[0][0] < 2.4
    assert 4.5 < found[1][0] < 4.9
    assert summary["tests_without"] == 0, "it is there again"
    assert 550 < summary["samples_taken"] <= 600


@pytest.mark.costly
def test_by_counter_a_value_that_moves_has_no_error_though_frames_are_late_overtaken_and_lost(tmp_path):
    """Up to 8 ms late, of one period: by the clock the held values are of other times, by counter they are of one."""
    rng = np.random.default_rng(4)
    arrivals = []
    for k in range(1000):
        for message in range(3):
            if rng.random() > 0.02:
                late = rng.uniform(0.0, 8.0) + (12.0 if rng.random() < 0.02 else 0.0)
                arrivals.append((10 * k + late, message, 5.0 * np.sin(0.05 * k), k))
    by_clock, _ = told(witnesses(tmp_path, SAMPLES["clock"]), three(arrivals))
    by_counter, summary = told(witnesses(tmp_path, SAMPLES["counter"]), three(arrivals))
    assert by_clock
    assert not by_counter
    assert summary["samples_taken"] > 800
    assert summary["overtaken"] > 0


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ('sample = "counter"\n', "counters"),
        ('counters = ["A.Count"]\n', "counters"),
        ('sample = "counter"\ncounters = ["A.Count", "B.Count", "C.Count"]\nmax_age_ms = 5\n', "max_age_ms"),
        ('sample = "counter"\ncounters = ["A.Cuont"]\n', "Cuont"),
    ],
)
def test_mistakes_with_counters(tmp_path, keys, said):
    with pytest.raises(GatewayError, match=said):
        told(witnesses(tmp_path, keys), three([(0, 0, 0.0, 0)]))
