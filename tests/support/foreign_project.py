"""A project of others: pytest and commands run in its folder, in a process of their own, with the installed package."""

import importlib.metadata
import os
import subprocess
import sys
from functools import cache
from pathlib import Path

from nested_pytest import PYTEST

ROOT = Path(__file__).parents[2]
#: No MF4 log is read in these projects.
WITHOUT = str(Path(__file__).parent / "without")


@cache
def environment():
    """Return the environment of such a process; this checkout is in it only where it is not what is installed."""
    found = {k: v for k, v in os.environ.items() if not k.startswith(("PYTEST_", "GATEWAY_M", "GATEWAY_TESTS"))}
    alone = {k: v for k, v in found.items() if k != "PYTHONPATH"}
    program = "import gateway; print(gateway.__file__)"
    said = subprocess.run(
        [sys.executable, "-c", program], cwd="/", env=alone, capture_output=True, text=True, timeout=600, check=False
    )
    if said.stdout.strip().startswith(f"{ROOT}{os.sep}"):
        return alone | {"PYTHONPATH": WITHOUT}
    places = [str(ROOT), str(ROOT / "packages"), os.environ.get("PYTHONPATH", ""), WITHOUT]
    return found | {"PYTHONPATH": os.pathsep.join(places)}


def run(folder, *arguments):
    """Run pytest in a folder; returns exit code and what it printed."""
    installed = any(e.value == "gateway_pytest" for e in importlib.metadata.entry_points(group="pytest11"))
    door = [] if installed else ["-p", "gateway_pytest"]
    command = [*PYTEST, "-p", "no:hypothesispytest", *door, "-rA", *arguments]
    done = subprocess.run(
        command, cwd=folder, env=environment(), capture_output=True, text=True, timeout=600, check=False
    )
    return done.returncode, done.stdout + done.stderr


def properties(case):
    return [(p.get("name"), p.get("value")) for p in case._elem.iter("property")]


def gateway(folder, *arguments):
    """Run a command of the gateway in a folder; returns exit code and what it printed."""
    command = [sys.executable, "-m", "gateway", *arguments]
    done = subprocess.run(
        command, cwd=folder, env=environment(), capture_output=True, text=True, timeout=600, check=False
    )
    return done.returncode, done.stdout + done.stderr
