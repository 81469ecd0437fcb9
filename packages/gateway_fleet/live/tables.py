"""Tables of a fleet on the road: a folder of Parquet, a file an hour in each, which DuckDB reads as it is.

==========  ======================================================================================================
table       a row
==========  ======================================================================================================
``events``  an event of a car: its id (origin, number), when, by whose limits, its kind, what is asked for most; and all
            of it as JSON, but for statistics
``tests``   how far a test went in a drive: its block maxima (the largest, a t-digest of the others)
==========  ======================================================================================================

Files are named by the hour in which their rows came and by the first of them, written under another name and renamed.
A collector that was killed writes them again, with the same rows under the same names.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterable, Mapping
from itertools import accumulate
from pathlib import Path
from typing import Any

from gateway.runtime.contract import STATISTICS
from gateway_fdi.errors import InputError
from gateway_fleet.fleet.verdicts import Row, write_table
from gateway_fleet.live.inbox import Inbox
from gateway_fleet.live.inbox import Row as Kept

#: Table -> its columns, as of :func:`gateway_fleet.fleet.verdicts.write_table`.
TABLES: dict[str, dict[str, str]] = {
    "events": {
        "car": "text", "model": "text", "software": "text", "origin": "text", "number": "count", "t": "time",
        "received": "time", "limits": "count", "kind": "text", "fault": "text", "dtc": "text", "status": "count",
        "causes": "texts", "seconds": "number", "body": "text",
    },
    "tests": {
        "car": "text", "model": "text", "software": "text", "begin": "time", "t": "time", "limits": "count",
        "condition": "text", "fault": "text", "sign": "count", "limit": "number", "block_s": "number",
        "blocks": "count", "failed": "count", "values": "numbers", "weights": "numbers",
    },
}  # fmt: skip


def export(inbox: Inbox, folder: Path, hour: str) -> list[Path]:
    """Put all that waits in an inbox into the tables; returns the files.

    Args:
        inbox: of the collector.
        folder: of the tables.
        hour: as ``2026-11-29/07``, of files that are begun now; those that a kill has left have their own.

    Raises:
        InputError: a file cannot be written; all of it stays in the inbox.
    """
    written: list[Path] = []
    for new in (False, True):  # what a kill has left, then what has come since
        if new:
            inbox.plan(hour)
        planned = inbox.planned()
        if planned is None:
            continue
        first, last, of = planned
        rows = inbox.rows(first, last)
        for table, made in (("events", map(event_row, rows)), ("tests", (r for row in rows for r in test_rows(row)))):
            written += _write(folder, table, of, first, list(made))
        inbox.done(first, last)
    return written


def prepare(folder: Path) -> None:
    """Make the folders, each table with a file, so that all can be asked for rows.

    Raises:
        InputError: they cannot be made.
    """
    try:
        for table, columns in TABLES.items():
            (folder / table / "none").mkdir(parents=True, exist_ok=True)
            empty = folder / table / "none" / "none.parquet"
            if not empty.exists():
                write_table(empty, columns, [])
    except OSError as error:
        raise InputError(f"cannot be written: {error.strerror or error}", file=folder) from error


def _write(folder: Path, table: str, hour: str, first: int, rows: list[Row]) -> list[Path]:
    if not rows:
        return []
    day, _, name = hour.partition("/")
    place = folder / table / day
    place.mkdir(parents=True, exist_ok=True)
    path = place / f"{name}-{first:012d}.parquet"
    write_table(path, TABLES[table], rows)
    sync(path)
    return [path]


def sync(path: Path) -> None:
    """Have a file, and its name, be on the disk."""
    for each in (path, path.parent):
        file = os.open(each, os.O_RDONLY)
        try:
            os.fsync(file)
        finally:
            os.close(file)


def event_row(row: Kept) -> Row:
    """Return the row of an event."""
    event = json.loads(row.body)
    t_ns, statistics = event.get("t_ns"), event["event"] == "statistics"
    return {
        "car": row.car, "model": row.model, "software": row.software, "origin": row.origin, "number": row.number,
        "t": t_ns if type(t_ns) is int else row.received_ns, "received": row.received_ns, "limits": row.limits,
        "kind": event["event"], "fault": _text(event, "fault"), "dtc": _text(event, "dtc"),
        "status": _count(event, "status"), "causes": proven(event), "seconds": _seconds(event),
        "body": None if statistics else row.body,
    }  # fmt: skip


def _plain(text: str) -> str:
    """Return a text without halves of characters, which JSON may have."""
    return text.encode("utf-8", "replace").decode()


def _text(event: dict[str, Any], name: str) -> str | None:
    value = event.get(name)
    return _plain(value) if isinstance(value, str) else None


def _count(event: dict[str, Any], name: str) -> int | None:
    value = event.get(name)
    return value if type(value) is int else None


def _seconds(event: dict[str, Any]) -> float | None:
    """Return the time driven that a first part of a drive's statistics stands for [s]."""
    return float(event["seconds"]) if event["event"] == "statistics" and event["part"] == 0 else None


def proven(event: Mapping[str, Any]) -> list[str] | None:
    """Return the causes that a diagnosis has proven, each a text; None: it is no diagnosis."""
    if event["event"] != "diagnosis":
        return None
    causes = [group.get("cause") for group in event["groups"]]
    return sorted(_plain(" + ".join(map(str, cause))) for cause in causes if isinstance(cause, list) and cause)


def test_rows(row: Kept) -> Iterable[Row]:
    """Yield the rows of a drive's statistics; a test that makes no sense is left out."""
    event = json.loads(row.body)
    of = event["tests"] if event["event"] == "statistics" else {}
    columns = [each if isinstance(each := of.get(name), list) else [] for name in STATISTICS]
    for fault, sign, limit, failed, unit, values, weights in zip(*columns, strict=False):
        try:
            whole = [_whole(weight) for weight in weights]
            if min(whole) < 1:
                raise ValueError(weights)
            yield {
                "car": row.car, "model": row.model, "software": row.software, "begin": event["begin_ns"],
                "t": event["t_ns"], "limits": row.limits,
                "condition": _plain(event["condition"]), "fault": _plain(str(fault)), "sign": _whole(sign),
                "limit": None if limit is None else _number(limit), "block_s": float(event["block_s"]),
                "blocks": sum(whole), "failed": _whole(failed),
                "values": [_number(math.ldexp(each, _whole(unit))) for each in accumulate(map(_whole, values))],
                "weights": [float(weight) for weight, _ in zip(whole, values, strict=True)],
            }  # fmt: skip
        except (KeyError, TypeError, ValueError, OverflowError):
            continue  # it came of the right kind: its row among the events tells that there was one


def _number(value: Any) -> float:
    """Return a finite number.

    Raises:
        ValueError, TypeError, OverflowError: it is none.
    """
    if not math.isfinite(found := float(value)):
        raise ValueError(value)
    return found


def _whole(value: Any) -> int:
    if type(value) is not int or abs(value) >= 2**53:
        raise ValueError(value)
    return value
