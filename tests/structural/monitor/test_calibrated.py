"""From equations and a healthy log alone: gateway calibrate sets nu and J, and the faults have their names."""

import cantools
import motor_data
import numpy as np
import pytest
from structural_config import configuration

from gateway.bus.frames import empty, put
from gateway.bus.logs import open_writer
from gateway.config.load import load_config
from gateway.config.monitor_types import monitor_of
from gateway.runtime.app import Gateway
from gateway_calibration.cusum import learn
from gateway_calibration.file import write
from gateway_calibration.logs import Reading
from gateway_fdi.cusum import typical
from gateway_fdi.errors import InputError
from gateway_fdi.jit import COMPILED

pytestmark = [pytest.mark.long, pytest.mark.skipif(not COMPILED, reason="tens of thousands of samples")]
BEGIN = 10**9


def log_of(path, frames):
    writer = open_writer(path)
    writer.write(frames)
    writer.close()
    return path


def calibrated(config, *frames):
    """Calibrate a configuration by healthy frames; returns what was found."""
    logs = [log_of(config.with_name(f"healthy_{k}.log"), each) for k, each in enumerate(frames)]
    found = learn(load_config(config), logs, Reading(config))
    assert found.failed == ()
    write(config, found.tables, "healthy logs")
    return found


def failed(config, frames):
    gateway = Gateway(load_config(config), None, file=config)
    events = []
    gateway.listen(events.append)
    gateway.start(BEGIN)
    gateway.feed(frames)
    gateway.close()
    told = [e["fault"].split(".", 1)[1] for e in events if e["event"] == "dtc" and e["status"] & 1]
    return list(dict.fromkeys(told))


RUNS = 'active = "omega > 20"\nsettle_s = 3\n'


@pytest.mark.parametrize("causality", ["integral", pytest.param("mixed", marks=pytest.mark.full("1 s"))])
def test_the_motor(tmp_path, causality):
    """Of either causality; mixed: the checked equation has a derivative, which the filter (20) avoids."""
    config = configuration(tmp_path, f'{RUNS}causality = "{causality}"\nfilter_bandwidth = 2\n', nu=None)
    found = calibrated(config, *(motor_data.frames_of(motor_data.drive(60, seed=seed)) for seed in (11, 12)))
    monitor, params = monitor_of(load_config(config).monitor[0])
    kinds = {"integral": "SI", "mixed": "SD"}[causality]
    assert sum(f"({kinds})" in line for line in monitor.notes(params)) == 3
    assert set(params.nu) == set(params.thresholds) == {row.name for row in found.rows}
    assert not monitor.warnings(params)
    assert failed(config, motor_data.frames_of(motor_data.drive(40, seed=13))) == []
    for fault, size in (("f_R", 0.3), ("f_b", 0.5), ("f_i", 0.5), ("f_w", 5.0)):
        rows = motor_data.drive(30, seed=14, onset=10.0, **{fault: size})
        assert failed(config, motor_data.frames_of(rows)) == [fault]


def test_nu_is_that_of_the_residual_by_hand(tmp_path):
    """The static test: u - R i - k w of the decoded frames, once it runs and has settled."""
    config = configuration(tmp_path, RUNS + 'sample = "set"\n', nu=None)
    frames = motor_data.frames_of(motor_data.drive(30, seed=11))
    (row,) = (r for r in calibrated(config, frames).rows if r.name == "e1")
    samples = motor_data.decoded(frames)
    runs = samples[np.argmax(samples[:, 2] > 20) + 300 :]
    residual = np.abs(runs @ (1.0, -motor_data.R, -motor_data.K))
    assert row.samples == len(runs)
    assert row.nu == pytest.approx(typical(len(runs), residual.sum(), (residual**2).sum()), rel=1e-9)


