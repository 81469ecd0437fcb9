"""``gateway trust``: let code run that lies beside configurations, scenarios and models."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from gateway.common import trust as trusted
from gateway_fdi.errors import InputError


def trust(files: Sequence[Path], *, system: bool) -> int:
    """Trust files of code as they are now, and the modules beside them that they import; returns the exit code."""
    into = trusted.SYSTEM if system else trusted.user_list()
    if into is None:
        raise InputError("this system has no list for every user", key="--system")
    if not files:
        for name, path in trusted.entries(into).items():
            print(f"{name}  {path}")
        return 0
    for file in files:
        if file.suffix == ".toml":
            raise InputError("trust is for code, not for what names it: gateway check says which file it is", file=file)
    chosen = dict.fromkeys(one for file in files for one in trusted.reachable(file))
    for name, file in trusted.add(chosen, into):
        print(f"trusted: {file} ({name[:12]})")
    print(f"in {into}: asked again when a file changes")
    return 0
