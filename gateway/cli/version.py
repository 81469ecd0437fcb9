"""``gateway --version``: version and commit."""

from __future__ import annotations

import subprocess
from pathlib import Path

import gateway


def version() -> str:
    """Return the version; with the commit in brackets, where it is known: of a built package, or of a checkout."""
    package = Path(gateway.__file__).parent
    kept = package / "shipped" / "COMMIT"
    commit = kept.read_text().strip() if kept.is_file() else ""
    if not commit and (package.parent / ".git").exists():
        ask = ["git", "describe", "--always", "--dirty", "--abbrev=12", "--exclude=*"]
        try:
            commit = subprocess.run(  # noqa: S603 - fixed words
                ask, cwd=package.parent, capture_output=True, text=True, check=False
            ).stdout.strip()
        except FileNotFoundError:  # no git
            commit = ""
    return gateway.__version__ + (f" ({commit})" if commit else "")
