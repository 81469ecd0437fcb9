"""What a command does not use it does not import; what is not installed is named, with the way to get it."""

import json
import os
import pkgutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
import structlog

import gateway
import gateway_api
import gateway_ask
import gateway_bench
import gateway_calibration
import gateway_causes
import gateway_checks
import gateway_commands
import gateway_fdi
import gateway_fleet
import gateway_logs
import gateway_plants
import gateway_replay
import gateway_serve
import gateway_testers
from gateway.bus.logs import LogReader, open_writer
from gateway.common import extras
from gateway.common.extras import EXTRAS, PURPOSES
from gateway.faults.catalogue import Catalogue
from gateway.faults.memory import FaultMemory
from gateway.faults.store import Store
from gateway.monitors.registry import MONITORS
from gateway_commands.doctor import doctor
from gateway_fdi.common import log
from gateway_fdi.errors import InputError
from gateway_plants.structural.analysis.command import structure

ROOT = Path(__file__).parents[2]

#: Modules that tell that a package was executed: the bare name of a postponed one is bound before that.
EXTRA = ("asammdf", "pandas", "matplotlib", "sympy")
# numba asks for the version of scipy, which imports next to nothing.
DESIGN = ("scipy.linalg", "scipy.special", "scipy.signal", "scipy.optimize", "filterpy")
PYTHON_CAN = ("can.bus", "can.io", "can.message")
QUIET = ("structlog", "asyncio", "pydantic_settings", "rich")
STUDIES = (
    "gateway_fleet.fleet",
    "gateway_fleet.learn",
    "gateway_bench.vecu",
    "gateway_fdi.structure",
    "gateway_calibration.configuration",
)
#: What gateway.toml has no use for.
OTHERS = tuple(f"gateway_plants.{name}.monitor" for name in ("pedal", "steering", "linear", "truck"))

_COMMAND = """
import sys
sys.argv = ["gateway", *sys.argv[1:]]
from gateway.cli import main
try:
    main()
except SystemExit as ended:
    code = ended.code or 0
print("MODULES", code, *sys.modules, file=sys.__stderr__)
"""


def run(code, *arguments, **environment):
    plain = {k: v for k, v in os.environ.items() if not k.upper().startswith("GATEWAY_M")}
    return subprocess.run(
        [sys.executable, "-c", code, *map(str, arguments)],
        capture_output=True,
        text=True,
        check=True,
        cwd=ROOT,
        env={**plain, **environment},
    )


def command(*arguments, ends=0, **environment):
    """Run a command in a process of its own; returns what it printed and the modules it loaded."""
    ended = run(_COMMAND, *arguments, **environment)
    _, code, *modules = ended.stderr.splitlines()[-1].split()
    assert int(code) == ends, ended.stderr
    return ended.stdout, set(modules)


def loaded(modules, forbidden):
    """Return which of these packages and modules are loaded, or have a part that is."""
    return {name for name in forbidden for m in modules if m == name or m.startswith(f"{name}.")}


@pytest.fixture
def memory(tmp_path):
    path = tmp_path / "faults.sqlite"
    store = Store(path)
    FaultMemory(Catalogue(()), store)
    store.close()
    return path


def test_help_imports_no_work():
    said, modules = command("--help")
    assert "simulate" in said
    assert "gateway.cli" in modules
    assert not loaded(
        modules,
        ("numpy", "numba", "cantools", "gateway.runtime.app", "gateway.config", *PYTHON_CAN),
    )


def test_the_module_runs_the_command_line_and_types_are_shipped():
    said = subprocess.run([sys.executable, "-m", "gateway", "--help"], capture_output=True, text=True, check=False)
    assert said.returncode == 0, said.stderr
    assert "faults" in said.stdout
    assert (Path(gateway.__file__).parent / "py.typed").exists()


