"""Slips of those who write a filter: each is one line that names it, and the daemon lives."""

import pytest

from gateway.config.load import load_config
from gateway.monitors.plain import calls
from gateway.runtime.app import Gateway
from gateway.runtime.assemble import prepare
from gateway_fdi.errors import GatewayError
from tests.monitors.test_filter import EKF, IMM, UKF, car, drive, speeds

__all__ = ["car"]


def kf(line):
    """Return a linear filter's make() with one more line."""
    return f"def make():\n    kf = linear()\n    {line}\n    return kf"


#: A file's text, keys -> what the error says.
SLIPS = [
    ("kf = linear()", {}, "has no make"),
    ("make = 3", {}, "a function that returns a filter, not int"),
    ("def make(x):\n    return linear()", {}, "missing 1 required positional argument: 'x'"),
    ("def make():\n    pass", {}, "NoneType is not taken"),
    ("def make():\n    return 1 / 0", {}, "ZeroDivisionError"),
    ("def make():\n    import nowhere", {}, "nowhere"),
    ("def make():\n    raise SystemExit", {}, "SystemExit"),
    ("def make():\n    while True:\n        pass", {}, "takes longer than"),
    ("def make(:\n    pass", {}, "SyntaxError"),
    ("def make():\n    return FixedLagSmoother(2, 1, N=3)", {}, "FixedLagSmoother is not taken: it says what was"),
    ("def make():\n    return SquareRootKalmanFilter(2, 1)", {}, "SquareRootKalmanFilter is not taken"),
    ("def make():\n    return [linear()]", {}, "list is not taken"),
    ("def make():\n    return linear(), {'Hx': len}", {}, "make returns (filter"),
    (kf("kf.F = np.eye(3)"), {}, "F has the shape (3, 3), not (2, 2)"),
    (kf("kf.F = [[1, 0.01]]"), {}, "F has the shape (1, 2)"),
    (kf("kf.F = 'unit'"), {}, "F is no matrix of numbers"),
    (kf("kf.F = None"), {}, "F has the shape ()"),
    (kf("kf.F[0, 1] = np.nan"), {}, "F has a value that is no number: nan"),
    (kf("kf.H = np.eye(2)"), {}, "H has the shape (2, 2), not (1, 2)"),
    (kf("kf.H = kf.H * np.inf"), {}, "H has a value that is no number"),
    (kf("kf.x = np.zeros(3)"), {}, "x has the shape (3,), and dim_x is 2"),
    (kf("kf.x[0] = np.nan"), {}, "x has a value that is no number"),
    (kf("kf.Q = np.array([[1.0, 0.5], [0.0, 1.0]])"), {}, "Q is not symmetric"),
    (kf("kf.Q = np.diag([1.0, -1.0])"), {}, "Q is not positive: an eigenvalue is -1"),
    (kf("kf.Q = 0.1"), {}, "Q has the shape (), not (2, 2)"),
    (kf("kf.P = np.array([[1.0, 2.0], [2.0, 1.0]])"), {}, "P is not positive: an eigenvalue is -1"),
    (kf("kf.P[0, 1] = 3.0"), {}, "P is not symmetric"),
    (kf("kf.P *= np.nan"), {}, "P has a value that is no number"),
    (kf("kf.R = np.array([[-0.1]])"), {}, "R is not positive"),
    (kf("kf.R = np.eye(2)"), {}, "R has the shape (2, 2), not (1, 1)"),
    (kf("kf.R *= 0; kf.P *= 0; kf.Q *= 0"), {}, "S = H P H' + R is not positive definite"),
    (kf("kf.B = None"), {}, "the filter has no B"),
    (kf("kf.B = np.eye(2)"), {}, "B of the filter takes 2 inputs"),
    (kf("kf.B = np.ones((3, 1))"), {}, "B has the shape (3, 1), not (2, 1)"),
    ("make = linear", {"u": None}, "B of the filter takes 1 inputs"),
    ("make = linear", {"z": ["CAR.Speed", "CAR.Way"]}, "dim_z of the filter is 1"),
    ("make = linear", {"z": []}, "z"),
    ("make = linear", {"z": ["CAR.Sped"]}, "did you mean Speed"),
    ("make = linear", {"z": ["CRA.Speed"]}, "CRA"),
    ("make = linear", {"z": ["Speed"]}, "Message.Signal"),
    ("make = linear", {"z": ["CAR.Speed [km/h]"]}, "km/h"),
    ("make = linear", {"u": ["CAR.Force [N]"]}, "kN"),
    ("make = linear", {"u": ["CAR.Speed"]}, "there twice"),
    ("make = linear", {"period_ms": None}, "period_ms"),
    ("make = linear", {"period_ms": 0}, "period_ms"),
    ("make = linear", {"false_per_hour": 0}, "false_per_hour"),
    ("make = linear", {"false_per_hour": 1e-9}, "1e-11 to 0.1"),
    ("make = linear", {"window": 65}, "window"),
    ("make = linear", {"tests": ["niss"]}, "nis"),
    ("make = linear", {"codes.nid": "P0500"}, "did you mean nis"),
    ("make = linear", {"modes": ["a", "b"]}, "an IMMEstimator has modes"),
    ("make = linear", {"filter": "mine"}, "module:make"),
    ("make = linear", {"filter": "nowhere_at_all:make"}, "nowhere_at_all"),
    (EKF.replace("return kf, {", "return kf, {'Hy': 1, "), {}, "make returns (filter"),
    (EKF.replace('"Hx": hx', '"Hx": 3'), {}, "Hx is a function of x, not int"),
    (EKF.replace('return kf, {"HJacobian": jacobian, "Hx": hx}', "return kf"), {}, "make returns (filter"),
    (EKF.replace("x[0] ** 2", "x[7] ** 2"), {}, "IndexError"),
    (EKF, {"continuous": True}, "continuous"),
    (UKF.replace("0.01, hx", "0.1, hx"), {}, "dt of the filter is 0.1 s"),
    (UKF.replace("np.sin(x[0])", "np.sine(x[0])"), {}, "no attribute 'sine'"),
    (UKF.replace("def fx(x, dt, u)", "def fx(x, dt)"), {}, "unexpected keyword argument 'u'"),
    (UKF.replace("kf.P *= 0.2", "kf.P *= -1"), {}, "P is not positive"),
    (IMM, {"u": None}, "a name of its own for each of the 2 filters"),
    (IMM, {"u": None, "modes": ["a", "a"]}, "a name of its own"),
    (IMM, {"u": None, "modes": ["a", "b"], "tests": ["nis"]}, "tested by its modes"),
    (IMM.replace("[0.03, 0.97]", "[0.03, 0.9]"), {"u": None, "modes": ["a", "b"]}, "add up to 1"),
]  # fmt: skip


