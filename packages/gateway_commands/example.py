"""``gateway example``: one of the shipped example folders, to be tried and changed."""

from __future__ import annotations

import shutil
from pathlib import Path

from gateway.cli.present import print_json
from gateway.common.trust import add_own
from gateway_fdi.common.resources import shipped
from gateway_fdi.errors import InputError

#: Files that a run of an example leaves in its folder.
_LEFT = shutil.ignore_patterns("__pycache__", ".*", "*.sqlite*", "left")


def example(name: str | None, folder: Path | None, *, json: bool) -> int:
    """Copy an example, or list all; returns the exit code.

    Raises:
        InputError: there is no example of this name; the folder is there already.
    """
    known = {place.name: place for place in sorted(shipped("examples").iterdir()) if (place / "README.md").is_file()}
    if name is None:
        about = {
            each: (place / "README.md").read_text().partition("\n")[0].lstrip("# ") for each, place in known.items()
        }
        print_json({"examples": about}) if json else print(
            "\n".join(f"{each:16} {text}" for each, text in about.items())
        )
        return 0
    if name not in known:
        raise InputError(f"no such example; there are: {', '.join(known)}", key="NAME", value=name)
    place = folder or Path(name)
    if place.exists() and (not place.is_dir() or any(place.iterdir())):
        raise InputError("this is there already; nothing was written", value=str(place))
    shutil.copytree(known[name], place, dirs_exist_ok=True, ignore=_LEFT)
    add_own(place.rglob("*.py"))
    files = sorted(path.relative_to(place).as_posix() for path in place.rglob("*") if path.is_file())
    print_json({"folder": str(place), "files": files}) if json else print(f"{place}: {', '.join(files)}")
    return 0
