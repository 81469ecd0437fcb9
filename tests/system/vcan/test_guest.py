"""Real SocketCAN where this machine's kernel has none: the vcan tests inside user-mode Linux.

Debian's user-mode-linux boots with the host's files in some seconds, without privileges. Tests in it run in real time
and mostly wait: in each kernel several lanes run beside each other, each in a network namespace with a vcan0 to vcan2
of its own. In CI its absence is a failure. On a machine with a vcan0 of its own the marked tests run directly:
``pytest -m vcan`` as root, with vcan0 to vcan2 (mtu 72) up.

The kernel does not know the registers of a processor with AMX. ptrace_xsave.c adds them; it is loaded before the
kernel's C library, on every machine.
"""

import errno
import json
import os
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from amount import FULL
from scenario_runs import by_config
from user_mode import boot, build_ptrace_xsave

HERE = Path(__file__).parent
CRANK = ("test_crank_scenarios.py",)
#: Of these some are played in the full size only: then each lane has some.
OTHERS = tuple(f"test_{plant}_scenarios.py" for plant in ("pedal", "steering", "linear", "truck"))
PEERS, REST_BUS = ("test_peers.py",), ("test_restbus.py",)
INTERFACES, CLOCK = ("test_supervision.py", "test_socketcan.py"), ("test_clock.py",)
#: Kernel -> its lanes, each some files of tests. The start of a kernel, and of Python in it, takes more of a processor
#: than most of its tests, which wait: in CI one of all does. The clock is one of all lanes: last, or alone.
KERNELS = (
    {
        "scenarios": (CRANK, OTHERS[:1], OTHERS[1:]),
        "interfaces": (PEERS, INTERFACES, REST_BUS),
        "clock": (CLOCK,),
    }
    if FULL
    else {"all": ((*CRANK, *OTHERS, *PEERS, *INTERFACES, *REST_BUS, *CLOCK),)}
)

pytestmark = pytest.mark.system


@pytest.fixture(scope="module")
def ptrace_xsave(tmp_path_factory):
    """The library that is loaded before the test kernel's C library."""
    return build_ptrace_xsave(tmp_path_factory.mktemp("ptrace"))


def test_every_file_is_in_a_lane():
    files = {path.name for path in HERE.glob("test_*.py")} - {Path(__file__).name}
    listed = [file for lanes in KERNELS.values() for lane in lanes for file in lane]
    assert sorted(listed) == sorted(files)


def test_a_tracer_that_knows_half_of_the_registers_writes_them(ptrace_xsave):
    """As the test kernel on a processor with AMX; without the library the host refuses any part of the area."""
    written = {}
    for preload in ("", str(ptrace_xsave)):
        ended = subprocess.run(
            [sys.executable, HERE / "register_tracer.py"],
            env={**os.environ, "LD_PRELOAD": preload},
            capture_output=True,
            text=True,
            check=True,
        )
        written[bool(preload)] = json.loads(ended.stdout)
    alone, helped = written[False], written[True]
    assert alone == {"read": 0, "write": errno.EFAULT, "kept": False}
    assert helped == {"read": 0, "write": 0, "kept": True}


def test_no_scenario_is_left_out():
    """Each is of a kind that is played in a kernel, or in one process only (tests/runtime/test_gateway.py)."""
    kinds = ("crank", "pedal", "steering", "linear", "truck")
    alone = ("responder", "restbus", "structural", "table", "turbo")
    every = {}
    for kind in (*kinds, *alone):
        for config, paths in by_config(kind).items():
            every[config] = [*every.get(config, ()), *paths]
    assert {config: sorted(paths) for config, paths in every.items()} == {
        config: sorted(paths) for config, paths in by_config(None).items()
    }
    assert sum(map(len, every.values())) >= 21


@pytest.mark.parametrize("kernel", KERNELS)
def test_the_vcan_tests_pass_in_a_real_kernel(kernel, tmp_path, ptrace_xsave):
    keep = {"NUMBA_DISABLE_JIT", "GATEWAY_TESTS", "CI"}
    environment = {k: v for k, v in os.environ.items() if k in keep}
    environment["GATEWAY_DEMAND_VCAN"] = "1"
    # In this kernel a page of memory is dear, and so is each import: what the tests there do not need is left out.
    environment["PYTEST_DISABLE_PLUGIN_AUTOLOAD"] = "1"
    environment["PYTHONPATH"] = os.pathsep.join(
        [str(HERE.parents[1] / "support" / "without"), *filter(None, [os.environ.get("PYTHONPATH")])]
    )
    commands = [
        f"python -m pytest -p pytest_timeout -p no:cacheprovider -m vcan --durations=0"
        f" --basetemp={tmp_path}/lane{k}/inner {shlex.join(str(HERE / file) for file in files)}"
        for k, files in enumerate(KERNELS[kernel])
    ]
    booted = boot(commands, tmp_path, ptrace_xsave, environment)
    lanes = [tmp_path / f"lane{k}" for k in range(len(commands))]
    said = "".join((lane / "output").read_text() for lane in lanes if (lane / "output").exists()) or booted
    print(said)
    for lane in lanes:
        assert (lane / "status").exists(), said
        assert (lane / "status").read_text().strip() == "0", said
        assert " passed" in (lane / "output").read_text()
