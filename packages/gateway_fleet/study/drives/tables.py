"""Tables of values as drives: a CSV whose columns are the signals of a machine, and one of which may be the truth.

Each column becomes a message with one 64-bit floating-point signal, so that a table goes the way of any log.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gateway.bus.frames import Frames, empty
from gateway.bus.logs import open_writer
from gateway_fdi.errors import InputError
from gateway_logs.formats.csv import ID, ROLES

#: Names of the columns of time and truth where none are given, in lower case; first identifier; share of the healthy
#: begin of a table with a truth that is learned of.
TIMES, TRUTHS = ("datetime", "timestamp", "time", "t"), ("anomaly", "label", "fault", "attack")
FIRST_ID, LEARNED = 0x100, 2 / 3


@dataclass(frozen=True)
class Columns:
    """Columns of tables that are no signals.

    Attributes:
        time: its name; "": by its name.
        truth: that is not 0 where something is wrong; "": by its name, or none.
        out: names of others.
    """

    time: str = ""
    truth: str = ""
    out: tuple[str, ...] = ()


@dataclass(frozen=True)
class Table:
    """A table.

    Attributes:
        names: of its signals.
        t_ns: times of the rows.
        values: shape (rows, signals), NaN where there is none.
        truth: whether something is wrong, shape (rows,); None: nobody says.
    """

    names: tuple[str, ...]
    t_ns: NDArray[np.int64]
    values: NDArray[np.float64]
    truth: NDArray[np.bool_] | None


def columns_of(texts: Sequence[str]) -> Columns:
    """Return the columns that are named: ``time=NAME``, ``truth=NAME``, ``out=NAME``.

    Raises:
        InputError: a text is none of these.
    """
    found: dict[str, list[str]] = {"time": [], "truth": [], "out": []}
    for text in texts:
        role, equals, name = text.partition("=")
        if role not in found or not equals or not name:
            raise InputError("time=NAME, truth=NAME or out=NAME", key="--column", value=text)
        found[role].append(name)
    return Columns("".join(found["time"][-1:]), "".join(found["truth"][-1:]), tuple(found["out"]))


def is_table(path: Path) -> bool:
    """Return whether a file is a CSV without a column of identifiers: no frames."""
    if path.suffix.lower() != ".csv" or not path.is_file():
        return False
    names = [re.sub(r"[^a-z0-9]", "", name.lower()) for name in _rows(path, 1)[0]]
    return len(names) > 1 and not set(names) & set(ROLES[ID])


def read(path: Path, columns: Columns) -> Table:
    """Read a table.

    Raises:
        InputError: a column that is named is not there; no time; a field that is no number.
    """
    head, *rows = _rows(path)
    lower = [name.lower() for name in head]
    time = _place(path, head, columns.time) if columns.time else _first(lower, TIMES)
    truth = _place(path, head, columns.truth) if columns.truth else _first(lower, TRUTHS)
    left = {time, truth, *(_place(path, head, name) for name in columns.out)}
    signals = [k for k in range(len(head)) if k not in left]
    if time is None or not signals or len(rows) < 2:
        raise InputError("a table has a column of time and others with numbers: --column time=NAME", file=path)
    places = [*signals, *([] if truth is None else [truth])]
    try:
        values = np.array([[float(row[k]) if row[k].strip() else np.nan for k in places] for row in rows])
        t_ns = _times([row[time] for row in rows])
    except (ValueError, IndexError) as error:
        raise InputError(f"this is no table of numbers: {error}", file=path) from error
    marked = None if truth is None else values[:, -1] > 0.0
    return Table(tuple(head[k] for k in signals), t_ns, values[:, : len(signals)], marked)


def _rows(path: Path, most: int | None = None) -> list[list[str]]:
    """Return the lines of a file by their fields."""
    with path.open(newline="", errors="replace") as file:
        first = file.readline()
        file.seek(0)
        reader = csv.reader(file, delimiter=max(";,\t", key=first.count))
        return [[]] if not first else [row for _, row in zip(range(most or 10**9), reader, strict=False) if row]


def _first(names: Sequence[str], wanted: Sequence[str]) -> int | None:
    return next((names.index(name) for name in wanted if name in names), None)


def _place(path: Path, head: Sequence[str], name: str) -> int:
    if name not in head:
        raise InputError(f"no such column, there are {', '.join(head)}", file=path, key="--column", value=name)
    return head.index(name)


def _times(texts: Sequence[str]) -> NDArray[np.int64]:
    """Return times [ns]: of numbers they are seconds, else dates."""
    try:
        return np.rint(np.array([float(text) for text in texts]) * 1e9).astype(np.int64)
    except ValueError:
        return np.array(texts, "datetime64[ns]").astype(np.int64)


def written(table: Table, folder: Path, columns: Columns) -> tuple[Path, Path, Path]:
    """Write a table as a database and two logs: of what is learned of, and of the rest; returns their files.

    With a truth it is learned of a share of what comes before the first row that is marked, else of the first half.

    Raises:
        InputError: nothing is healthy at its begin.
    """
    end = len(table.t_ns) // 2
    if table.truth is not None and table.truth.any():
        end = int(LEARNED * int(table.truth.argmax()))
    paths = folder / "table.dbc", folder / "first.log", folder / "second.log"
    paths[0].write_text(_database(table))
    frames = frames_of(table)
    cut = int(np.searchsorted(frames["t_ns"], table.t_ns[end]))
    if not cut:
        raise InputError("no row to learn of: the first one is marked as wrong", key=columns.truth or "truth")
    for path, part in zip(paths[1:], (frames[:cut], frames[cut:]), strict=True):
        path.unlink(missing_ok=True)
        with open_writer(path) as writer:
            writer.write(part)
    return paths


def frames_of(table: Table) -> Frames:
    """Return the rows of a table as frames, a frame each value that is there."""
    rows, signals = np.nonzero(~np.isnan(table.values))
    frames = empty(len(rows))
    frames["t_ns"], frames["can_id"], frames["length"] = table.t_ns[rows], FIRST_ID + signals, 8
    frames["data"][:, :8] = table.values[rows, signals].astype("<f8")[:, None].view(np.uint8)
    return frames[np.argsort(frames["t_ns"], kind="stable")]


def _database(table: Table) -> str:
    text, kinds, taken = 'VERSION ""\nNS_ :\nBS_:\nBU_: A\n', "", set[str]()
    for k, name in enumerate(table.names):
        called = re.sub(r"[^A-Za-z0-9_]", "_", name) or f"column_{k}"
        called = f"_{called}" if called[0].isdigit() else called
        called = f"{called}_{k}" if called in taken else called
        taken.add(called)
        text += f'BO_ {FIRST_ID + k} {called}: 8 A\n SG_ {called} : 0|64@1- (1,0) [0|0] "" A\n'
        kinds += f"SIG_VALTYPE_ {FIRST_ID + k} {called} : 2;\n"
    return text + kinds
