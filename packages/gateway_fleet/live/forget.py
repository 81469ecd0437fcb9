"""Deletion of all data of a car, by its id: tables, inbox, ids, and what the broker keeps for it."""

from __future__ import annotations

import os
import time
from contextlib import closing
from pathlib import Path
from typing import Any

from gateway_fdi.errors import InputError
from gateway_fleet.live.inbox import Inbox
from gateway_fleet.live.tables import TABLES, sync

#: How long a collector is waited for that writes the tables [s].
PATIENCE_S = 30.0


def forget(folder: Path, car: str) -> dict[str, int]:
    """Delete all data of a car; what comes of it later is not kept. Returns how many rows went, by table.

    A file with rows of the car is written again without them, under another name, and renamed.

    Raises:
        InputError: there are no tables, or a file cannot be written.
    """
    import duckdb  # noqa: PLC0415 - slow to load, and an extra

    if not (folder / "inbox.sqlite").exists():
        raise InputError("no tables here (made by gateway fleet collect)", file=folder)
    with closing(Inbox(folder / "inbox.sqlite")) as inbox:  # first: no further row comes into the tables
        gone = {"inbox": inbox.forget(car, time.time_ns())}
        until_s = time.monotonic() + PATIENCE_S
        while inbox.planned() is not None and time.monotonic() < until_s:
            time.sleep(0.1)  # a collector writes them now, with rows that it has read before
    with duckdb.connect() as db:
        for table in TABLES:
            paths = sorted((folder / table).glob("*/[!.]*.parquet"))
            gone[table] = sum(_rewritten(db, path, car) for path in paths)
    return gone


def _rewritten(db: Any, path: Path, car: str) -> int:
    """Write a file again without a car, if it is in it; returns how many rows went."""
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    file, to = (str(each).replace("'", "''") for each in (path, part))
    of = f"read_parquet('{file}')"  # quoted
    (count,) = db.execute(f"SELECT count(*) FROM {of} WHERE car = ?", [car]).fetchone()  # noqa: S608
    if count:
        query = f"COPY (SELECT * FROM {of} WHERE car <> ?) TO '{to}' (FORMAT parquet)"  # noqa: S608
        db.execute(query, [car])
        part.replace(path)
        sync(path)
    return int(count)
