"""nu and thresholds are of one test: kept with its digest, and refused when model, choice or decision have changed."""

import motor_data
import pytest
from structural_config import NU, configuration, table

from gateway.bus.logs import open_writer
from gateway.config.load import load_config
from gateway.config.monitor_types import monitor_of
from gateway.monitors.contract import CusumCalibration
from gateway_fdi.common.resources import shipped
from gateway_fdi.errors import InputErrors
from gateway_fdi.jit import COMPILED
from gateway_fleet.cli.calibrate import calibrate_logs

MOTOR = shipped("models/motor.toml").read_text()


def digests_of(path):
    monitor, params = monitor_of(load_config(path).monitor[0])
    return monitor.capability(CusumCalibration).digests(params)


def kept(folder, more=""):
    """A configuration with the motor's model beside it, and the digests of its tests."""
    (folder / "mine.toml").write_text(MOTOR)
    digests = digests_of(configuration(folder, model="mine.toml"))
    assert set(digests) == set(NU)
    assert len(set(digests.values())) == len(NU)
    return configuration(
        folder, f"digests = {table({k: repr(v) for k, v in digests.items()})}\n{more}", model="mine.toml"
    )


def refused(path):
    with pytest.raises(InputErrors) as caught:
        load_config(path)
    return [(error.file, error.key, error.value, error.message) for error in caught.value.errors]


def warnings_of(path):
    monitor, params = monitor_of(load_config(path).monitor[0])
    return [line for line in monitor.warnings(params) if "digests" in line]


def test_the_same_tests(tmp_path):
    assert warnings_of(kept(tmp_path)) == []
    (tmp_path / "mine.toml").write_text(MOTOR.replace("value = 0.5", "value = 0.52").replace(" * I ", "*I "))
    assert warnings_of(tmp_path / "gateway.toml") == []  # a parameter's value, a blank: the same tests


@pytest.mark.parametrize(
    ("old", "new", "keys"),
    [
        ("b * (1 + f_b) * omega", "b * (1 + f_b) * omega * abs(omega)", ["e1_2", "e5", "e5_2"]),  # the friction
        ("u = R * (1 + f_R) * I + k * omega", "u = 2 * R * (1 + f_R) * I + k * omega", ["e1", "e1_2", "e5"]),
    ],
)
def test_another_model(tmp_path, old, new, keys):
    path = kept(tmp_path)
    before = load_config(path).monitor[0].model_extra["digests"]
    assert old in MOTOR
    (tmp_path / "mine.toml").write_text(MOTOR.replace(old, new))
    found = refused(path)
    assert [key for _, key, _, _ in found] == [f"monitor[0].digests.{name}" for name in keys], "all, at once"
    for (file, _, value, message), name in zip(found, keys, strict=True):
        assert file == str(path)
        assert value == before[name]
        assert "another test of this name" in message
        assert "gateway calibrate" in message


def test_another_decision(tmp_path):
    found = refused(kept(tmp_path, 'decision = "jump"\n'))
    assert {key for _, key, _, _ in found} == {f"monitor[0].digests.{name}" for name in NU}


def test_a_digest_of_no_test(tmp_path):
    ((_, key, _, message),) = refused(configuration(tmp_path, 'digests = { e9 = "00" }\n'))
    assert key == "monitor[0].digests.e9"
    assert "the tests are e1, e1_2, e5, e5_2" in message


def test_older_files_have_one_line_of_warning(tmp_path):
    (line,) = warnings_of(configuration(tmp_path))
    assert "e1, e1_2, e5, e5_2" in line


@pytest.mark.long
@pytest.mark.skipif(not COMPILED, reason="thousands of samples")
def test_calibrate_writes_them_and_begins_anew_where_they_do_not_fit(tmp_path, capsys):
    path = kept(tmp_path, 'active = "omega > 20"\n')
    was = digests_of(path)
    (tmp_path / "mine.toml").write_text(MOTOR.replace("k * omega", "1.0001 * k * omega"))
    assert {key for _, key, _, _ in refused(path)} <= {f"monitor[0].digests.{name}" for name in NU}
    log = tmp_path / "healthy.log"
    writer = open_writer(log)
    writer.write(motor_data.frames_of(motor_data.drive(20, seed=3)))
    writer.close()
    code = calibrate_logs(
        path, [str(log)], mtfa=3600.0, margin=0.5, floor=25.0, write=True,
        parts=None, scheduler=None, workers=None, json=True,
    )  # fmt: skip
    assert code == 0
    monitor, params = monitor_of(load_config(path).monitor[0])
    assert params.digests == digests_of(path) != was
    assert set(params.nu) == set(params.thresholds) == set(params.digests)
    assert not monitor.warnings(params)
