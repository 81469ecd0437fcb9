"""Logs as tables of signals: Parquet, a table a message, a file a day and log.

``device/message/YYYY/MM/DD/log-digest.parquet``: column ``t`` (UTC, nanoseconds), then the message's signals, null
where a frame has none (multiplexing). That is the layout of the tools around CANedge loggers, whose notebooks and
dashboards read it (https://github.com/CSS-Electronics/canedge-mdftoparquet-automation). A file is written under
another name and renamed when it is complete, so that no reader sees a part of one.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gateway.bus.frames import Frames
from gateway.signals.database import Database
from gateway.signals.decode import OK, TOO_SHORT, UNKNOWN_MUX
from gateway.signals.payloads import are_last, decode_payloads, message_rows, payloads_of
from gateway.signals.tables import DecodePlan, SignalRef, compile_plan
from gateway_fdi.errors import InputError
from gateway_logs.decode.kinds import NAMES, Kind, arrow_type, column, common_kind, kind_of

if TYPE_CHECKING:
    import pyarrow as pa

#: Rows of a message that are gathered before they are decoded and written as a row group.
GROUP = 1 << 17
#: Frames that wait at most before all are written: the memory for a log does not grow with its length.
HELD = 1 << 21
_DAY_NS = 86_400 * 10**9


@dataclass
class Short:
    """Frames of a message that do not have all its signals.

    Attributes:
        count: of them.
        least, most: length of the shortest and longest [byte].
        signals: that one or more of them do not have.
    """

    count: int
    least: int
    most: int
    signals: list[str]


@dataclass
class Written:
    """Result of a log.

    Attributes:
        frames: of it.
        rows: in tables.
        files: that were written.
        foreign: frames of no message of a database.
        short: message -> frames that do not have all its signals, the shortest and longest of them, and these signals.
        unselected: message -> frames whose multiplexer has a value that the database does not describe.
    """

    frames: int = 0
    rows: int = 0
    files: list[Path] = field(default_factory=list)
    foreign: int = 0
    short: dict[str, Short] = field(default_factory=dict)
    unselected: Counter[str] = field(default_factory=Counter)


@dataclass
class _Table:
    """The table of a message while a log is decoded.

    Attributes:
        row: of the message in the plan.
        name: of its folder.
        signals: places among the message's decoded signals, and kinds.
        schema: of its files.
        names: columns that are names.
        held: frames that wait.
        writers: of the days so far.
    """

    row: int
    name: str
    signals: list[tuple[int, Kind]]
    schema: pa.Schema
    names: list[str]
    held: list[Frames] = field(default_factory=list)
    rows: int = 0
    writers: dict[int, Any] = field(default_factory=dict)


class Lake:
    """A folder of tables, by the databases of each bus; ``numbers``: names of values become numbers.

    Raises:
        InputError: two messages with one identity.
    """

    def __init__(
        self, folder: Path, databases: Sequence[Database], *, pgn: Sequence[int] = (), numbers: bool = False
    ) -> None:
        self.folder = folder
        self._databases = databases
        self._numbers = numbers
        self.plan: DecodePlan = compile_plan(list(enumerate(databases)), pgn=pgn)
        self._names = Counter(name for _, name in self.plan.message_names)

    def begin(self, device: str, name: str) -> LogTables:
        """Return what takes the frames of one log of a device, and gives its files this name."""
        return LogTables(self, device, name)

    def table(self, row: int) -> _Table:
        """Return an empty table of a message."""
        import pyarrow as pa  # noqa: PLC0415 - an extra

        bus, name = self.plan.message_names[row]
        signals, fields = [], [pa.field("t", pa.timestamp("ns", "UTC"), nullable=False)]
        own = ["t", "sa"] if self.plan.by_pgn[row] else ["t"]
        if self.plan.by_pgn[row]:
            fields.append(pa.field("sa", pa.uint8(), nullable=False, metadata={"of": "source address"}))
        joined = self._databases[bus].joined(name)
        for called, signal in self._databases[bus].signals(name).items():
            if signal.length > 64:
                continue
            kind = kind_of(signal, numbers=self._numbers)
            if called in joined:
                kind = common_kind(signal, [kind_of(one, numbers=self._numbers) for one in joined[called]])
            signals.append((self.plan.position(*SignalRef(bus, name, called)), kind))
            unit = self.plan.slot_units[self.plan.slot(bus, name, called)]
            fields.append(pa.field(_unlike(called, own), arrow_type(kind), metadata={"unit": unit} if unit else None))
        folder = name if self._names[name] == 1 else f"bus{bus}.{name}"
        # Parquet's own dictionaries of numbers cost more than they save: zstd finds what repeats.
        names = [_unlike(kind.signal.name, own) for _, kind in signals if kind.what == NAMES]
        return _Table(row, folder, signals, pa.schema(fields), names)


def _unlike(name: str, others: Sequence[str]) -> str:
    return f"{name}_" if name in others else name


class LogTables:
    """The tables of one log; files appear when it is finished."""

    def __init__(self, lake: Lake, device: str, name: str) -> None:
        self._lake, self._device, self._name = lake, device, name
        self._tables: dict[int, _Table] = {}
        self._held = 0
        self._paths: dict[Path, Path] = {}
        self.written = Written()

    def add(self, frames: Frames, origin_ns: int = 0) -> None:
        """Take a batch; ``origin_ns``, added to its stamps, makes them wall time."""
        self.written.frames += len(frames)
        if origin_ns:
            frames = frames.copy()
            frames["t_ns"] += origin_ns
        rows = message_rows(frames, self._lake.plan)
        order = np.argsort(rows, kind="stable")
        counts = np.bincount(rows[order] + 1, minlength=1)
        self.written.foreign += int(counts[0])
        ends = np.cumsum(counts)
        for place in np.flatnonzero(counts[1:]).tolist():
            chosen = order[ends[place] : ends[place + 1]]
            table = self._tables.get(place)
            if table is None:
                table = self._tables[place] = self._lake.table(place)
            table.held.append(frames[chosen])
            table.rows += len(chosen)
            self._held += len(chosen)
            if table.rows >= GROUP:
                self._write(table)
        if self._held >= HELD:
            for table in self._tables.values():
                self._write(table)

    def finish(self) -> Written:
        """Write what waits, and give the files their names."""
        for table in self._tables.values():
            self._write(table)
        self._close()
        for part, path in self._paths.items():
            part.replace(path)
            self.written.files.append(path)
        return self.written

    def abandon(self) -> None:
        """Leave nothing of an unfinished log."""
        self._close()
        for part in self._paths:
            part.unlink(missing_ok=True)

    def _close(self) -> None:
        for table in self._tables.values():
            for writer in table.writers.values():
                writer.close()
            table.writers.clear()

    def _write(self, table: _Table) -> None:
        """Decode and write what waits of a message."""
        import pyarrow as pa  # noqa: PLC0415 - an extra

        if not table.rows:
            return
        frames = np.concatenate(table.held)
        self._held -= table.rows
        table.held, table.rows = [], 0
        words, lengths = payloads_of(frames, self._lake.plan, table.row)
        found, frames = decode_payloads(words, lengths, self._lake.plan, table.row), frames[are_last(frames)]
        if (found.results != OK).any():
            self._note(table, found.results, lengths)
        columns = [column(kind, found.values[j], found.there[j], found.words) for j, kind in table.signals]
        if self._lake.plan.by_pgn[table.row]:
            columns.insert(0, pa.array((frames["can_id"] & 0xFF).astype(np.uint8)))
        self._by_day(table, np.ascontiguousarray(frames["t_ns"]), columns)

    def _note(self, table: _Table, results: NDArray[np.uint8], lengths: NDArray[np.int64]) -> None:
        """Keep what is told of frames that do not have all signals of their message."""
        unselected = int((results == UNKNOWN_MUX).sum())
        if unselected:
            self.written.unselected[table.name] += unselected
        short = lengths[results == TOO_SHORT]
        if len(short):
            least, most, count = int(short.min()), int(short.max()), len(short)
            if (before := self.written.short.get(table.name)) is not None:
                least, most, count = min(least, before.least), max(most, before.most), count + before.count
            signals = self._lake.plan.beyond(table.row, least)
            self.written.short[table.name] = Short(count, least, most, signals)

    def _by_day(self, table: _Table, t_ns: NDArray[np.int64], columns: list[pa.Array]) -> None:
        import pyarrow as pa  # noqa: PLC0415 - an extra

        stamps = pa.array(t_ns).cast(pa.timestamp("ns", "UTC"))
        made = pa.Table.from_arrays([stamps, *columns], schema=table.schema)
        self.written.rows += len(t_ns)
        days = t_ns // _DAY_NS
        if days[0] == days[-1] and (days == days[0]).all():
            self._writer(table, int(days[0])).write_table(made)
            return
        for day in np.unique(days).tolist():
            self._writer(table, day).write_table(made.filter(pa.array(days == day)))

    def _writer(self, table: _Table, day: int) -> Any:
        import pyarrow.parquet as pq  # noqa: PLC0415 - an extra

        writer = table.writers.get(day)
        if writer is None:
            date = datetime.fromtimestamp(day * 86_400, UTC)
            folder = self._lake.folder / self._device / table.name / f"{date:%Y/%m/%d}"
            path = folder / f"{self._name}.parquet"
            part = folder / f".{self._name}.parquet.part"
            self._paths[part] = path
            try:
                folder.mkdir(parents=True, exist_ok=True)
                writer = pq.ParquetWriter(
                    part, table.schema, compression="zstd", compression_level=1, use_dictionary=table.names
                )
            except OSError as error:
                raise InputError(f"cannot be written: {error.strerror or error}", file=path) from error
            table.writers[day] = writer
        return writer
