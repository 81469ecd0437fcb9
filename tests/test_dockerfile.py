"""What the Dockerfile copies is all that its wheel is made of. Without a container engine: the wheel is made here."""

import re
import shutil
import subprocess
import sys
from pathlib import Path
from zipfile import ZipFile

import pytest

ROOT = Path(__file__).parent.parent


def matches(pattern, path):
    """Return whether a pattern of .dockerignore matches a path, or a folder that it lies in; both from the root."""
    parts = (re.escape(part).replace(r"\*", "[^/]*") if part != "**" else "**" for part in pattern.split("/"))
    text = "/".join(parts).replace("**/", "(?:.*/)?").replace("/**", "/.*")
    return re.fullmatch(f"{text}(?:/.*)?", path) is not None


def ignored(path):
    patterns = (ROOT / ".dockerignore").read_text().split()
    assert not any(pattern.startswith(("!", "#")) for pattern in patterns)  # unknown here
    return any(matches(pattern, path) for pattern in patterns)


def copied():
    """Return the sources and the targets of the COPY lines of the stage that builds, below its work folder."""
    build = (ROOT / "Dockerfile").read_text().split("\nFROM ")[1]
    lines = re.findall(r"^COPY (.*)$", build, re.M)
    assert lines
    assert not any(line.startswith("--") for line in lines)
    return [(source, target) for line in lines for *sources, target in [line.split()] for source in sources]


def test_the_wheel_is_made_of_what_is_copied(tmp_path):
    tracked = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True).stdout.split(
        "\n"
    )
    for source, target in copied():
        files = [file for file in tracked if file == source or file.startswith(f"{source}/")]
        assert files, f"COPY {source}: there is no such thing"
        for file in files:
            assert not ignored(file), f".dockerignore keeps {file} out"
            place = Path(target) / Path(file).name if file == source else Path(target) / Path(file).relative_to(source)
            (tmp_path / place).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(ROOT / file, tmp_path / place)
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", "made"]
    made = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert made.returncode == 0, made.stderr
    (wheel,) = (tmp_path / "made").glob("*.whl")
    names = set(ZipFile(wheel).namelist())
    assert {file.removeprefix("packages/") for file in tracked if file.startswith(("gateway/", "packages/"))} <= names
    for folder in ("dbc", "scenarios", "examples"):
        assert {f"gateway/shipped/{file}" for file in tracked if file.startswith(f"{folder}/")} <= names
    assert "gateway/shipped/gateway.toml" in names


@pytest.mark.parametrize(
    "path",
    [
        "gateway/bus/__pycache__/frames.cpython-311.pyc",
        "examples/car/faults.sqlite",
        "examples/car/faults.sqlite-wal",
        "examples/bench/left/too_early/can.log",
        "examples/bench/.pytest_cache/v/cache/nodeids",
        "faults.sqlite",
        ".venv/bin/python",
        ".git/HEAD",
    ],
)
def test_what_work_leaves_behind_is_not_in_the_image(path):
    assert ignored(path)
