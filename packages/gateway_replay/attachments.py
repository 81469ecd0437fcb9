"""Files that belong to a test, as lines in its output that continuous integration reads.

Jenkins (plugin junit-attachments) and Azure take ``[[ATTACHMENT|/absolute/path]]``, each on a line of its own; GitLab
the same with a path relative to its project's folder, which it says in CI_PROJECT_DIR.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path


def attachments(files: Iterable[Path]) -> str:
    """Return the lines for some files, "" for none."""
    return "\n".join(f"[[ATTACHMENT|{_shown(file.absolute())}]]" for file in files)


def _shown(file: Path) -> Path:
    project = os.environ.get("CI_PROJECT_DIR")
    if project and file.is_relative_to(Path(project).absolute()):
        return file.relative_to(Path(project).absolute())
    return file
