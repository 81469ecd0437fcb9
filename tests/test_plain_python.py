"""Kernels as plain Python: the same tests with compilation switched off."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

TESTS = Path(__file__).parent


@pytest.mark.timeout(600)
@pytest.mark.parametrize(
    "parts",
    [
        [
            "engine",
            "bus/test_adapters.py",
            "signals/test_random_databases.py",
            "signals/test_crc_and_codec.py",
        ],
        ["monitors/crank_sync"],
        ["monitors", "--ignore=monitors/crank_sync"],
        ["fdi"],
    ],
    ids=lambda parts: parts[0],
)
def test_kernels_run_uncompiled(parts):
    ended = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-p", "no:xdist",
         "-W", "error::RuntimeWarning", *parts],
        cwd=TESTS,
        env={**os.environ, "NUMBA_DISABLE_JIT": "1"},
        capture_output=True,
        text=True,
        timeout=570,
        check=False,
    )  # fmt: skip
    assert ended.returncode == 0, ended.stdout[-3000:] + ended.stderr[-1000:]
    assert " passed" in ended.stdout or "100%" in ended.stdout