@pytest.mark.parametrize("group", ["faults", "evaluate", "convert"])
def test_help_of_a_group_imports_no_work(group):
    said, modules = command(group, "--help")
    assert "Commands" in said
    assert not loaded(modules, ("numpy", "numba", "cantools", "gateway.runtime.app", "gateway.config"))


def test_check_imports_what_the_configuration_names():
    said, modules = command("check", "gateway.toml")
    assert "P0336-39" in said
    assert "gateway_plants.crank.monitor.monitor" in modules
    assert not loaded(modules, (*EXTRA, *DESIGN, *PYTHON_CAN, *QUIET, *STUDIES, *OTHERS))


def test_doctor_imports_no_extras():
    said, modules = command("doctor", "gateway.toml")
    assert "numba" in said
    assert not loaded(modules, (*EXTRA, *DESIGN, *PYTHON_CAN, *QUIET, *STUDIES, *OTHERS))


def test_listing_faults_draws_a_table_and_no_more(memory):
    said, modules = command("faults", "list", "--memory", memory)
    assert "no DTCs" in said
    wanted = set(QUIET) - {"rich"}
    assert not loaded(modules, (*EXTRA, *DESIGN, *PYTHON_CAN, *wanted, *STUDIES, *OTHERS))


def test_listing_faults_for_programs_draws_nothing(memory):
    said, modules = command("faults", "list", "--json", GATEWAY_MEMORY__PATH=str(memory))
    assert json.loads(said) == []
    assert "pydantic_settings" in modules  # the environment has something to say
    assert not loaded(modules, ("rich", "structlog", *EXTRA, *DESIGN, *PYTHON_CAN))


def test_a_replay_of_a_candump_log_imports_no_python_can(tmp_path):
    path = tmp_path / "a.log"
    path.write_text("(1.000000000) vcan0 700#00\n")
    said, modules = command("replay", path, "--config", "gateway.toml", "--json")
    assert json.loads(said.splitlines()[-1])["frames"] == 1
    assert not loaded(modules, (*EXTRA, *DESIGN, *PYTHON_CAN, *STUDIES, *OTHERS))


def test_a_daemon_on_our_own_buses_imports_no_python_can(tmp_path):
    _, modules = command(
        *("run", "gateway.toml", "--bus", "loopback:127.0.0.1:1", "--duration", "0"),
        *("--memory", tmp_path / "faults.sqlite"),
    )
    assert "gateway.isotp" in modules
    assert not loaded(modules, (*EXTRA, *DESIGN, *PYTHON_CAN, *STUDIES, *OTHERS))


@pytest.mark.long
def test_a_bus_in_operation_does_not_load_the_logger_with_frames_waiting():
    code = """
import sys
from gateway.live.clock import Clock
from gateway.live.link import Link
from gateway.bus.uri import open_bus
link = Link("virtual:a", 0, "a", open_bus, Clock())
before = "structlog" in sys.modules
link.start()
print(before, link.running, "structlog" in sys.modules)
link.close()
"""
    assert run(code).stdout.split() == ["False", "True", "True"]


@pytest.mark.long
def test_each_monitor_is_imported_by_itself():
    for name in MONITORS:
        code = f"""
import sys
from gateway.common.lazy_modules import postpone
postpone()
from gateway.monitors.registry import MONITORS
assert len(list(MONITORS)) == len(MONITORS) == {len(MONITORS)}
print({name!r} in MONITORS, MONITORS[{name!r}].type, *sys.modules)
"""
        there, type_, *modules = run(code).stdout.split()
        assert (there, type_) == ("True", name)
        assert not loaded(modules, (*EXTRA, *DESIGN))


def test_an_unknown_monitor_is_none():
    assert MONITORS.get("nonsense") is None
    assert "nonsense" not in MONITORS


