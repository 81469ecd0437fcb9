"""Kernels as plain Python: the same tests with compilation switched off."""

import os
import subprocess
import sys
from pathlib import Path

TESTS = Path(__file__).parent


def test_engine_and_monitors_run_uncompiled():
    ended = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-p", "no:xdist",
         "-W", "error::RuntimeWarning", "engine", "fdi", "monitors", "signals/test_random_databases.py",
         "signals/test_crc_and_codec.py"],
        cwd=TESTS,
        env={**os.environ, "NUMBA_DISABLE_JIT": "1"},
        capture_output=True,
        text=True,
        timeout=280,
        check=False,
    )  # fmt: skip
    assert ended.returncode == 0, ended.stdout[-3000:] + ended.stderr[-1000:]
    assert " passed" in ended.stdout or "100%" in ended.stdout
