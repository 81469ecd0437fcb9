"""A stranger's packages: found by entry point or by place, from folders of their own, with the installed
gateway only.
"""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import warm
from nested_pytest import PYTEST

from gateway_fdi.common.resources import shipped

#: Monitors of one's own, with a scenario beside; the project examples/bench: tests/pytest_plugin/test_example.py.
EXAMPLES = sorted(
    path.parent for path in shipped("examples").glob("*/gateway.toml") if len(list(path.parent.glob("*.toml"))) == 2
)
#: Those with tests of their own.
TESTED = [
    pytest.param(path.parent.name, marks=pytest.mark.full("half a minute, and 6 s"))
    if path.parent.name in ("steering_gear", "pedal_khr")
    else path.parent.name
    for path in sorted(shipped("examples").glob("*/test_*.py"))
]
GATEWAY = [str(Path(sys.executable).parent / "gateway")]
COMMAND = [sys.executable, "-c", "import sys; from gateway.cli import main; sys.argv[0]='gateway'; sys.exit(main())"]


def run(*arguments, cwd, path=None, **environment):
    """Run the gateway as a stranger does; returns what ended."""
    kept = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "COVERAGE_PROCESS_START")}
    if path is not None:
        kept["PYTHONPATH"] = str(path)
    return warm.run(
        [*COMMAND, *map(str, arguments)], cwd=cwd, capture_output=True, text=True, timeout=600, check=False,
        env={**kept, "COLUMNS": "200", **environment},
    )  # fmt: skip


def copy(example, place):
    """Copy an example to a folder that knows nothing of ours."""
    ignored = shutil.ignore_patterns("__pycache__", "*.sqlite*")
    return Path(shutil.copytree(shipped("examples") / example, place / example, ignore=ignored))


def package(place, name, points, **modules):
    """Make an installed package with entry points; returns the folder for PYTHONPATH."""
    site = place / "site"
    info = site / f"{name}-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(points)
    for module, text in modules.items():
        (site / f"{module}.py").write_text(text)
    return site


def battery():
    return (shipped("examples") / "battery_voltage/battery_voltage.py").read_text()


@pytest.mark.long
@pytest.mark.parametrize("example", [path.name for path in EXAMPLES])
def test_each_example_is_checked_and_demonstrated_in_a_folder_of_its_own(tmp_path, example):
    folder = copy(example, tmp_path)
    made = run("check", "gateway.toml", cwd=folder)
    assert made.returncode == 0, made.stderr
    (scenario,) = [p for p in folder.glob("*.toml") if p.name != "gateway.toml"]
    made = run("demo", scenario.name, "--speed", "0", cwd=folder)
    assert made.returncode == 0, made.stdout + made.stderr
    assert "NOT as expected" not in made.stdout


@pytest.mark.long
@pytest.mark.parametrize("example", TESTED)
def test_each_example_s_own_tests_pass(tmp_path, example):
    folder = copy(example, tmp_path)
    made = subprocess.run(
        [*PYTEST, "-q", "-p", "no:xdist"],
        cwd=folder, capture_output=True, text=True, timeout=600, check=False,
    )  # fmt: skip
    assert made.returncode == 0, made.stdout
    assert " passed" in made.stdout


@pytest.mark.long
@pytest.mark.parametrize("plain", [[], ["--plain"]])
def test_a_new_monitor_runs_as_it_is(tmp_path, plain):
    made = run("new-monitor", "coolant", *plain, cwd=tmp_path)
    assert made.returncode == 0, made.stderr
    folder = tmp_path / "coolant"
    assert {p.name for p in folder.iterdir()} >= {
        "coolant.py", "coolant_ecu.py", "gateway.toml", "test_coolant.py", "README.md", "battery.dbc",
    }  # fmt: skip
    for path in folder.iterdir():
        assert "battery_voltage" not in path.read_text(), path
    assert ("@kernel" in (folder / "coolant.py").read_text()) is not bool(plain)
    made = run("demo", "drained.toml", "--speed", "0", cwd=folder)
    assert made.returncode == 0, made.stdout + made.stderr
    assert "as expected: P0562-16 set" in made.stdout
    again = run("new-monitor", "coolant", cwd=tmp_path)
    assert again.returncode == 2
    assert "there already" in again.stderr