@pytest.mark.long
def test_postponed_modules_are_the_real_ones_once_they_are_used():
    code = """
import sys
from gateway.common.lazy_modules import postpone
postpone()
import cantools, isotp
assert "can" in sys.modules and "can.bus" not in sys.modules
import can
with can.Bus("test", interface="virtual") as one:
    one.send(can.Message(arbitration_id=1))
assert issubclass(cantools.tester.Listener, can.Listener)
assert isotp.CanStack.set_bus.__globals__["can"] is can
from can.io.mf4 import MF4Reader
print(MF4Reader is can.MF4Reader, cantools.logreader.Parser.__module__)
"""
    assert run(code).stdout.split() == ["True", "cantools.logreader"]


@pytest.mark.long
def test_modules_that_are_loaded_already_stay_as_they_are():
    code = (
        "import can; before = can.Bus; from gateway.common.lazy_modules import postpone; postpone(); import cantools;"
        "print(can.Bus is before)"
    )
    assert run(code).stdout.strip() == "True"


@pytest.mark.long
def test_an_mf4_log_is_read_and_written_by_a_process_that_has_not_loaded_it(tmp_path):
    code = """
import sys
from pathlib import Path
import numpy as np
from gateway.bus.frames import empty
from gateway.bus.logs import LogWriter, LogReader
frames = empty(3)
frames["t_ns"], frames["can_id"], frames["length"] = [10**9, 2 * 10**9, 3 * 10**9], [1, 2, 3], 2
path = Path(sys.argv[1]) / "a.mf4"
assert "asammdf" not in sys.modules
writer = LogWriter(path)
writer.write(frames)
writer.close()
again = np.concatenate(list(LogReader(path)))
print(again["can_id"].tolist(), "asammdf" in sys.modules)
"""
    assert run(code, tmp_path).stdout.strip() == "[1, 2, 3] True"


@pytest.fixture
def lacking(monkeypatch):
    """Make a package one that is not installed."""
    return lambda package: monkeypatch.setitem(sys.modules, package, None)


def test_mf4_logs_without_their_extra_name_it(lacking, tmp_path):
    lacking("asammdf")
    path = tmp_path / "a.mf4"
    with pytest.raises(InputError, match=r"a\.mf4: .*pip install '\.\[mf4\]'"):
        open_writer(path)
    assert not path.exists()
    path.write_bytes(b"MDF     4.10")
    with pytest.raises(InputError, match=r"a\.mf4: .*pip install '\.\[mf4\]'"):
        LogReader(path)
    assert len(list(LogReader(_candump(tmp_path)))) == 1


def _candump(folder):
    path = folder / "a.log"
    path.write_text("(1.000000000) vcan0 700#00\n")
    return path


def test_the_structural_analysis_names_its_extra(lacking, capsys):
    ask = {"json": True, "limit": 1000, "sensors": None}
    lacking("sympy")
    with pytest.raises(InputError, match=r"--residual: .*\[structure\]"):
        structure(Path("example_1"), plot=None, residual="T1", **ask)
    assert structure(Path("example_1"), plot=None, residual=None, **ask) == 0
    assert json.loads(capsys.readouterr().out)


def test_doctor_says_what_is_not_installed(lacking, capsys, memory):
    def said(as_json):
        assert doctor(ROOT / "gateway.toml", memory=memory, json=as_json) == 0
        return capsys.readouterr().out

    assert "pip install" not in said(False)
    assert all(json.loads(said(True))["extras"].values())
    for package in (*EXTRAS.values(), "compression.zstd"):  # this one comes with Python 3.14
        lacking(package)
    text = said(False)
    assert all(f"'.[{extra}]' in the checkout, for {PURPOSES[extra]}" in text for extra in EXTRAS)
    assert set(json.loads(said(True))["extras"].values()) == {None}


