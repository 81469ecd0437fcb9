"""The compiled kernels that come with the package."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import gateway
from gateway_fdi.jit import COMPILED, shipped

pytestmark = pytest.mark.skipif(not COMPILED, reason="not COMPILED: nothing is loaded")

PACKAGE = Path(gateway.__file__).parent
ROOT = PACKAGE.parent
#: No MF4 log is read here.
WITHOUT = Path(__file__).parents[1] / "support" / "without"


def run(program, *arguments, root=ROOT, cache="/dev/null/none", **environment):
    return subprocess.run(
        [sys.executable, "-c", program, *arguments],
        cwd=root,
        env={
            **os.environ,
            "PYTHONPATH": os.pathsep.join([str(root), f"{root}/packages", str(WITHOUT)]),
            "GATEWAY_CACHE_DIR": str(cache),
            **environment,
        },
        capture_output=True,
        text=True,
        check=False,
    )


COMMAND = "import sys; from gateway.cli import main; sys.exit(main())"


#: Prints at the end whether the compiler was loaded.
LOADED = COMMAND.replace("sys.exit(main())", "\ntry: main()\nfinally: print('numba' in sys.modules)")


@pytest.mark.evidence("Bounded: first start")
@pytest.mark.long
@pytest.mark.parametrize(
    "scenario",
    [
        "crank_missed_tooth",
        "pedal_emergency",
        "steering_healthy",
        pytest.param("linear_aircraft_both", marks=pytest.mark.full("2 s")),
        pytest.param("truck_mass", marks=pytest.mark.full("2 s")),
    ],
)
def test_the_demos_compile_nothing_and_need_no_cache(scenario):
    ended = run(LOADED, "demo", scenario, "--speed", "0")
    assert ended.returncode == 0, ended.stderr
    assert ended.stderr == ""
    assert ended.stdout.strip().endswith("False")


@pytest.mark.long
def test_the_daemon_s_kernels_and_the_structural_analysis_compile_nothing():
    ended = run(COMMAND, "warmup", GATEWAY_KERNELS="shipped")
    assert (ended.returncode, ended.stderr) == (0, "")
    assert run(COMMAND, "structure", "example_1", GATEWAY_KERNELS="shipped").returncode == 0


@pytest.fixture
def copy(tmp_path):
    """Return a copy of the packages that a test may change."""
    for name in ("gateway", "packages"):
        shutil.copytree(ROOT / name, tmp_path / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("dbc", "scenarios"):
        (tmp_path / name).symlink_to(ROOT / name)
    (tmp_path / "gateway.toml").symlink_to(ROOT / "gateway.toml")
    return tmp_path


MADE_READY = """
from gateway_fdi.common import progress
names = set()
progress.listen(lambda name, done, total: names.add(name))
from gateway_commands.warmup import warmup
warmup(json=True)
print(sorted(names))
"""


def edit(file, old, new):
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new, 1))


@pytest.mark.full("3 s")
def test_a_comment_compiles_nothing(copy):
    edit(copy / "packages/gateway_bench/cli/bus.py", '"""', '# a comment\n"""')
    edit(copy / "packages/gateway_plants/pedal/monitor/diagnosis.py", '"""', '# a comment\n"""')
    ended = run(MADE_READY, root=copy, GATEWAY_KERNELS="shipped")
    assert ended.returncode == 0, ended.stderr
    assert ended.stdout.strip().endswith("[]")


@pytest.mark.long
def test_an_edit_of_one_monitor_compiles_that_monitor(copy, tmp_path):
    edit(copy / "packages/gateway_checks/rule/monitor.py", "min(c.signals, EVIDENCE)", "min(EVIDENCE, c.signals)")
    ended = run(MADE_READY, root=copy, cache=tmp_path / "cache")
    assert ended.returncode == 0, ended.stderr
    assert ended.stdout.strip().endswith("['gateway_checks.rule.monitor.step']")


@pytest.mark.long
def test_damaged_shipped_code_is_not_loaded(copy, tmp_path):
    for path in (copy / "packages/gateway_checks/precompiled").glob("*/rule.monitor.*"):
        path.write_bytes(path.read_bytes()[:-1] + b"x")
    ended = run(MADE_READY, root=copy, cache=tmp_path / "cache")
    assert ended.returncode == 0, ended.stderr
    assert ended.stdout.strip().endswith("['gateway_checks.rule.monitor.step']")


@pytest.mark.long
@pytest.mark.full("20 s")
def test_where_no_object_fits_bitcode_is_translated_once(copy, tmp_path):
    for level in ("x86_64", "x86_64_v3", "aarch64"):
        for folder in copy.glob(f"**/precompiled/{level}"):
            shutil.rmtree(folder)
    cache = tmp_path / "cache"
    some = ("demo", "pedal_emergency", "--speed", "0")
    ended = run(COMMAND, *some, root=copy, cache=cache, GATEWAY_KERNELS="shipped")
    assert ended.returncode == 0, ended.stderr
    first = {path: path.stat().st_mtime_ns for path in (cache / "kernels").iterdir()}
    assert any("engine.loop.run" in path.name for path in first)
    assert run(COMMAND, *some, root=copy, cache=cache, GATEWAY_KERNELS="shipped").returncode == 0
    assert {path: path.stat().st_mtime_ns for path in (cache / "kernels").iterdir()} == first


def test_without_the_loader_of_machine_code_kernels_run_as_plain_python(tmp_path):
    """The end of the load order: slow, and right."""
    program = """
import importlib.util, sys
found = importlib.util.find_spec
importlib.util.find_spec = lambda name, *rest: None if name == "llvmlite" else found(name, *rest)
sys.modules["llvmlite"] = sys.modules["numba"] = None
from gateway.cli import main
try:
    main()
finally:
    assert not sys.modules["gateway_fdi.jit"].COMPILED
"""
    ended = run(program, "check")
    assert ended.returncode == 0, ended.stderr
    assert "llvmlite" in ended.stderr


def test_every_entry_that_is_shipped_is_there_for_both_architectures():
    index = shipped._index("gateway")
    assert len(index["entries"]) > 20
    for found in index["entries"].values():
        assert shipped.bitcode(found) is not None
        for architecture in ("x86_64", "x86_64_v3", "aarch64"):
            assert shipped.code(found, architecture) is not None