@pytest.mark.parametrize("name", ["3x", "class", "With-Dash", "json", "numpy"])
def test_a_name_that_is_no_module_s_or_taken_is_refused(tmp_path, name):
    made = run("new-monitor", name, cwd=tmp_path)
    assert made.returncode == 2
    assert made.stderr.count("\n") == 1
    assert not list(tmp_path.iterdir())


@pytest.mark.long
def test_an_entry_point_of_another_package_is_a_type_like_ours(tmp_path):
    folder = copy("battery_voltage", tmp_path)
    points = "[gateway.monitors]\nmy_battery = battery_of_mine:MONITOR\n"
    site = package(tmp_path, "mine", points, battery_of_mine=battery())
    (folder / "battery_voltage.py").unlink()
    text = (folder / "gateway.toml").read_text().replace("battery_voltage:MONITOR", "my_battery")
    (folder / "gateway.toml").write_text(text)
    made = run("demo", "drained.toml", "--speed", "0", cwd=folder, path=site)
    assert made.returncode == 0, made.stdout + made.stderr
    schema = json.loads(run("check", "--schema", cwd=folder, path=site).stdout)
    types = [case["properties"]["type"].get("const") for case in schema["$defs"]["MonitorConfig"]["anyOf"]]
    assert "my_battery" in types
    assert "crank_sync" in types
    known = json.loads(run("doctor", "--json", cwd=folder, path=site).stdout)["plugins"]
    assert {door: names for door, names in known.items() if names} == {"monitor": {"my_battery": ""}}


BROKEN = {
    "does not import": ("1 / 0", "cannot be imported: ZeroDivisionError"),
    "is not there": ("MONITORS = 1", "has no MONITOR"),
    "is no monitor": ("MONITOR = 1", "this is no Monitor, but int"),
    "is of another version": (None, "written for version 1 of the contract, this gateway has 2"),
}


@pytest.mark.long
def test_broken_ones_are_one_clear_line_each_and_the_rest_runs(tmp_path):
    folder = copy("battery_voltage", tmp_path)
    names = {case: f"my_battery_{k}" for k, case in enumerate(BROKEN)}
    modules = {
        f"battery_of_mine_{k}": battery().replace("api=2", "api=1") if text is None else text
        for k, (text, _) in enumerate(BROKEN.values())
    }
    points = "".join(f"{name} = {module}:MONITOR\n" for name, module in zip(names.values(), modules, strict=True))
    site = package(tmp_path, "mine", f"[gateway.monitors]\n{points}", **modules)
    made = run("demo", "drained.toml", "--speed", "0", cwd=folder, path=site)
    assert made.returncode == 0, "a configuration that does not name it runs"
    doctor = run("doctor", cwd=folder, path=site).stdout.splitlines()
    assert run("check", "--schema", cwd=folder, path=site).returncode == 0
    config = (folder / "gateway.toml").read_text()
    for case, (_, told) in BROKEN.items():
        name = names[case]
        (line,) = [line for line in doctor if name in line]
        assert told in line, case
        (folder / "gateway.toml").write_text(config.replace("battery_voltage:MONITOR", name))
        made = run("check", "gateway.toml", cwd=folder, path=site)
        assert made.returncode == 2
        assert told in made.stderr, case
        assert f"monitor[0].type = '{name}'" in made.stderr
        assert made.stderr.count("\n") == 1


