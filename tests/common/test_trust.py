"""Nobody's code runs before somebody has trusted it: a folder of traps, of which none goes off."""

import os
import pickle
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest
from command import command

from gateway.common import trust
from gateway.monitors.registry import MONITORS
from gateway.servers.uds.security import KEYS
from gateway_bench.vecu.registry import VIRTUAL_ECUS
from gateway_fdi.common.resources import shipped
from gateway_fdi.errors import InputError

TRAP = (
    "from pathlib import Path\n\nPath({mark!r}).touch()\n\n\nclass M:\n    def step(self, t, inputs): return {{}}\n\n\n"
)
TRAP += "def f(*_): return b''\n"
BUS = '[[bus]]\nname = "can"\nuri = "virtual:x"\ndatabase = ["battery.dbc"]\n'
MONITOR = '[[monitor]]\nname = "m"\ntype = "{}"\n'
KEY = '[output.uds]\nbus = "can"\n[[output.uds.security]]\nlevel = 1\nsecret = "00112233445566778899aabbccddeeff"\n'
KEY += 'key = "{}"\n'
ARENA = (
    '[[monitor]]\nname = "a"\ntype = "method"\nmethod = "{}"\nfitted = "evil.fitted"\nperiod_ms = 100\n'
    'inputs = ["BATT.Voltage"]\n'
)
SCENARIO = 'config = "gateway.toml"\nduration_s = 1\n[[ecu]]\ntype = "{}"\nname = "e"\nbus = "can"\n'


class _Bomb:
    def __init__(self, mark):
        self._mark = mark

    def __reduce__(self):
        return Path.touch, (Path(self._mark),)


@pytest.fixture
def alone(monkeypatch, tmp_path):
    """A user who has trusted nothing; returns the folder of a stranger's files, in which he is."""
    monkeypatch.delenv(trust.VARIABLE)
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "own"))
    monkeypatch.setattr(trust, "SYSTEM", tmp_path / "etc/trusted")
    monkeypatch.setattr(trust, "_folders", [])
    monkeypatch.setattr(trust, "_claimed", {})
    monkeypatch.setattr(sys, "meta_path", [one for one in sys.meta_path if not isinstance(one, trust._Finder)])
    for registry in (MONITORS, KEYS, VIRTUAL_ECUS):
        monkeypatch.setattr(registry, "_known", {})
    modules = set(sys.modules)
    folder = tmp_path / "strangers"
    folder.mkdir()
    (folder / "battery.dbc").write_text(shipped("examples/battery_voltage/battery.dbc").read_text())
    monkeypatch.chdir(folder)
    yield folder
    for name in set(sys.modules) - modules:
        plain = type(sys.modules[name]) is ModuleType  # others wait for their use
        if plain and str(folder) in str(getattr(sys.modules[name], "__file__", "")):
            del sys.modules[name]


def trap(folder, name, text=TRAP):
    """Write a module that leaves a mark when it runs; returns the mark."""
    mark = folder / f"{name.replace('/', '.')}.ran"
    file = folder / f"{name}.py"
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(text.format(mark=str(mark)))
    return mark


def ran(folder):
    return sorted(mark.name for mark in folder.rglob("*.ran"))


PLACES = {
    "monitor": BUS + MONITOR.format("evil:M"),
    "monitor of a package": BUS + MONITOR.format("pack.evil:M"),
    "key function": BUS + KEY.format("evil:f"),
    "method": BUS + ARENA.format("evil.py:M"),
    "what a method has learned": BUS + ARENA.format("pca"),
}
#: The file of code, where it is another than ``evil.py``.
FILES = {"monitor of a package": "pack/evil.py", "what a method has learned": "evil.fitted"}


def traps(folder):
    """Write every trap that is known; each leaves a mark."""
    for name in ("evil", "pack/__init__", "pack/evil", "sitecustomize", "usercustomize", "conftest", "plugin"):
        trap(folder, name)
    for name in ("numpy", "cantools", "yaml", "brotli", "tomllib", "site", "gateway_plugin", "pydantic", "lxml"):
        trap(folder, name)
    (folder / "evil.pth").write_text(f"import pathlib; pathlib.Path({str(folder / 'pth.ran')!r}).touch()\n")
    (folder / "evil.fitted").write_bytes(b"{}\n" + pickle.dumps(_Bomb(folder / "pickle.ran")))
    (folder / "drive.log").write_text("(1.000000) can 100#0102030405060708\n")