@pytest.mark.parametrize(("text", "keys", "told"), SLIPS)
def test_a_slip_is_one_error_with_its_key(text, keys, told, car, monkeypatch):
    monkeypatch.setattr(calls, "LIMIT_S", 0.3)
    path = car(text, **keys)
    with pytest.raises(GatewayError) as error:
        prepare(load_config(path), path)
    assert told in str(error.value)
    assert len(str(error.value).splitlines()) <= 2


#: What an hx does after a while -> the reason for which its monitor is switched off.
WHILE_IT_RUNS = [
    ("1 / 0", "ZeroDivisionError: division by zero"),
    ("[][1]", "IndexError: list index out of range"),
    ("undefined", "NameError: name 'undefined' is not defined"),
    ("np.zeros(3)", "ValueError"),
    ("__import__('sys').exit(3)", "SystemExit"),
    ("all(True for _ in iter(int, 1))", "takes longer than"),
]


@pytest.mark.parametrize(("code", "reason"), WHILE_IT_RUNS)
def test_what_fails_later_switches_its_monitor_off(code, reason, car, monkeypatch):
    monkeypatch.setattr(calls, "LIMIT_S", 0.3)
    text = UKF.replace("return np.array([np.sin(x[0])])", f"return np.array([np.sin(x[0])]) if few() else {code}")
    path = car("calls = []\ndef few():\n    calls.append(1)\n    return len(calls) < 100\n" + text)
    gateway = Gateway(load_config(path), file=path)
    events = []
    gateway.listen(events.append)
    gateway.start(0)
    gateway.feed(drive(speeds(100)))
    gateway.close()
    (off,) = [event for event in events if event["event"] == "monitor_off"]
    assert reason in off["reason"]
    assert off["monitor"] == "mine"
    assert off["file"].startswith(str(path.parent))
    if "longer" not in reason and "ValueError" not in reason:
        assert ".py:" in off["reason"], "its line"