def test_a_type_of_ours_cannot_be_taken_and_of_two_strangers_none_wins(tmp_path):
    folder = copy("battery_voltage", tmp_path)
    points = "[gateway.monitors]\ncrank_sync = battery_of_mine:MONITOR\nboth = battery_of_mine:MONITOR\n"
    package(tmp_path, "mine", points, battery_of_mine=battery())
    site = package(tmp_path, "theirs", "[gateway.monitors]\nboth = other:MONITOR\n", other=battery())
    told = "from gateway.monitors.registry import MONITORS; print(MONITORS['crank_sync'].type); MONITORS['both']"
    made = subprocess.run(
        [sys.executable, "-c", told], cwd=folder, env={**os.environ, "PYTHONPATH": str(site)},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert made.stdout == "crank_sync\n"
    assert "several installed packages have this type: battery_of_mine:MONITOR, other:MONITOR" in made.stderr


@pytest.mark.full("3 s")
def test_a_misspelt_field_is_named_compiled_or_not(tmp_path):
    """The compiler refuses it before the start; in plain Python the first step fails: the monitor is switched off."""
    folder = copy("battery_voltage", tmp_path)
    module = folder / "battery_voltage.py"
    module.write_text(module.read_text().replace("s.lowest = min(", "s.lowets = min("))
    refused = run("demo", "drained.toml", "--speed", "0", cwd=folder, NUMBA_DISABLE_JIT="0")
    assert refused.returncode == 2, refused.stdout + refused.stderr
    assert "lowets" in refused.stderr
    assert "battery_voltage.py" in refused.stderr
    plain = run("demo", "drained.toml", "--speed", "0", "--json", cwd=folder, NUMBA_DISABLE_JIT="1")
    (off,) = [e for e in map(json.loads, plain.stdout.splitlines()) if e["event"] == "monitor_off"]
    assert "lowets" in off["reason"]
    assert "battery_voltage.py" in off["file"]
    for ended in (refused, plain):
        assert "Traceback" not in ended.stderr


@pytest.mark.full("3 s")
def test_each_step_can_be_traced(tmp_path):
    folder = copy("battery_voltage", tmp_path)
    log = tmp_path / "a.log"
    volts = [12.6] * 5 + [10.5] * 6
    lines = [
        f"({1000 + k / 10:.6f}) vcan0 510#{round(1000 * v).to_bytes(2, 'little').hex()}000000000000"
        for k, v in enumerate(volts)
    ]
    log.write_text("\n".join(lines) + "\n")
    made = run("replay", log, "--only", "battery", "--trace", "--json", cwd=folder)
    assert made.returncode == 0, made.stderr
    steps = [e for e in map(json.loads, made.stdout.splitlines()) if e["event"] == "step"]
    assert [s["inputs"]["volts"] for s in steps] == pytest.approx(volts)
    assert [s["step"] for s in steps] == list(range(1, 12))
    assert [s["results"][0]["result"] for s in steps] == ["passed"] * 5 + ["failed"] * 6
    assert steps[-1]["state"] == {"lowest": 10.5}
    assert steps[-1]["results"][0]["evidence"]["terminal voltage [V]"] == 10.5
    shown = run("replay", log, "--only", "battery", "--trace", cwd=folder).stdout
    assert "low failed: 10.5 against 11" in shown
    assert max(map(len, shown.splitlines())) <= 120
    wrong = run("replay", log, "--only", "batery", cwd=folder)
    assert wrong.returncode == 2
    assert "did you mean battery?" in wrong.stderr


def installed(example, place):
    """Install an example as pip does; returns the folder for PYTHONPATH."""
    site = place / "site"
    folder = shutil.copytree(shipped("examples") / example, place / example)
    pip = [sys.executable, "-m", "pip", "install", "-q", "--no-deps", "--no-build-isolation", "--no-index"]
    made = subprocess.run(
        [*pip, "--target", site, folder],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert made.returncode == 0, made.stderr
    return site


@pytest.mark.long
def test_a_package_brings_a_command_a_log_format_a_checksum_and_a_key_function(tmp_path):
    site = installed("workshop", tmp_path)
    assert "workshop" in run("--help", cwd=tmp_path, path=site).stdout
    log = tmp_path / "a.bench"
    log.write_text("1500 can0 1A0 0011\n2500 can1 1A0 2233\nwhat is this\n3500 can0 1A1 44\n")
    counted = run("workshop", log, cwd=tmp_path, path=site)
    assert counted.stdout == "1A0  2\n1A1  1\n", counted.stderr
    made = run("convert", "log", log, tmp_path / "a.log", cwd=tmp_path, path=site)
    assert made.returncode == 2, made.stderr
    assert "line 3: what is this': damaged, passed over: 1 x" in made.stderr
    assert [line.split()[1:] for line in (tmp_path / "a.log").read_text().splitlines()] == [
        ["can0", "1A0#0011"], ["can1", "1A0#2233"], ["can0", "1A1#44"],
    ]  # fmt: skip
    told = json.loads(run("doctor", "--json", cwd=tmp_path, path=site).stdout)["plugins"]
    assert {door: list(names) for door, names in told.items() if names} == {
        "command": ["workshop"], "reader": [".bench"], "protection": ["workshop"], "key": ["workshop"],
        "server": ["workshop"],
    }  # fmt: skip
    code = (
        "from gateway.signals.protection.rules import Frame, rule_of;"
        "from gateway.servers.uds.security import key_function;"
        "print(rule_of('workshop')(Frame(0x1A0, False, 8)).plus, key_function('workshop')(b'ab', b'k', 1).hex())"
    )
    made = subprocess.run(
        [sys.executable, "-c", code], env={**os.environ, "PYTHONPATH": str(site)}, capture_output=True, text=True,
        check=False,
    )  # fmt: skip
    assert made.stdout == f"{0x01 + 0xA0} {bytes([97 ^ 107 ^ 1, 98 ^ 107 ^ 1]).hex()}\n", made.stderr


@pytest.mark.full("4 s")
def test_a_plant_that_is_installed_is_named_in_any_folder(tmp_path):
    site, place = installed("motor_load", tmp_path), tmp_path / "car"
    place.mkdir()
    for name in ("gateway.toml", "jam.toml", "motor.dbc"):
        text = (tmp_path / "motor_load" / name).read_text()
        text = text.replace('"motor_load:MONITOR"', '"motor_load"').replace('"motor_ecu:ECU"', '"motor"')
        (place / name).write_text(text)
    assert "motor_load.py" not in {path.name for path in place.iterdir()}
    made = run("demo", "jam.toml", "--speed", "0", cwd=place, path=site)
    assert made.returncode == 0, made.stdout + made.stderr
    assert "NOT as expected" not in made.stdout
    told = json.loads(run("doctor", "--json", cwd=place, path=site).stdout)["plugins"]
    assert {door: list(names) for door, names in told.items() if names} == {"monitor": ["motor_load"], "ecu": ["motor"]}


BAD_PLUGINS = {
    "does not import": ("1 / 0", "cannot be imported: ZeroDivisionError"),
    "is none": ("PLUGIN = 1", "no Plugin, but int"),
    "is of another version": ("from gateway.plugin import Plugin\nPLUGIN = Plugin(api=99)", "written for version 99"),
}


@pytest.mark.parametrize("case", BAD_PLUGINS)
def test_a_plug_in_that_cannot_be_used_is_one_line_of_the_doctor_and_concerns_nobody_else(tmp_path, case):
    text, told = BAD_PLUGINS[case]
    site = package(tmp_path, "mine", "[gateway.plugins]\nmine = mine_plugin:PLUGIN\n", mine_plugin=text)
    made = run("doctor", cwd=tmp_path, path=site)
    assert made.returncode == 0
    (line,) = [line for line in made.stdout.splitlines() if "plug-in mine" in line]
    assert told in line
    assert run("--help", cwd=tmp_path, path=site).returncode == 0
