"""Paths as a caller gives them."""

from __future__ import annotations

from os import PathLike, fspath
from pathlib import Path
from typing import TypeAlias

from gateway_fdi.common import resources
from gateway_fdi.errors import InputError

#: A path, as text or as an object.
Pathish: TypeAlias = "str | PathLike[str]"


def path_of(path: object, key: str, wanted: str = "a path") -> Path:
    """Return a path.

    Args:
        path: as the caller gave it.
        key: name of the argument.
        wanted: what it may be, for the error.

    Raises:
        InputError: it is none.
    """
    if not isinstance(path, str | PathLike):
        raise InputError(f"{wanted}; this is {type(path).__name__}", key=key, value=path)
    return Path(fspath(path))


def paths_of(paths: object, key: str) -> list[Path]:
    """Return a list of paths; a text alone would be taken letter by letter.

    Raises:
        InputError: it is no list, or has something else in it.
    """
    if isinstance(paths, str | PathLike) or not hasattr(paths, "__iter__"):
        raise InputError("a list of paths", key=key, value=paths)
    return [path_of(path, f"{key}[{k}]") for k, path in enumerate(paths)]


def shipped(name: str) -> Path:
    """Return the path of a file that comes with the gateway, as ``"models/tanks.toml"``.

    Raises:
        InputError: there is none.
    """
    return resources.shipped(name)