@pytest.mark.parametrize("place", PLACES)
def test_a_check_runs_nobodys_code_and_says_how_to_trust_it(place, alone, capsys, monkeypatch):
    if place in ("method", "what a method has learned"):
        pytest.importorskip("gateway_arena")
    traps(alone)
    (alone / "gateway.toml").write_text(PLACES[place])
    said = command(capsys, monkeypatch, "check")
    assert (ran(alone), said.code) == ([], 2)
    (line,) = said.err.splitlines()
    assert "gateway.toml: " in line
    file = FILES.get(place, "evil.py")
    assert f"gateway trust {alone / file}" in line
    said = command(capsys, monkeypatch, "replay", "drive.log", "-c", "gateway.toml")
    assert (ran(alone), said.code) == ([], 2)
    assert f"gateway trust {alone / file}" in said.err


@pytest.mark.parametrize("arguments", [
    ("doctor", "-c", "gateway.toml"), ("decode", "drive.log", "-o", "out", "-c", "gateway.toml"),
    ("learn", "battery.dbc", "drive.log", "-o", "car.toml"), ("faults", "list", "-c", "gateway.toml"),
    ("check", "--schema"), ("calibrate", "gateway.toml", "drive.log"), ("run", "gateway.toml", "--duration", "0.1"),
    ("import", "battery.dbc", "-o", "ecu.toml"), ("simulate", "scenario.toml"), ("demo", "scenario.toml"),
])  # fmt: skip
def test_other_commands_run_nobodys_code(arguments, alone, capsys, monkeypatch):
    traps(alone)
    (alone / "gateway.toml").write_text("".join([*list(PLACES.values())[:1], KEY.format("evil:f")]))
    (alone / "scenario.toml").write_text(SCENARIO.format("evil:M"))
    command(capsys, monkeypatch, *arguments)
    assert ran(alone) == []


@pytest.mark.long
@pytest.mark.parametrize("arguments", [("check",), ("replay", "drive.log", "-c", "gateway.toml")], ids=lambda a: a[0])
def test_the_folder_in_which_it_starts_hides_no_module(arguments, alone):
    traps(alone)
    (alone / "gateway.toml").write_text(BUS + MONITOR.format("evil:M"))
    ended = subprocess.run(
        [sys.executable, "-m", "gateway", *arguments], capture_output=True, text=True, check=False, timeout=600
    )
    assert (ended.returncode, ran(alone)) == (2, []), ended.stderr
    assert "gateway trust" in ended.stderr


def test_all_else_is_checked_without_the_code(alone, capsys, monkeypatch):
    trap(alone, "evil")
    rest = BUS.replace("virtual:x", "nowhere:x") + MONITOR.format("evil:M") + '[[monitor]]\nname = "b"\ntype = "ruel"\n'
    (alone / "gateway.toml").write_text(rest)
    said = command(capsys, monkeypatch, "check")
    assert [key in said.err for key in ("bus[0].uri", "monitor[0].type", "monitor[1].type")] == [True] * 3
    assert ran(alone) == []


def test_a_name_that_is_not_there_is_told_without_running_it(alone, capsys, monkeypatch):
    trap(alone, "evil")
    (alone / "gateway.toml").write_text(BUS + MONITOR.format("evil:Monitor"))
    said = command(capsys, monkeypatch, "check")
    assert f"{alone / 'evil.py'} has no Monitor" in said.err
    (alone / "evil.py").write_text("def f(:\n")
    assert "SyntaxError" in command(capsys, monkeypatch, "check").err
    (alone / "gateway.toml").write_text(BUS + MONITOR.format("nowhere:M"))
    assert "No module named 'nowhere'" in command(capsys, monkeypatch, "check").err


MONITOR_OF_A_USER = shipped("examples/battery_voltage/battery_voltage.py")


@pytest.fixture
def trusted(alone, capsys, monkeypatch):
    """A monitor in two modules, trusted; returns its folder."""
    (alone / "limits.py").write_text("LOWEST = 1\n")
    text = MONITOR_OF_A_USER.read_text().replace("\nfrom gateway", "\nimport limits\nfrom gateway", 1)
    assert "import limits" in text
    (alone / "own_battery.py").write_text(text)
    (alone / "gateway.toml").write_text(BUS + MONITOR.format("own_battery:MONITOR"))
    said = command(capsys, monkeypatch, "trust", "own_battery.py")
    assert said.code == 0
    assert [f"trusted: {alone / name}" in said.out for name in ("own_battery.py", "limits.py")] == [True, True]
    return alone


def test_what_is_trusted_runs_until_it_changes(trusted, capsys, monkeypatch):
    said = command(capsys, monkeypatch, "check")
    assert said.code == 0, said.err
    for name in ("limits", "own_battery"):
        del sys.modules[name]
    assert "own_battery.py" in command(capsys, monkeypatch, "trust").out
    with (trusted / "limits.py").open("a") as file:
        file.write("# changed\n")
    MONITORS._known.pop("own_battery:MONITOR")
    said = command(capsys, monkeypatch, "check")
    assert (said.code, f"a module that it imports, {trusted / 'limits.py'}" in said.err) == (2, True), said.err
    assert "gateway trust" in said.err


