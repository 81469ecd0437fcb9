"""User-mode Linux with SocketCAN: a kernel of its own for tests and benchmarks, where this machine's has none."""

import os
import shlex
import subprocess
import sys
from pathlib import Path

from debian import program

ROOT = Path(__file__).parents[2]
HERE = ROOT / "tests" / "system" / "vcan"
#: What the test kernels need of Debian.
PACKAGES = ("user-mode-linux", "can-utils", "busybox-static", "iproute2", "gcc", "libc6-dev")
_KEEP = {"PATH", "HOME", "GATEWAY_TRUST", "GATEWAY_CACHE_DIR", "XDG_CACHE_HOME", "LANG"}


def build_ptrace_xsave(folder):
    """Build the library that is loaded before the test kernel's C library; returns its path."""
    program("gcc", *PACKAGES)
    library = folder / "ptrace_xsave.so"
    subprocess.run(
        ["gcc", "-O2", "-Wall", "-Werror", "-shared", "-fPIC", "-o", library, HERE / "ptrace_xsave.c", "-ldl"],
        check=True,
    )
    return library


def boot(commands, work, library, environment):
    """Boot a kernel in which commands run beside each other, each in a lane with a vcan0 to vcan2 of its own.

    In the folder lane0 of ``work`` are ``output`` and ``status`` of the first command, when it has ended.

    Args:
        commands: of a shell, run in the project's folder.
        work: a folder.
        library: of :func:`build_ptrace_xsave`.
        environment: of the commands, beside the few variables that any needs.

    Returns:
        what the kernel itself said.
    """
    linux = program("linux.uml", *PACKAGES)
    environment = {k: v for k, v in os.environ.items() if k in _KEEP} | environment
    environment["PATH"] = f"{Path(sys.executable).parent}:/usr/sbin:/sbin:{environment['PATH']}"
    (work / "environment").write_text("".join(f"{k}={shlex.quote(v)}\n" for k, v in environment.items()))
    for k, command in enumerate(commands):
        (work / f"lane{k}").mkdir()
        (work / f"lane{k}" / "command").write_text(f"cd {shlex.quote(str(ROOT))}\nexec {command}\n")
    booted = subprocess.run(
        [linux, "mem=2G", "rootfstype=hostfs", "rootflags=/", "rw", f"init={HERE / 'init.sh'}",
         f"GUEST_WORK={work}", "con=null", "con0=null,fd:1", "quiet"],
        env={**os.environ, "LD_PRELOAD": str(library)},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=1100,
        check=False,
    )  # fmt: skip
    return booted.stdout + booted.stderr
