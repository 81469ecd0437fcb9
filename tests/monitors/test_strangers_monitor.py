"""A stranger's monitor whose step fails is switched off, told with its file, and nothing else stops."""

import json
import logging
import subprocess
import sys

import pytest
from nested_pytest import PYTEST

from gateway.bus.frames import empty, put
from gateway.config.load import load_config
from gateway.faults.hung_monitors import hung_beside
from gateway.runtime.app import Gateway
from gateway_commands.check import check
from gateway_commands.new_monitor import new_monitor
from gateway_fdi.common.resources import shipped

RAISES = '    if u.volts > 20.0:\n        raise ValueError("too much")\n'
CONFIG = """
[[bus]]
name = "can"
uri = "socketcan:can0"
database = ["battery.dbc"]

[[monitor]]
name = "battery"
type = "{module}:MONITOR"

[[monitor]]
name = "other"
type = "battery_voltage"

[fault."other.low"]
dtc = "P1000-16"
[fault."other.high"]
dtc = "P1000-17"

[memory]
path = "{memory}"
"""


def monitor(folder, module, slip="", **replaced):
    """Write the example's monitor under another name, with a slip at the beginning of its step."""
    example = shipped("examples/battery_voltage")
    text = (example / "battery_voltage.py").read_text()
    text = text.replace('"battery_voltage"', f'"{module}"')
    text = text.replace("    s.lowest = min(s.lowest, u.volts)\n", f"{slip}    s.lowest = min(s.lowest, u.volts)\n")
    for old, new in replaced.items():
        assert old in text
        text = text.replace(old, new)
    (folder / f"{module}.py").write_text(text)
    (folder / "battery.dbc").write_text((example / "battery.dbc").read_text())
    config = CONFIG.format(module=module, memory=folder / "faults.sqlite")
    good = f"{module}_good"
    (folder / f"{good}.py").write_text((example / "battery_voltage.py").read_text())
    (folder / "gateway.toml").write_text(config.replace('"battery_voltage"', f'"{good}:MONITOR"'))
    return folder / "gateway.toml"


@pytest.fixture
def gateway_of(tmp_path):
    made = []

    def make(path):
        while made:
            made.pop().close()
        gateway = Gateway(load_config(path), tmp_path / "faults.sqlite", file=path)
        made.append(gateway)
        gateway.told = []
        gateway.listen(gateway.told.append)
        gateway.start(0)
        return gateway

    yield make
    for gateway in made:
        gateway.close()
    sys.path[:] = [place for place in sys.path if not place.startswith(str(tmp_path))]


def feed(gateway, *volts):
    message = gateway.databases[0].message("BATT")
    start_ns = gateway.engine.now_ns
    frames = empty(len(volts))
    for k, value in enumerate(volts):
        put(frames, k, start_ns + (k + 1) * 100_000_000, message.frame_id, message.encode({"Voltage": value}))
    gateway.feed(frames)


def dtcs(gateway):
    return [(e["dtc"], bool(e["status"] & 1)) for e in gateway.told if e["event"] == "dtc"]


def off(gateway):
    return [event for event in gateway.told if event["event"] == "monitor_off"]


@pytest.mark.evidence("Nothing is silent: monitor")
def test_a_step_that_raises_is_told_with_its_file_and_sets_a_code_of_our_own(tmp_path, gateway_of, caplog):
    path = monitor(tmp_path, "slip_raises", RAISES)
    gateway = gateway_of(path)
    with caplog.at_level(logging.ERROR):
        feed(gateway, 12.6, 25.0, *[10.5] * 6)
    (event,) = off(gateway)
    assert (event["monitor"], event["type"], event["bus"]) == ("battery", "slip_raises", "can")
    assert event["file"] == str(tmp_path / "slip_raises.py")
    assert "ValueError: too much" in event["reason"]
    assert event["t_ns"] == 200_000_000
    assert sorted(dtcs(gateway)) == [("P1000-16", True), ("U3000-48", True)], "the healthy one goes on"
    assert gateway.memory.entry("gateway.monitor_off").record.evidence["monitors switched off"] == 1.0
    gateway.controls.clear(0xFFFFFF)
    feed(gateway, 12.6)
    assert ("U3000-48", True) in dtcs(gateway)[2:], "it is still off"


