"""What a user can get wrong with a structural monitor: one line each, with file, key, value and the nearest name."""

import pytest
from structural_config import configuration

from gateway.config.load import load_config
from gateway.config.monitor_types import monitor_of
from gateway.runtime.app import Gateway
from gateway_fdi.common.resources import shipped
from gateway_fdi.errors import InputError, InputErrors

MOTOR = shipped("models/motor.toml").read_text()


def refused(path):
    with pytest.raises((InputError, InputErrors)) as caught:
        Gateway(load_config(path), None, file=path)
    return str(caught.value)


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ('tests = ["T1"]', ["monitor[0].tests[0]", "'T1'", "the residuals of the model are none", "SET:EQUATION"]),
        ('tests = ["9:e1"]', ["monitor[0].tests[0]", "sets 1 to 4"]),
        ('tests = ["1:e1", "1:e1"]', ["monitor[0].tests[1]", "twice"]),
        ('tests = ["1:e4"]', ["monitor[0].model", "no test sees f_b", 'unseen = ["f_b"]', "the model could"]),
        ('unseen = ["f_r"]', ["monitor[0].unseen", "'f_r'", "did you mean f_R"]),
        ("parameters = { r = 1 }", ["monitor[0].parameters.r", "did you mean R"]),
        ("start = { omga = 1 }", ["monitor[0].start.omga", "did you mean omega"]),
        ("nu = { e2 = 1 }", ["monitor[0].nu.e2", "the tests are e1, e1_2, e5, e5_2"]),
        ("thresholds = { e1 = 0 }", ["monitor[0].thresholds.e1", "a number above 0"]),
        ('active = "omeg > 50"', ["monitor[0].active", "the names are u, i, w", "did you mean omega"]),
        ('active = "T > 1"', ["monitor[0].active", "the names are u, i, w, I, omega"]),
        ('active = "omega"', ["monitor[0].active", "true or false"]),
        ('active = "omega > u"', ["monitor[0].active", '"rad/s" and "V" do not go together']),
        ('active = "omega >"', ["monitor[0].active", "no expression"]),
        ('codes = { f_r = "P1A00" }', ["monitor[0].codes.f_r", "did you mean f_R"]),
        ('codes = { f_R = "P1" }', ["monitor[0].codes.f_R"]),
        ("max_age_ms = 0", ["monitor[0].max_age_ms"]),
        ("perod_ms = 5", ["monitor[0].perod_ms", "did you mean period_ms"]),
    ],
)
def test_keys(tmp_path, more, words):
    said = refused(configuration(tmp_path, more + "\n", nu=None))
    for word in (str(tmp_path / "gateway.toml") if "monitor[0]" in said else "", *words):
        assert word in said, said
    assert said.count("gateway.toml") <= 1


@pytest.mark.parametrize(
    ("signals", "words"),
    [
        ('u = "Drive.Voltage", i = "Sensors.Current"', ["signals.w", "need this known variable"]),
        ('u = "Drive.Voltage", i = "Sensors.Current", w = "Sensors.Sped"', ["signals", "w", "did you mean", "Speed"]),
        ('u = "Drive.Voltage", i = "Sensors.Speed", w = "Sensors.Speed"', ["signals.i", 'in "rad/s"', 'in "A"']),
        ('u = "Drive.Voltage", i = "Sensors.Current", w = "Sensors.Speed", x = "Drive.Voltage"', ["signals", "'x'"]),
    ],
)
def test_signals(tmp_path, signals, words):
    said = refused(configuration(tmp_path, signals=signals, nu=None))
    for word in words:
        assert word in said, said


def test_models(tmp_path):
    assert "did you mean motor.toml" in refused(configuration(tmp_path, model="moter.toml", nu=None))
    assert "a configuration, not a model" in refused(configuration(tmp_path, model="gateway.toml", nu=None))
    (tmp_path / "mine.toml").write_text(MOTOR.replace("k * omega", "k * omga"))
    said = refused(configuration(tmp_path, model="mine.toml", nu=None))
    assert f"{tmp_path}/mine.toml" in said
    assert '"omga" is no unknown' in said
    assert "did you mean omega" in said
    (tmp_path / "mine.toml").write_text(MOTOR.replace("k * omega", "sqr(k * omega)"))
    assert 'no function or table "sqr"; did you mean sqrt' in refused(
        configuration(tmp_path, model="mine.toml", nu=None)
    )


def test_what_stands_in_no_equation(tmp_path):
    """A fault there is refused, anything else is warned of."""
    idle = MOTOR.replace("[known]", "z = {}\n[known]\nv = {}", 1).replace(
        "[parameter]", "[parameter]\nq = { value = 1 }"
    )
    (tmp_path / "mine.toml").write_text(idle)
    path = configuration(tmp_path, model="mine.toml", nu=None)
    monitor, params = monitor_of(load_config(path).monitor[0])
    said = monitor.warnings(params)
    for words in ("unknown z of", "known v of", "parameter q of"):
        assert any(line.startswith(words) and "no equation" in line for line in said), said
    (tmp_path / "mine.toml").write_text(MOTOR.replace("[fault]", "[fault]\nf_x = {}"))
    assert "fault f_x of the model stands in no equation" in refused(path)


def test_thresholds_of_a_test_that_is_gone(tmp_path):
    said = refused(configuration(tmp_path, 'digests = { e1 = "00", e7 = "11" }\n'))
    assert "monitor[0].digests.e7" in said
    assert "gateway calibrate --write" in said


def without(*equations):
    """The motor's model without some equations."""
    parts = MOTOR.split("\n[equation.")
    return "\n[equation.".join(part for part in parts if part[:2] not in equations)


def test_no_redundancy(tmp_path):
    (tmp_path / "mine.toml").write_text(without("e4", "e5"))
    assert "no redundancy" in refused(configuration(tmp_path, model="mine.toml", nu=None))


#: The motor's case: nothing is measured behind its cooling.
CASE = """
[equation.e6]
text = "case"
relation = "theta = T_case * (1 + f_case) + I * R_case"
unique = ["theta"]
"""


def test_a_fault_that_nobody_sees_and_the_sensor_that_would(tmp_path):
    text = MOTOR.replace("[known]", 'theta = { unit = "K" }\n\n[known]', 1)
    text = text.replace("[parameter]", 'f_case = { text = "cooling" }\n\n[parameter]', 1)
    text = text.replace("[parameter]", "[parameter]\nT_case = { value = 1 }\nR_case = { value = 1 }", 1)
    (tmp_path / "mine.toml").write_text(text + CASE)
    said = refused(configuration(tmp_path, model="mine.toml", nu=None))
    assert "no test sees f_case: a sensor of theta would help" in said
    assert "--sensors theta" in said
    path = configuration(tmp_path, 'unseen = ["f_case"]\n', model="mine.toml", nu=None)
    gateway = Gateway(load_config(path), None, file=path)
    assert "motor.f_case" not in [d.id for d in gateway.catalogue]
    gateway.close()
