"""deploy/requirements.lock: what a deployment installs, by hashes, fits what pyproject.toml asks for."""

import importlib.machinery
import importlib.util
import re
import tomllib
from pathlib import Path

import pytest
from packaging.version import Version

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]


@pytest.fixture(scope="module")
def lock():
    loader = importlib.machinery.SourceFileLoader("lock", str(ROOT / "scripts" / "lock"))
    made = importlib.util.module_from_spec(importlib.util.spec_from_loader("lock", loader))
    loader.exec_module(made)
    return made


@pytest.fixture(scope="module")
def text():
    return (ROOT / "deploy" / "requirements.lock").read_text()


@pytest.mark.evidence("Releases: lock")
def test_every_package_has_a_version_and_hashes_and_fits_the_project(lock, text):
    assert lock.wrong(text, PROJECT) == []
    found = lock.entries(text)
    assert len(found) >= 60
    assert found["starlette"][0] >= Version("0.49.1"), "CVE-2025-62727"
    assert found["hatchling"], "what builds the package is locked, too"


def test_it_names_no_index(text):
    assert not re.search(r"://|--index|--find|@|localhost", text)


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        (r"numpy==\S+", "numpy==1.26.4", "numpy 1.26.4 is not >=2.0"),
        (r"starlette==\S+", "starlette==0.41.0", "starlette 0.41.0 is not >=0.49.1"),
        (r"\ncantools==", "\nanother==", "cantools is missing"),
    ],
)
def test_what_does_not_fit_is_told(lock, text, old, new, told):
    assert told in lock.wrong(re.sub(old, new, text), PROJECT)


@pytest.mark.parametrize("wrong", ["numpy>=2.0\n", "numpy==2.0\n", "-e .\n", "numpy @ https://example.org/x.whl\n"])
def test_a_line_without_version_or_hashes_is_refused(lock, text, wrong):
    with pytest.raises(ValueError, match="no package with version and hashes"):
        lock.entries(text + wrong)


def test_the_image_is_made_with_it():
    image = (ROOT / "Dockerfile").read_text()
    assert "--require-hashes -r deploy/requirements.lock" in image
    assert image.count("pip --python") == 2
    assert "--no-deps --no-build-isolation ." in image, "nothing beside the lock is installed"
