"""Databases of a bus for its virtual ECUs: each is read once, and again when its file has changed."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

from gateway.signals.database import Database, load_database


@lru_cache(maxsize=16)
def _read(files: tuple[Path, ...], _changed: tuple[int, ...]) -> Database:
    return load_database(files)


def database_of(files: Sequence[Path]) -> Database:
    """Return the database of a bus, which must not be changed.

    Raises:
        InputError: a file that cannot be read.
    """
    try:
        changed = tuple(file.stat().st_mtime_ns for file in files)
    except OSError:
        return load_database(files)  # says what is wrong
    return _read(tuple(files), changed)
