"""The ten uses of docs/api.md: each runs as it stands there, and mypy --strict accepts it outside of the package."""

import ast
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from gateway_fdi.common.resources import shipped

ROOT = Path(__file__).parents[2]
USES = re.findall(
    r"^### (\d+)\. .*?\n\n```python\n(.*?)```", (ROOT / "docs/api.md").read_text(), re.MULTILINE | re.DOTALL
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return a folder of a user: his files, and the uses as scripts."""
    path = tmp_path_factory.mktemp("user")
    for file in (*(ROOT / "examples/car").glob("[td]*.*"), shipped("models/tanks.toml")):
        shutil.copy(file, path)
    for number, code in USES:
        (path / f"use_{number}.py").write_text(code)
    return path


def test_there_are_ten_of_ten_lines_at_most():
    assert [int(number) for number, _ in USES] == list(range(1, 11))
    for number, code in USES:
        lines = [line for line in code.splitlines() if line.strip()]
        assert len(lines) <= 10, number
        for node in ast.walk(ast.parse(code)):
            if isinstance(node, ast.Attribute):
                assert not node.attr.startswith("_")
            if isinstance(node, ast.ImportFrom):
                assert "runtime" not in node.module


@pytest.mark.long
def test_each_runs_after_those_before(folder):
    script = "import runpy, sys\nfor k in range(1, 11):\n    runpy.run_path(f'use_{k}.py', run_name='__main__')"
    ended = subprocess.run([sys.executable, "-c", script], cwd=folder, capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr
    said = ended.stdout
    assert "P0336-39" in said  # 4 and 5
    assert "SPEED.SPEED" in said  # 6
    assert re.findall(r"; sees .* (fires|is silent)", said) == ["fires", "is silent", "is silent"]  # 7
    assert re.search(r"missed_pulse +1 ", said)  # 8
    assert "(('valve',), 0.8" in said  # 10


@pytest.mark.full("9 s")
def test_mypy_takes_them_strictly(folder, tmp_path):
    mypy = [sys.executable, "-m", "mypy", "--strict", "--cache-dir", str(tmp_path / "cache")]
    files = [f"use_{number}.py" for number, _ in USES]
    plain = {k: v for k, v in os.environ.items() if not k.startswith("MYPY")}
    ended = subprocess.run([*mypy, *files], cwd=folder, capture_output=True, text=True, check=False, env=plain)
    assert ended.returncode == 0, ended.stdout + ended.stderr