def test_a_compiled_copy_beside_the_code_is_not_run(trusted, capsys, monkeypatch):
    """Python takes it by time and size of the source alone."""
    mark = trap(trusted, "bad", TRAP)
    import py_compile

    compiled = Path(py_compile.compile(str(trusted / "bad.py"), doraise=True))
    data, status = bytearray(compiled.read_bytes()), (trusted / "limits.py").stat()
    data[8:16] = int(status.st_mtime).to_bytes(4, "little") + status.st_size.to_bytes(4, "little")
    compiled.with_name(compiled.name.replace("bad", "limits")).write_bytes(data)
    sys.modules.pop("limits", None)
    assert command(capsys, monkeypatch, "check").code == 0
    assert not mark.exists()


def test_one_run_takes_all(alone, capsys, monkeypatch):
    mark = trap(alone, "evil")
    (alone / "gateway.toml").write_text(BUS + MONITOR.format("evil:M"))
    monkeypatch.setenv(trust.VARIABLE, "")
    said = command(capsys, monkeypatch, "check", "--trust")
    assert mark.exists()
    assert "this is no Monitor" in said.err
    assert os.environ[trust.VARIABLE] == trust.ALL, "processes that it starts take it, too"


def test_a_list_that_others_can_write_is_refused(trusted, capsys, monkeypatch):
    trust.user_list().chmod(0o666)
    assert "others can write it (mode 666)" in command(capsys, monkeypatch, "trust").err
    said = command(capsys, monkeypatch, "check")
    assert said.code == 2
    assert "this list of trusted code is not used: others can write it (mode 666)" in said.err
    trust.user_list().chmod(0o600)
    assert command(capsys, monkeypatch, "check").code == 0


def test_the_administrators_list_is_for_all(alone, capsys, monkeypatch):
    mark = trap(alone, "evil")
    assert command(capsys, monkeypatch, "trust", "--system", "evil.py").code == 0
    assert trust.SYSTEM.stat().st_mode & 0o777 == 0o644
    (alone / "gateway.toml").write_text(BUS + KEY.format("evil:f"))
    command(capsys, monkeypatch, "check")
    assert mark.exists()


def test_trust_is_for_code(alone, capsys, monkeypatch):
    (alone / "gateway.toml").write_text(BUS)
    said = command(capsys, monkeypatch, "trust", "gateway.toml")
    assert (said.code, "gateway check says which file it is" in said.err) == (2, True)
    said = command(capsys, monkeypatch, "trust", "nowhere.py")
    assert (said.code, "nowhere.py: No such file" in said.err) == (2, True)


def test_no_module_that_is_looked_for_by_chance_is_found_beside(alone, capsys, monkeypatch):
    """Packages try what may be installed; a file of that name beside a configuration is not it."""
    traps(alone)
    trust.importable(alone)
    with pytest.raises(ModuleNotFoundError):
        __import__("gateway_plugin")
    assert ran(alone) == []


def test_a_submodule_that_is_not_trusted_is_not_found_by_anybody(alone):
    for name in ("pack/__init__", "pack/evil"):
        trap(alone, name)
    (alone / "pack/__init__.py").write_text("")
    trust.add([alone / "pack/__init__.py"], trust.user_list())
    trust.importable(alone)
    assert __import__("pack").__file__ == str(alone / "pack/__init__.py")
    with pytest.raises(ModuleNotFoundError):
        __import__("pack.evil")
    assert ran(alone) == []
    trust.add([alone / "pack/evil.py"], trust.user_list())
    __import__("pack.evil")
    assert ran(alone) == ["pack.evil.ran"]


def test_a_folder_on_the_path_is_no_installation(alone, monkeypatch):
    trap(alone, "evil")
    monkeypatch.setattr(sys, "path", [str(alone), *sys.path])
    with pytest.raises(InputError, match="is not trusted"):
        trust.require("evil", "M")
    trust.require("json", "loads")
    trust.require("numpy.linalg", "inv")
    trust.require("gateway_bench.vecu.contract", "VirtualEcu")
    assert ran(alone) == []


def test_an_fmu_is_code(alone, capsys, monkeypatch):
    pytest.importorskip("fmpy")
    from gateway_bench.vecu.fmu.model import FmuModel
    from gateway_bench.vecu.fmu.params import FmuParams

    file = alone / "evil.fmu"
    file.write_bytes(b"PK")
    params = FmuParams.model_construct(file=file, step_ms=1.0)
    with pytest.raises(InputError, match=r"its machine code, .*evil\.fmu, is not trusted"):
        FmuModel(params, 1.0)
    trust.add([file], trust.user_list())
    with pytest.raises(InputError, match="no archive, or cut off"):
        FmuModel(params, 1.0)