def test_what_the_logs_do_not_show_stays_silent(tmp_path):
    """The motor stands still throughout: nothing to learn."""
    config = configuration(tmp_path, RUNS, nu=None)
    rows = np.zeros((300, 3))
    log = log_of(tmp_path / "still.log", motor_data.frames_of(rows))
    with pytest.raises(InputError, match='nothing that monitor "motor" tests'):
        learn(load_config(config), [log], Reading(config))


# Three tanks
# ----------------------------------------------------------------------------------------------------------------------

TANKS = """VERSION ""
NS_ :
BS_:
BU_: A
BO_ 256 LEVEL: 8 A
 SG_ y1 : 0|16@1- (0.0005,0) [-16|16] "m" A
 SG_ y2 : 16|16@1- (0.0005,0) [-16|16] "m3/s" A
 SG_ y3 : 32|16@1- (0.0005,0) [-16|16] "m3/s" A
"""
STEP, FINE = 0.05, 10


def tanks(folder, seconds, seed, *, onset=0.0, **faults):
    """Frames of the three tanks of models/three_tanks.toml, all of its parameters 1."""
    rng = np.random.default_rng(seed)
    message = cantools.database.load_file(folder / "tanks.dbc").messages[0]
    p = np.array([6.0, 4.0, 2.0])
    frames = empty(round(seconds / STEP))
    for n in range(len(frames)):
        t = n * STEP
        f = {key: value * (t >= onset) for key, value in faults.items()}
        inflow = 2.0 + 0.5 * np.sin(0.3 * t)
        for _ in range(FINE):
            q = np.array([p[0] - p[1] + f.get("fV1", 0), p[1] - p[2] + f.get("fV2", 0), p[2] + f.get("fV3", 0)])
            into = np.array([inflow, q[0], q[1]])
            p = p + STEP / FINE * (into - q + [f.get("fT1", 0), f.get("fT2", 0), f.get("fT3", 0)])
        y = np.array([p[0], p[1] - p[2] + f.get("fV2", 0), inflow]) + 0.005 * rng.normal(size=3)
        data = message.encode(dict(zip(("y1", "y2", "y3"), y, strict=True)), strict=False)
        put(frames, n, BEGIN + round(t * 1e9), message.frame_id, data, bus=0)
    return frames


@pytest.mark.parametrize(
    ("fault", "told"),
    [
        ("fV1", "fV1"), ("fV2", "fV2_or_fV3_or_fT3"),
        *(pytest.param(*case, marks=pytest.mark.full("1 s")) for case in (
            ("fT1", "fT1"), ("fT2", "fT2"), ("fV3", "fV2_or_fV3_or_fT3"), ("fT3", "fV2_or_fV3_or_fT3"),
        )),
    ],
)  # fmt: skip
def test_three_tanks(tmp_path, fault, told):
    """Three faults have names of their own, and three a group: as the toolbox's isolability matrix has it."""
    (tmp_path / "tanks.dbc").write_text(TANKS)
    config = tmp_path / "gateway.toml"
    config.write_text(
        '[clock]\nwatched = false\n[[bus]]\nname = "b"\nuri = "virtual:x"\ndatabase = ["tanks.dbc"]\n'
        f'health = {{ watched = false }}\n[memory]\npath = "{tmp_path}/faults.sqlite"\n'
        '[[monitor]]\nname = "tanks"\ntype = "structural"\nmodel = "three_tanks.toml"\nperiod_ms = 50\nsample = "set"\n'
        'settle_s = 20\nconfirm_s = 2\nsignals = { y1 = "LEVEL.y1", y2 = "LEVEL.y2", y3 = "LEVEL.y3" }\n'
    )
    calibrated(config, tanks(tmp_path, 120, 1), tanks(tmp_path, 120, 2))
    assert failed(config, tanks(tmp_path, 120, 3)) == []
    names = failed(config, tanks(tmp_path, 120, 4, onset=40.0, **{fault: 0.5}))
    assert names[-1] == told
    assert set(names) <= {told, "unisolated", "fV2_or_fV3_or_fT3"}