@pytest.mark.long
def test_without_extras_all_but_their_features_is_there():
    """Every module of the packages but the studies, with the packages of all extras missing."""
    packages = (
        *(gateway, gateway_fdi, gateway_bench, gateway_plants, gateway_fleet),
        *(gateway_serve, gateway_checks, gateway_calibration, gateway_logs, gateway_testers, gateway_ask),
        *(gateway_api, gateway_causes, gateway_commands, gateway_replay),
    )
    names = [
        module.name
        for package in packages
        for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}.")
        if not module.name.startswith("gateway.shipped") and ".study." not in module.name
    ]
    code = f"""
import importlib, sys
for package in {(*EXTRAS.values(), "starlette", "uvicorn", "prometheus_client")!r}:
    sys.modules[package] = None
for name in {names!r}:
    try:
        importlib.import_module(name)
    except ImportError:
        print(name)
"""
    refused = set(run(code).stdout.split())
    algebra = {
        f"gateway_fdi.structure.generator.{name}"
        for name in (
            *("budget", "c_code", "code", "conditioning", "initial", "loading", "propagation", "realisation"),
            *("solver", "symbols"),
        )
    } | {f"gateway_fdi.structure.simulation.{name}" for name in ("plant", "reduction", "system")}
    pages = {
        f"gateway_serve.{name}"
        for name in ("app", "broker", "metrics", "mqtt", "server", "report.figures", "report.page")
    }
    pages |= {
        f"gateway_serve.sovd.{name}"
        for name in (
            *("app", "bulk_data", "configurations", "data", "entities", "faults", "locks", "logs", "modes", "openapi"),
            *("operations", "replies", "subscriptions", "table"),
        )
    }
    assert len(names) > 200
    others = {
        "gateway_plants.structural.monitor.choice",
        "gateway_bench.vecu.fmu.model",
        *(f"gateway_bench.pytest_plugin.{name}" for name in ("fixtures", "plugin", "scenarios")),
    }
    road = ("campaign", "deliver", "join", "member", "signed_documents", "statistics", "trials")
    assert refused == algebra | pages | others | {f"gateway_fleet.live.{name}" for name in road}


def test_the_package_offers_the_extras_that_are_named_to_people():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    offered = project["optional-dependencies"]
    assert offered.pop("all") == [f"ecu-gateway[{','.join(sorted(EXTRAS))}]"]
    assert set(offered) == set(EXTRAS) == set(PURPOSES)
    for extra, imported in EXTRAS.items():
        package = {"sklearn": "scikit-learn"}.get(imported, imported)
        assert any(line.startswith(f"{package}>=") for line in offered[extra])
        assert not any(line.startswith(package) for line in project["dependencies"])


def test_a_cluster_without_what_its_certificate_needs_is_one_line(monkeypatch):
    monkeypatch.setattr(extras, "find_spec", lambda name: None if name == "cryptography" else object())
    with pytest.raises(InputError, match=r"need cryptography: pip install '\.\[fleet\]'"):
        extras.need("fleet", "several logs at once")


@pytest.mark.full("4 s")
def test_variables_that_are_no_keys_of_the_configuration_load_nothing():
    code = "import sys; from gateway.config.load import load_config; from pathlib import Path\n"
    code += "c = load_config(Path('gateway.toml')); print(c.name, 'pydantic_settings' in sys.modules)"
    assert run(code, GATEWAY_CACHE_DIR_="x").stdout.split() == ["bench", "False"]
    assert run(code, gateway_name="other").stdout.split() == ["other", "True"]


def test_log_lines_of_commands_go_to_standard_error(capsys):
    log.to_stderr()
    log.get_logger("some.module").warning("bus lost", bus="chassis")
    said = capsys.readouterr()
    assert said.out == ""
    line = json.loads(said.err)
    assert (line["event"], line["bus"], line["level"]) == ("bus lost", "chassis", "warning")


def test_log_lines_of_a_program_go_where_it_sends_them(capsys):
    kept = []

    def keep(_logger, method, event):
        kept.append((method, event["event"]))
        raise structlog.DropEvent

    structlog.configure(processors=[keep])
    log.get_logger("some.module").info("bus is back")
    assert kept == [("info", "bus is back")]
    assert capsys.readouterr() == ("", "")
