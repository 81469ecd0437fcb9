"""The notebooks run, in Jupyter, on the wheel as it is installed, three a commit; they are kept without outputs."""

import json
import os
import subprocess
import sys
from pathlib import Path
from zipfile import ZipFile

import pytest
from amount import FULL

ROOT = Path(__file__).parents[2]
NOTEBOOKS = sorted((ROOT / "examples/notebooks").glob("*.ipynb"))


def test_they_are_kept_without_outputs_and_listed():
    page = (ROOT / "docs/api.md").read_text()
    assert len(NOTEBOOKS) == 8
    for path in NOTEBOOKS:
        assert f"`{path.name}`" in page
        for cell in json.loads(path.read_text())["cells"]:
            assert not cell.get("outputs")
            assert not cell.get("execution_count")
            assert "_" not in {name[:1] for line in cell["source"] for name in line.split(".")[1:]}


@pytest.mark.full("7 s")
def test_they_run_on_the_wheel(tmp_path):
    build = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(tmp_path / "made")]
    subprocess.run(build, cwd=ROOT, capture_output=True, check=True)
    (wheel,) = (tmp_path / "made").glob("*.whl")
    ZipFile(wheel).extractall(tmp_path / "installed")
    code = 'import gateway, gateway_fdi; print(gateway.__file__, gateway_fdi.__file__, sep="\\n")'
    environment = {**os.environ, "PYTHONPATH": str(tmp_path / "installed"), "OPENBLAS_NUM_THREADS": "1"}
    environment |= {"JUPYTER_PLATFORM_DIRS": "1", "IPYTHONDIR": str(tmp_path / "ipython")}
    found = subprocess.check_output([sys.executable, "-c", code], cwd=tmp_path, env=environment, text=True)
    assert all(line.startswith(str(tmp_path)) for line in found.split())
    some = NOTEBOOKS if FULL else NOTEBOOKS[:1]
    options = ["--nbmake", "--nbmake-timeout=60", "-p", "no:xdist", "-p", "no:cacheprovider", "-p", "no:gateway", "-q"]
    command = [sys.executable, "-m", "pytest", *options, "-c", os.devnull, "--rootdir", str(ROOT), *map(str, some)]
    ended = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stdout[-5000:] + ended.stderr[-2000:]
    assert f"{len(some)} passed" in ended.stdout