def test_without_slips_the_code_is_tested_and_good(tmp_path, gateway_of):
    gateway = gateway_of(monitor(tmp_path, "slip_none"))
    feed(gateway, 12.6)
    assert int(gateway.memory.status("gateway.monitor_off")) == 0
    assert off(gateway) == []


def test_who_did_not_return_stays_off_until_its_kernel_changes(tmp_path, gateway_of):
    path = monitor(tmp_path, "slip_hung")
    gateway = gateway_of(path)
    (battery,) = [m for m in gateway.engine.monitors if m.name == "battery"]
    hung_beside(tmp_path / "faults.sqlite").add("battery", battery.monitor.digest, "its step did not return")
    again = gateway_of(path)
    feed(again, *[10.5] * 6)
    (event,) = off(again)
    assert "its step did not return" in event["reason"]
    assert "faults.sqlite.hung.json" in event["reason"]
    assert sorted(dtcs(again)) == [("P1000-16", True), ("U3000-48", True)]
    file = tmp_path / "faults.sqlite.hung.json"
    kept = json.loads(file.read_text())
    kept["monitors"]["battery"]["digest"] = "of another kernel"
    file.write_text(json.dumps(kept))
    changed = gateway_of(path)
    feed(changed, *[10.5] * 6)
    assert off(changed) == []
    assert ("P0562-16", True) in dtcs(changed)


@pytest.mark.parametrize("text", ["", "[]", '{"monitors": 3}', '{"monitors": {"battery": 3}}', "\x00\xff"])
def test_a_damaged_file_keeps_nobody_off(tmp_path, gateway_of, text):
    path = monitor(tmp_path, "slip_damaged")
    (tmp_path / "faults.sqlite.hung.json").write_bytes(text.encode("latin1"))
    assert off(gateway_of(path)) == []


@pytest.mark.parametrize(
    ("author", "told"), [("", ["its author does not say Monitor(..., trusted=True)"]), ("True", [])]
)
def test_check_says_where_trusted_has_no_effect(tmp_path, capsys, author, told):
    module = f"trusted_by_author_{bool(author)}".lower()
    path = monitor(tmp_path, module, **({"    api=2,": "    api=2,\n    trusted=True,"} if author else {}))
    path.write_text(path.read_text().replace(f'"{module}:MONITOR"', f'"{module}:MONITOR"\ntrusted = true'))
    assert check(path, schema_wanted=False, json=True) == 0
    said = [text for text in json.loads(capsys.readouterr().out)["warnings"] if "trusted" in text]
    assert [text.startswith("battery: trusted = true has no effect") for text in said] == [True] * len(told)
    assert all(part in text for part, text in zip(told, said, strict=True))


def test_a_prepare_that_fails_the_second_time_is_the_author_s_mistake(tmp_path, capsys):
    slip = '    RUNS.append(1)\n    if len(RUNS) > 2:\n        raise ValueError("once too often")\n'
    prepare = "    c.low, c.high, c.hysteresis = p.low, p.high, p.hysteresis\n"
    path = monitor(tmp_path, "fails_later", **{"LOW, HIGH =": "RUNS = []\nLOW, HIGH =", prepare: prepare + slip})
    assert check(path, schema_wanted=False, json=True) == 2
    (told,) = json.loads(capsys.readouterr().out)["errors"]
    assert told["key"].endswith(".prepare")
    assert told["message"] == "fails: ValueError: once too often"


def test_the_example_is_good(tmp_path):
    assert check(monitor(tmp_path, "no_slip"), schema_wanted=False, json=True) == 0


@pytest.mark.long
def test_the_template_s_own_tests_pass_without_a_warning_and_fail_with_a_slip(tmp_path):
    assert new_monitor("coolant", tmp_path / "coolant") == 0
    folder = tmp_path / "coolant"
    command = [*PYTEST, "-q", "-W", "error", "-p", "no:xdist"]

    def run(*more):
        return subprocess.run([*command, *more], cwd=folder, capture_output=True, text=True, timeout=600, check=False)

    good = run()
    assert good.returncode == 0, good.stdout
    assert "7 passed" in good.stdout
    file = folder / "coolant.py"
    step = "    s.lowest = min(s.lowest, u.volts)\n"
    file.write_text(file.read_text().replace(step, f"{step}    report(out, int(u.volts), True, 1.0, 2.0)\n"))
    bad = run("-k", "missing")
    assert bad.returncode == 1, bad.stdout
    assert "it reports fault number" in bad.stdout
