"""Version and commit of a build, and the code that a program writes, for hatchling.

The version is that of ``gateway/__init__.py``: at a tag ``v<version>``, and where there is no git; a tag that says
another one is refused. At any other commit it is ``<version>.dev0+g<commit>``, with ``.dirty`` where files are changed.
Neither tags nor history are needed. The commit goes into the file ``COMMIT`` of the sdist, and from there, or from
git, into the wheel. Residual generators are written from their model into the checkout, an editable installation's too.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface
from hatchling.metadata.plugin.interface import MetadataHookInterface

_DIGITS = 12


def _git(root: Path, *arguments: str) -> str:
    """Return what git says of the checkout at a folder; "": it is none, has no commit, or there is no git."""
    if not (root / ".git").exists():  # a folder above it may be another checkout
        return ""
    try:
        command = ["git", *arguments]
        ended = subprocess.run(command, cwd=root, capture_output=True, text=True, check=False)  # noqa: S603
    except FileNotFoundError:
        return ""
    return "" if ended.returncode else ended.stdout.strip()


def commit_of(root: Path) -> str:
    """Return the commit of a checkout or an sdist, "" if it is not known."""
    kept = root / "COMMIT"
    found = _git(root, "rev-parse", f"--short={_DIGITS}", "HEAD")
    return found or (kept.read_text().strip() if kept.exists() else "")


def version_of(root: Path) -> str:
    """Return the version of a checkout.

    Raises:
        ValueError: a tag of its commit says another one.
    """
    found = re.search(r'^__version__ = "(.*)"$', (root / "gateway" / "__init__.py").read_text(), re.MULTILINE)
    assert found is not None
    version, commit = found[1], _git(root, "rev-parse", f"--short={_DIGITS}", "HEAD")
    tags = _git(root, "tag", "--points-at", "HEAD", "--list", "v[0-9]*").split()
    if tags and f"v{version}" not in tags:
        raise ValueError(f"tag {', '.join(tags)}, but gateway/__init__.py has __version__ = {version!r}")
    dirty = ".dirty" if _git(root, "status", "--porcelain", "--untracked-files=no") else ""
    return version if not commit or (tags and not dirty) else f"{version}.dev0+g{commit}{dirty}"


def write_generated(root: Path) -> None:
    """Write the modules that models of plants give, where they are not there (residual_generators.py of a plant)."""
    path = os.pathsep.join(filter(None, (str(root / "packages"), os.environ.get("PYTHONPATH"))))
    for file in sorted(root.glob("packages/gateway_plants/*/residual_generators.py")):
        command = [sys.executable, "-m", f"gateway_plants.{file.parent.name}.residual_generators"]
        subprocess.run(command, cwd=root, env={**os.environ, "PYTHONPATH": path}, check=True)  # noqa: S603 - our own


class Version(MetadataHookInterface):
    """Sets the version; that of an sdist stands in its PKG-INFO already."""

    PLUGIN_NAME = "custom"

    def update(self, metadata: dict[str, Any]) -> None:
        """Set it."""
        metadata.setdefault("version", version_of(Path(self.root)))


class Commit(BuildHookInterface[Any]):
    """Puts the commit into sdist and wheel, and generated code into the wheel."""

    PLUGIN_NAME = "custom"

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Add the file; not to an editable installation, which asks git."""
        if self.target_name == "wheel":
            write_generated(Path(self.root))
        commit = commit_of(Path(self.root))
        if commit and version != "editable":
            self._folder = tempfile.TemporaryDirectory()
            file = Path(self._folder.name) / "COMMIT"
            file.write_text(f"{commit}\n")
            place = "COMMIT" if self.target_name == "sdist" else "gateway/shipped/COMMIT"
            build_data["force_include"][str(file)] = place
