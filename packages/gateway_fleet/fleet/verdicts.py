"""Files of a fleet's run: tables of verdicts as Parquet, and the finished work.

==========  ======================================================================================================
table       a row
==========  ======================================================================================================
``logs``    a log: whose, when, how many frames, what state, distance driven, DTCs
``dtcs``    a DTC of a log: status at the end, first and last failure, occurrences, proven cause, evidence
``tests``   a test of a log: results, the nearest to a failure (``ratio``, 1 at the limit), near misses
``events``  a change of a DTC's status in a log, in order
``errors``  what was wrong with a log: damaged, cut off, empty, foreign, failed, killed its worker, a copy
==========  ======================================================================================================

While a run goes on, a log has a file in each table, named by the digest of its contents; at its end all of them become
one file, ``all.parquet``. Files are written under another name and renamed; that in ``logs`` comes last, and says that
the others are there. So a file written twice is the same, and no reader gets a part of one. A kill may leave a log both
in a file of its own and in ``all.parquet``: it counts once. Nothing in the tables depends on when, where or how fast
they were made.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gateway_fdi.errors import InputError
from gateway_logs.corpus import DIGITS, Recording
from gateway_replay.parquet import batches, opened

if TYPE_CHECKING:
    import pyarrow as pa

#: Rows that are read at once, and bytes of a text at most.
_ROWS, _LONGEST = 1000, 1 << 16
#: How often a reader looks again while a run takes files away.
_LOOKS = 10
_TIME, _TEXT, _COUNT, _NUMBER = "time", "text", "count", "number"

#: Table -> its columns.
TABLES: dict[str, dict[str, str]] = {
    "logs": {
        "log": _TEXT, "device": _TEXT, "path": _TEXT, "state": _TEXT, "begin": _TIME, "end": _TIME,
        "seconds": _NUMBER, "frames": _COUNT, "decoded": _COUNT, "left_out": _COUNT, "km": _NUMBER, "dtcs": _COUNT,
    },
    "dtcs": {
        "log": _TEXT, "device": _TEXT, "dtc": _TEXT, "fault": _TEXT, "status": _COUNT, "first": _TIME, "last": _TIME,
        "occurrence": _COUNT, "failed_cycles": _COUNT, "cause": _TEXT, "probability": _NUMBER, "role": _TEXT,
        "evidence": _TEXT,
    },
    "tests": {
        "log": _TEXT, "device": _TEXT, "dtc": _TEXT, "fault": _TEXT, "results": _COUNT, "failed": _COUNT,
        "ratio": _NUMBER, "worst": _NUMBER, "limit": _NUMBER, "worst_t": _TIME, "low": _NUMBER, "high": _NUMBER,
        "near_misses": _COUNT, "peak_fdc": _COUNT, "monitor": _TEXT, "tested": _TEXT,
    },
    "events": {
        "log": _TEXT, "device": _TEXT, "n": _COUNT, "t": _TIME, "dtc": _TEXT, "fault": _TEXT, "status": _COUNT,
        "occurrence": _COUNT,
    },
    "errors": {"log": _TEXT, "device": _TEXT, "path": _TEXT, "kind": _TEXT, "text": _TEXT},
}  # fmt: skip

Row = dict[str, Any]

#: Names of files in a table that are no log: the rows of all earlier logs; no rows.
ALL, _NONE = "all", "none"
_NO_LOG = (ALL, _NONE)


@dataclass
class Verdict:
    """The rows of one log, by table."""

    logs: list[Row] = field(default_factory=list)
    dtcs: list[Row] = field(default_factory=list)
    tests: list[Row] = field(default_factory=list)
    events: list[Row] = field(default_factory=list)
    errors: list[Row] = field(default_factory=list)


def _schema(columns: Mapping[str, str]) -> pa.Schema:
    import pyarrow as pa  # noqa: PLC0415 - an extra

    types = {_TIME: pa.timestamp("ns", "UTC"), _TEXT: pa.string(), _COUNT: pa.int64(), _NUMBER: pa.float64()}
    types |= {f"{kind}s": pa.list_(types[kind]) for kind in (_TEXT, _NUMBER)}
    return pa.schema([pa.field(name, types[kind]) for name, kind in columns.items()])


def write_table(path: Path, columns: Mapping[str, str], rows: Sequence[Row]) -> None:
    """Write a file that is there whole or not at all.

    Args:
        path: of the file.
        columns: name -> "time", "text", "count", "number", or "texts", "numbers" for lists.
        rows: of the table.

    Raises:
        InputError: it cannot be written.
    """
    import pyarrow as pa  # noqa: PLC0415 - an extra

    write_rows(path, pa.Table.from_pylist(list(rows), schema=_schema(columns)))


def write_rows(path: Path, rows: pa.Table) -> None:
    """Write a file of Arrow's rows, as :func:`write_table` does.

    Raises:
        InputError: it cannot be written.
    """
    import pyarrow.parquet as pq  # noqa: PLC0415 - an extra

    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        pq.write_table(rows, part)
        part.replace(path)
    except OSError as error:
        part.unlink(missing_ok=True)
        raise InputError(f"cannot be written: {error.strerror or error}", file=path) from error


class Verdicts:
    """A folder of verdicts."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._logs: frozenset[str] | None = None

    def prepare(self) -> None:
        """Make the folders, each table with a file, so that all can be asked for rows.

        Raises:
            InputError: they cannot be made.
        """
        try:
            for table, columns in TABLES.items():
                (self.folder / table).mkdir(parents=True, exist_ok=True)
                empty = self.folder / table / f"{_NONE}.parquet"
                if not empty.exists():
                    write_table(empty, columns, [])
        except OSError as error:
            raise InputError(f"cannot be written: {error.strerror or error}", file=self.folder) from error

    def path(self, table: str, log: str) -> Path:
        """Return the file of a log in a table."""
        return self.folder / table / f"{log}.parquet"

    def has(self, log: str) -> bool:
        """Return whether a log has its verdict."""
        return self.path("logs", log).exists() or log in self._together()

    def _together(self) -> frozenset[str]:
        """Return the logs of ``all.parquet``, as it was first looked at."""
        if self._logs is None:
            self._logs = frozenset(row["log"] for row in self.rows("logs", ALL))
        return self._logs

    def _rewrite(self, table: str, without: Collection[str], more: Sequence[Path] = ()) -> None:
        """Write ``all.parquet`` of a table again, with the rows of files and without those of some logs."""
        import pyarrow as pa  # noqa: PLC0415 - an extra
        import pyarrow.compute as pc  # noqa: PLC0415 - an extra

        path = self.path(table, ALL)
        left_out = pa.array(without, pa.string())
        before = _batches([path] if path.exists() else [])
        kept = [rows.filter(pc.invert(pc.is_in(rows["log"], left_out))) for rows in before]
        rows = pa.Table.from_batches([*kept, *_batches(more)], _schema(TABLES[table]))
        write_rows(path, rows.take(pc.sort_indices(rows["log"])))

    def put_together(self) -> None:
        """Make one file of those of single logs in each table: thousands of files are slow to ask.

        Rows of a copy stay by themselves: they are told again when a recording goes.
        """
        logs = [path.stem for path in self._files("logs") if path.stem not in _NO_LOG]
        for table in (*(name for name in TABLES if name != "logs"), "logs"):
            mine = [path for log in sorted(logs) if (path := self.path(table, log)).exists()]
            if mine or (logs and self.path(table, ALL).exists()):
                self._rewrite(table, logs, mine)
        self._logs = None
        for table in TABLES:  # those in `logs` first: what has no row there is taken away the next time
            for path in self._files(table):
                if path.stem in self._together():
                    path.unlink()

    def _files(self, table: str) -> list[Path]:
        return sorted((self.folder / table).glob("[!.]*.parquet"))

    def write(self, log: str, verdict: Verdict) -> None:
        """Write a log's rows; those in ``logs`` come last."""
        if log in self._together():
            self.forget([log])
        for table in (*(name for name in TABLES if name != "logs"), "logs"):
            rows = getattr(verdict, table)
            path = self.path(table, log)
            if rows:
                write_table(path, TABLES[table], rows)
            else:
                path.unlink(missing_ok=True)

    def forget(self, logs: Collection[str]) -> None:
        """Take the rows of logs away."""
        for table in TABLES:
            for log in logs:
                self.path(table, log).unlink(missing_ok=True)
            if not self._together().isdisjoint(logs) and self.path(table, ALL).exists():
                self._rewrite(table, logs)
        self._logs = None

    def name(self, log: str, recording: Recording) -> None:
        """Have a log's rows name a recording with its contents."""
        rows = self.rows("logs", log)
        if not rows or (rows[0]["path"], rows[0]["device"]) == (str(recording.path), recording.device):
            return
        before = rows[0]["path"]
        verdict = Verdict(**{table: self.rows(table, log) for table in TABLES})
        for table, columns in TABLES.items():
            for row in getattr(verdict, table):
                row["device"] = recording.device
                if "path" in columns:
                    row["path"] = str(recording.path)
                if "text" in columns:
                    row["text"] = row["text"].replace(before, str(recording.path))
        self.write(log, verdict)

    def write_copy(self, recording: Recording, log: str, first: Recording | None) -> None:
        """Write that a recording has the contents of another one, which is judged; None: it has not."""
        path = self.path("errors", hashlib.sha256(f"copy {recording.path}".encode()).hexdigest()[:DIGITS])
        if first is None:
            path.unlink(missing_ok=True)
            return
        text = f"the same contents as {first.path}: counted once"
        write_table(path, TABLES["errors"], error_rows(log, recording, "copy", [text]))

    def rows(self, table: str, log: str | None = None) -> list[Row]:
        """Return the rows of a table, of one log or of all, in order of their logs; times in nanoseconds.

        A run that puts files together meanwhile takes some away: it is looked again, and all rows are in the new one.

        Raises:
            InputError: there is no such table here.
        """
        for _ in range(_LOOKS):
            with suppress(FileNotFoundError):
                return self._rows(table, log)
        return self._rows(table, log)

    def _rows(self, table: str, log: str | None) -> list[Row]:
        import pyarrow as pa  # noqa: PLC0415 - an extra

        folder = self.folder / table
        if not folder.is_dir():
            raise InputError("no verdicts here (made by gateway fleet run --out)", file=self.folder)
        paths = self._files(table) if log is None else sorted({self.path(table, log), self.path(table, ALL)})
        paths = [path for path in paths if path.exists()]
        single = {path.stem for path in paths}
        found: list[Row] = []
        for path in paths:
            for batch in _batches([path]):
                columns = {
                    name: (column.cast(pa.int64()) if pa.types.is_timestamp(column.type) else column).to_pylist()
                    for name, column in zip(batch.schema.names, batch.columns, strict=True)
                }
                rows = (dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True))
                if path.stem == ALL:  # not twice those of a log that has its own file
                    rows = (row for row in rows if row["log"] not in single and log in (None, ALL, row["log"]))
                found += rows
        return found


