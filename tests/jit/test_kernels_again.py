"""Kernels as plain Python, and compiled with every index checked: the smallest cases of the same tests once more.

CI runs the engine's as plain Python, which every frame passes (half a minute); all parts run with GATEWAY_TESTS=full.
For plain Python no kernels are made, so its parts are smaller: all files, dealt out in turn.
"""

import os
import subprocess
from pathlib import Path

import pytest
from amount import FULL
from nested_pytest import PYTEST

TESTS = Path(__file__).parents[1]
PLAIN = {"NUMBA_DISABLE_JIT": "1"}
CHECKED = {"GATEWAY_BOUNDSCHECK": "1"}
#: Without the checks of messages in whole gateways (engine/checks), which are slow so.
ENGINE = tuple(
    sorted(str(path.relative_to(TESTS)) for path in TESTS.glob("engine/test_*.py") if path.stem != "test_depends")
)
BUSES = (
    "bus/test_adapters.py",
    "bus/test_readers.py",
    "bus/test_traffic.py",
    "faults/test_journal.py",
    "signals/test_random_databases.py",
)
PLANTS = {plant: (f"{plant}/monitor",) for plant in ("linear", "pedal", "steering", "structural", "truck")}
MONITORS = ("monitors",)
#: Mathematics, the plants' too.
FDI = (
    "fdi", "linear/mathematics", "linear/model_set", "linear/pi_bank", "pedal/test_lag.py",
    "pedal/test_tracking_voter.py", "crank/test_tooth_codec.py", "crank/test_wheel_seen.py",
)  # fmt: skip

CRANK = sorted(str(path.relative_to(TESTS)) for path in TESTS.glob("crank/monitor/test_*.py"))

ALL = {
    "engine": ENGINE, "buses": BUSES, "crank": CRANK[::2], "crank, too": CRANK[1::2], "monitors": MONITORS,
    **PLANTS, "mathematics": FDI,
}  # fmt: skip
#: Without those of plants that are not in this checkout.
THERE = {part: [path for path in paths if (TESTS / path).exists()] for part, paths in ALL.items()}
PARTS = {part: paths for part, paths in THERE.items() if paths}

#: Of these folders: of no kernel, so that one run is enough.
WITHOUT_KERNELS = ("engine/test_depends.py",)
_FILES = sorted({
    str(file.relative_to(TESTS))
    for paths in PARTS.values()
    for path in paths
    for file in ([TESTS / path] if path.endswith(".py") else (TESTS / path).rglob("test_*.py"))
} - set(WITHOUT_KERNELS))  # fmt: skip
_HANDS = 12
DEALT = {f"{k + 1} of {_HANDS}": _FILES[k::_HANDS] for k in range(_HANDS)}
#: Part -> its files and folders, and its environment.
WAYS = {f"plain, {part}": (files, PLAIN) for part, files in DEALT.items()}
WAYS |= {f"checked, {part}": (files, CHECKED) for part, files in PARTS.items()}
IN_CI = {"plain, engine": (list(ENGINE), PLAIN)}

# Whether something hangs, or takes too long as plain Python, is seen by the limit of each test inside.
pytestmark = [pytest.mark.long, pytest.mark.timeout(3600)]


@pytest.mark.evidence("Live is replay: kernels")
@pytest.mark.parametrize("part", WAYS if FULL else IN_CI)
def test_as_plain_python_and_with_every_index_checked(part):
    files, setting = (WAYS | IN_CI)[part]
    rest = [*(f"--ignore={path}" for path in WITHOUT_KERNELS), *files]
    ended = subprocess.run(
        [*PYTEST, "-p", "no:xdist", "-W", "error::RuntimeWarning", "--durations=15", "--timeout=600", *rest],
        cwd=TESTS,
        env={**os.environ, "GATEWAY_TESTS": "small", **setting},
        capture_output=True,
        text=True,
        check=False,
    )  # fmt: skip
    print(ended.stdout)
    assert ended.returncode == 0, ended.stdout[-3000:] + ended.stderr[-1000:]
    assert " passed" in ended.stdout
