"""Real SocketCAN where this machine's kernel has none: the vcan tests inside user-mode Linux.

Debian's user-mode-linux boots with the host's files in some seconds, without privileges; each file of tests has a
kernel of its own. In CI its absence is a failure. On a machine with a vcan0 of its own the marked tests run directly:
``pytest -m vcan`` as root, with vcan0 to vcan2 (mtu 72) up.
"""

import os
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).parent
UML = shutil.which("linux.uml")
#: The scenarios take longest.
FILES = sorted(
    (path.name for path in HERE.glob("test_*.py") if path.name != "test_guest.py"),
    key=lambda name: ("scenarios" not in name, name),
)

pytestmark = [pytest.mark.system, pytest.mark.timeout(600)]


@pytest.mark.parametrize("file", FILES)
def test_the_vcan_tests_pass_in_a_real_kernel(file, tmp_path):
    if UML is None:
        reason = "user-mode-linux is not installed (apt-get install user-mode-linux can-utils)"
        if os.environ.get("CI"):
            pytest.fail(reason)
        pytest.skip(reason)
    keep = {"PATH", "HOME", "GATEWAY_CACHE_DIR", "XDG_CACHE_HOME", "LANG"}
    keep |= {"PYTHONPATH", "NUMBA_DISABLE_JIT"}
    environment = {k: v for k, v in os.environ.items() if k in keep}
    environment["PATH"] = f"{Path(sys.executable).parent}:/usr/sbin:/sbin:{environment['PATH']}"
    environment["GATEWAY_DEMAND_VCAN"] = "1"
    (tmp_path / "environment").write_text(
        "".join(f"{k}={shlex.quote(v)}\n" for k, v in environment.items())
    )
    (tmp_path / "command").write_text(
        f"cd {shlex.quote(str(HERE.parents[2]))}\n"
        f"exec python -m pytest -p no:cacheprovider -p no:xdist -m vcan --durations=0"
        f" --basetemp={tmp_path}/inner {shlex.quote(str(HERE / file))}\n"
    )
    booted = subprocess.run(
        [UML, "mem=1G", "rootfstype=hostfs", "rootflags=/", "rw", f"init={HERE / 'init.sh'}",
         f"GUEST_WORK={tmp_path}", "con=null", "con0=null,fd:1", "quiet"],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=570,
        check=False,
    )  # fmt: skip
    output = tmp_path / "output"
    said = output.read_text() if output.exists() else booted.stdout + booted.stderr
    status = tmp_path / "status"
    assert status.exists(), said
    print(said)
    assert status.read_text().strip() == "0", said
    assert " passed" in said