def _batches(paths: Iterable[Path]) -> Iterator[pa.RecordBatch]:
    """Yield the rows of files in pieces."""
    for path in paths:
        with path.open("rb") as source, opened(source, path) as file:
            yield from batches(file, path, _ROWS, _LONGEST)


@dataclass(frozen=True)
class Done:
    """Entry of the manifest for a recording.

    Attributes:
        files: name, size [byte] and time of change [ns] of each of its files.
        log: digest of its contents.
        state: of it.
    """

    files: tuple[tuple[str, int, int], ...]
    log: str
    state: str


def signature(recording: Recording) -> tuple[tuple[str, int, int], ...]:
    """Return name, size [byte] and time of change [ns] of a recording's files.

    Raises:
        InputError: one cannot be looked at.
    """
    found = []
    for path in recording.files:
        try:
            facts = path.stat()
        except OSError as error:
            raise InputError(error.strerror or str(error), file=path) from error
        found.append((path.name, facts.st_size, facts.st_mtime_ns))
    return tuple(found)


class Manifest:
    """Which recordings have been done, and by what configuration; a line of JSON each."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._path = folder / "manifest.jsonl"
        self.done: dict[str, Done] = {}
        self._before = ""  # ends a line that a kill has cut
        if self._path.exists():
            text = self._path.read_text(encoding="utf-8")
            self._before = "" if text.endswith("\n") or not text else "\n"
            for line in text.splitlines():
                self._take(line)

    def _take(self, line: str) -> None:
        try:
            row = json.loads(line)
            files = tuple((str(name), int(size), int(t_ns)) for name, size, t_ns in row["files"])
            self.done[row["path"]] = Done(files, row["log"], row["state"])
        except (ValueError, KeyError, TypeError):
            return  # a line that a kill has cut; its recording is looked at again

    def paths(self, log: str) -> list[str]:
        """Return the recordings with these contents."""
        return [path for path, done in self.done.items() if done.log == log]

    def add(self, path: Path, done: Done, more: Mapping[str, Any]) -> None:
        """Note that a recording has been done."""
        self.done[str(path)] = done
        row = {"path": str(path), "log": done.log, "state": done.state, **more, "files": done.files}
        with self._path.open("a", encoding="utf-8") as file:
            file.write(self._before + json.dumps(row) + "\n")
        self._before = ""

    def agree(self, setup: Mapping[str, Any]) -> None:
        """Note with what these verdicts are made, or see that it is the same as before.

        Raises:
            InputError: it is not.
        """
        path = self._folder / "run.json"
        if path.exists():
            before = json.loads(path.read_text(encoding="utf-8"))
            differing = [name for name in setup if before.get(name) != setup[name]]
            if differing:
                told = ", ".join(f"{name} {before.get(name)}, now {setup[name]}" for name in differing)
                raise InputError(f"these verdicts are of another run ({told}); take another --out", file=path)
            return
        part = path.with_name(f".run.json.{os.getpid()}.part")
        part.write_text(json.dumps(dict(setup), indent=2) + "\n", encoding="utf-8")
        part.replace(path)

    def setup(self) -> dict[str, Any]:
        """Return with what these verdicts were made.

        Raises:
            InputError: there are none.
        """
        path = self._folder / "run.json"
        if not path.exists():
            raise InputError("no verdicts here (made by gateway fleet run --out)", file=self._folder)
        found: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        return found


def error_rows(log: str, recording: Recording, kind: str, texts: Iterable[str]) -> list[Row]:
    """Return what was wrong with a log, a row each."""
    return [
        {"log": log, "device": recording.device, "path": str(recording.path), "kind": kind, "text": text}
        for text in texts
    ]
