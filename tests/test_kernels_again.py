"""Kernels as plain Python, and compiled with every index checked: the smallest cases of the same tests once more."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

TESTS = Path(__file__).parent
PLAIN = {"NUMBA_DISABLE_JIT": "1"}
CHECKED = {"GATEWAY_BOUNDSCHECK": "1"}
ENGINE = (
    "engine",
    "bus/test_adapters.py",
    "bus/test_readers.py",
    "bus/test_traffic.py",
    "signals/test_random_databases.py",
    "signals/test_tooth_codec.py",
)
PLANTS = tuple(f"{plant}/monitor" for plant in ("linear", "pedal", "steering", "structural", "truck"))
MONITORS = ("monitors", *PLANTS)
#: Mathematics, the plants' too.
FDI = (
    "fdi", "linear/mathematics", "linear/model_set", "linear/pi_bank", "pedal/test_lag.py",
    "pedal/test_tracking_voter.py", "crank/test_wheel_seen.py",
)  # fmt: skip

#: Of these folders: of no kernel, so that one run is enough.
WITHOUT_KERNELS = ("engine/test_depends.py",)

# Whether something hangs is seen by the limit of each test inside.
pytestmark = [pytest.mark.long, pytest.mark.timeout(3600)]


@pytest.mark.parametrize(
    ("setting", "parts"),
    [
        pytest.param(PLAIN, ENGINE, id="plain-engine"),
        pytest.param(PLAIN, ("crank/monitor",), id="plain-crank_sync"),
        pytest.param(PLAIN, MONITORS, id="plain-monitors"),
        pytest.param(PLAIN, FDI, id="plain-fdi"),
        pytest.param(CHECKED, (*ENGINE, *MONITORS, "crank/monitor", *FDI), id="checked"),
    ],
)
def test_the_smallest_cases_pass(setting, parts):
    ended = subprocess.run(
        [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "-p", "no:xdist",
         "-W", "error::RuntimeWarning", "--durations=15", *(f"--ignore={path}" for path in WITHOUT_KERNELS), *parts],
        cwd=TESTS,
        env={**os.environ, "GATEWAY_TESTS": "small", **setting},
        capture_output=True,
        text=True,
        check=False,
    )  # fmt: skip
    print(ended.stdout)
    assert ended.returncode == 0, ended.stdout[-3000:] + ended.stderr[-1000:]
    assert " passed" in ended.stdout
