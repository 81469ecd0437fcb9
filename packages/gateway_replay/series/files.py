"""Series as files: Parquet in row groups, or CSV; both have the same columns.

    t_ns     int64     wall time [ns]
    monitor  string    name of the monitor or message check, empty for a signal
    kind     string    fault: value and limit of its test; quantity: of a monitor; signal; dtc: it was set, or healed
    name     string    of the fault, quantity, signal; of a DTC code and fault
    value    float64   in its unit; of a DTC the status byte
    limit    float64   what the value is held against, empty (NaN) where there is none
    result   string    of a test: passed, failed, not tested; of a DTC: set, healed; else empty
    unit     string

A row is there where something changed. Rows are in order of time.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gateway.common.extras import need
from gateway_fdi.errors import InputError
from gateway_replay.parquet import batches, opened
from gateway_replay.series.rows import GROUP, RESULTS, Rows, Series, Sink

COLUMNS = ("t_ns", "monitor", "kind", "name", "value", "limit", "result", "unit")
SUFFIXES = (".parquet", ".csv")
#: Bytes of a name at most.
_LONGEST = 1024


def _checked(path: Path, key: str) -> str:
    """Return the suffix of a file of series.

    Raises:
        InputError: it is of no such kind; its package is not installed.
    """
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise InputError(f"series are {' or '.join(SUFFIXES)}", key=key, value=str(path))
    if suffix == ".parquet":
        need("parquet", "Parquet files", key=key)
    return suffix


def open_series(path: Path, *, key: str) -> Sink:
    """Return what writes a file.

    Raises:
        InputError: another suffix, a package that is missing, a file that cannot be written.
    """
    made = _Parquet if _checked(path, key) == ".parquet" else _Csv
    try:
        return made(path)
    except OSError as error:
        raise InputError(f"cannot be written: {error.strerror or error}", key=key, value=str(path)) from error


class _Csv:
    def __init__(self, path: Path) -> None:
        self._file = path.open("w", encoding="utf-8", newline="")
        self._rows = csv.writer(self._file)
        self._rows.writerow(COLUMNS)

    def write(self, rows: Rows, series: Sequence[Series]) -> None:
        columns = (rows.t_ns, rows.series, rows.value, rows.limit, rows.result)
        for t, k, value, limit, result in zip(*(column.tolist() for column in columns), strict=True):
            s = series[k]
            self._rows.writerow((t, s.monitor, s.kind, s.name, _number(value), _number(limit), RESULTS[result], s.unit))

    def close(self) -> None:
        self._file.close()


def _number(value: float) -> str:
    return "" if math.isnan(value) else repr(value)


class _Parquet:
    def __init__(self, path: Path) -> None:
        import pyarrow as pa  # noqa: PLC0415 - slow to load, and an extra
        from pyarrow import parquet  # noqa: PLC0415

        self._pa = pa
        words = pa.dictionary(pa.int32(), pa.string())
        types = (pa.int64(), words, words, words, pa.float64(), pa.float64(), words, words)
        self._schema = pa.schema(list(zip(COLUMNS, types, strict=True)))
        self._writer = parquet.ParquetWriter(path, self._schema, compression="zstd")

    def _words(self, places: Any, words: Sequence[str]) -> Any:
        return self._pa.DictionaryArray.from_arrays(self._pa.array(places, self._pa.int32()), self._pa.array(words))

    def write(self, rows: Rows, series: Sequence[Series]) -> None:
        pa = self._pa
        columns = [pa.array(rows.t_ns)]
        of_series = {name: [getattr(s, name) for s in series] for name in ("monitor", "kind", "name", "unit")}
        each: dict[str, Any] = {}
        for name, words in of_series.items():
            known = list(dict.fromkeys(words))
            place = np.array([known.index(word) for word in words], np.int32)
            each[name] = self._words(place[rows.series], known)
        columns += [each["monitor"], each["kind"], each["name"]]
        columns += [pa.array(x, pa.float64(), mask=np.isnan(x)) for x in (rows.value, rows.limit)]
        columns += [self._words(rows.result.astype(np.int32), RESULTS), each["unit"]]
        self._writer.write_table(pa.Table.from_arrays(columns, schema=self._schema), row_group_size=GROUP)

    def close(self) -> None:
        self._writer.close()


def read_series(path: Path, *, key: str) -> Iterator[tuple[Rows, list[Series]]]:
    """Yield the rows of a file, some at a time, with the list of series, which only grows.

    Raises:
        InputError: it cannot be read, or has other columns.
    """
    parts = _parquet_batches(path) if _checked(path, key) == ".parquet" else _csv_batches(path)
    known: dict[Series, int] = {}
    numbers = {name: k for k, name in enumerate(RESULTS)}
    try:
        for batch in parts:
            t, monitor, kind, name, value, limit, result, unit = batch
            keys = [Series(*parts) for parts in zip(monitor, kind, name, unit, strict=True)]
            places = [known.setdefault(one, len(known)) for one in keys]
            yield (
                Rows(
                    np.array(t, np.int64), np.array(places, np.int32), np.array(value, np.float64),
                    np.array(limit, np.float64), np.array([numbers[word] for word in result], np.int8),
                ),
                list(known),
            )  # fmt: skip
    except (OSError, ValueError, KeyError) as error:
        text = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        raise InputError(f"no file of series, as gateway replay --signals writes them: {text}", file=path) from error


def _parquet_batches(path: Path) -> Iterator[list[list[Any]]]:
    with path.open("rb") as source, opened(source, path) as file:
        for batch in batches(file, path, GROUP, _LONGEST, list(COLUMNS)):
            if batch.num_columns != len(COLUMNS):
                raise ValueError(f"its columns are {', '.join(file.schema_arrow.names)}")
            columns = [batch.column(name).to_pylist() for name in COLUMNS]
            for k in (4, 5):
                columns[k] = [math.nan if x is None else x for x in columns[k]]
            yield columns


def _csv_batches(path: Path) -> Iterator[list[list[Any]]]:
    with path.open(encoding="utf-8", newline="") as file:
        reader = csv.reader(file)
        if tuple(next(reader, ())) != COLUMNS:
            raise ValueError(f"its columns are not {', '.join(COLUMNS)}")
        rows: list[list[Any]] = []
        for row in reader:
            t, monitor, kind, name, value, limit, result, unit = row
            rows.append([int(t), monitor, kind, name, float(value or "nan"), float(limit or "nan"), result, unit])
            if len(rows) == GROUP:
                yield [list(column) for column in zip(*rows, strict=True)]
                rows = []
        if rows:
            yield [list(column) for column in zip(*rows, strict=True)]
