"""Databases of virtual ECUs: of their bus, read again when a file has changed, and those that are shipped."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache, lru_cache
from pathlib import Path

from cantools.database.can import Message

from gateway.signals.database import Database, load_database
from gateway_fdi.common.resources import shipped


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


@cache
def message_of(file: str, name: str) -> Message:
    """Return a message of a shipped database."""
    return load_database([shipped(file)]).message(name)
