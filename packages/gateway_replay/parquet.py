"""Parquet files within bounds.

pyarrow takes the memory that each page's header asks for, and as many copies of a text as rows name it: a file of some
kB asks for gigabytes. So the footer and the pages' headers are read first (Apache Parquet, Thrift's compact protocol;
pyarrow's own view of a damaged footer ends the process), and columns of bytes stay dictionaries until the length of
their texts is known.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, BinaryIO

from gateway_fdi.errors import InputError

#: Bytes of the footer, and of a page, unpacked, at most; writers make pages of 1 MiB, few of 8.
FOOTER, PAGE = 1 << 22, 1 << 25
#: Values of a column of lists in a group of rows at most.
VALUES = 1 << 26
#: Bytes of a header that are read at first, and at most: it may hold the least and the greatest value of a page.
_HEADER, _LONGEST_HEADER = 1 << 10, 1 << 22
_MAGIC = b"PAR1"
#: Thrift's types: true and false, byte, whole numbers, double, bytes, list and set, structure.
_TRUE, _FALSE, _BYTE, _WHOLE, _DOUBLE, _BYTES, _LISTS, _STRUCT = 1, 2, 3, (4, 5, 6), 7, 8, (9, 10), 12
#: Fields of the footer: groups of rows; their columns; a column's own data, of these its type, the names of its path,
#: its number of values, its bytes in the file, where its data begin, and where its dictionary does. Apache Parquet,
#: parquet.thrift.
_GROUPS, _COLUMNS, _DATA = 4, 1, 3
_TYPE, _PATH, _COUNT, _SIZE, _BEGIN, _DICTIONARY = 1, 3, 5, 7, 9, 11
_BYTE_ARRAY = 6
#: Fields of a page's header: kind, bytes unpacked, bytes in the file, headers of data pages of both versions.
_KIND, _UNPACKED, _PACKED, _DATA_PAGES = 1, 2, 3, (5, 8)
_OF_DICTIONARY = 2
_DEEPEST = 16


def _varint(data: bytes, at: int) -> tuple[int, int]:
    found, shift = 0, 0
    while True:
        byte = data[at]
        at += 1
        found |= (byte & 0x7F) << shift
        if byte < 0x80:
            return found, at
        shift += 7
        if shift > 63:
            raise ValueError("a number of more than 64 bits")


def _value(data: bytes, at: int, kind: int, depth: int) -> tuple[Any, int]:
    """Return a value, None for a number with a point, and where it ends."""
    if kind == _BYTE:
        return data[at], at + 1
    if kind in _WHOLE:
        found, at = _varint(data, at)
        return (found >> 1) ^ -(found & 1), at
    if kind == _DOUBLE:
        return None, at + 8
    if kind == _BYTES:
        size, at = _varint(data, at)
        return data[at : at + size], at + size
    if kind in _LISTS and depth < _DEEPEST:
        size, inner = data[at] >> 4, data[at] & 0x0F
        size, at = _varint(data, at + 1) if size == 0x0F else (size, at + 1)
        values = []
        for _ in range(size):
            value, at = _value(data, at, _BYTE if inner in (_TRUE, _FALSE) else inner, depth + 1)
            values.append(value)
        return values, at
    if kind == _STRUCT and depth < _DEEPEST:
        return _fields(data, at, depth + 1)
    raise ValueError(f"type {kind} in a header")


def _fields(data: bytes, at: int, depth: int = 0) -> tuple[dict[int, Any], int]:
    """Return the fields of a structure by their numbers, and where it ends.

    Raises:
        IndexError: it goes on beyond the data.
        ValueError: it is none.
    """
    found: dict[int, Any] = {}
    field = 0
    while True:
        head = data[at]
        at += 1
        if not head & 0x0F:
            return found, at
        field += head >> 4
        if not head >> 4:
            field, at = _value(data, at, _WHOLE[0], depth)
        if head & 0x0F in (_TRUE, _FALSE):
            found[field] = head & 0x0F == _TRUE
        else:
            found[field], at = _value(data, at, head & 0x0F, depth)


def _header(source: BinaryIO, at: int) -> tuple[dict[int, Any], int]:
    """Return a page's header, and where its data begin."""
    size = _HEADER
    while True:
        source.seek(at)
        data = source.read(size)
        try:
            fields, end = _fields(data, 0)
            if end <= len(data):
                return fields, at + end
        except IndexError:
            pass
        if size >= _LONGEST_HEADER or len(data) < size:
            raise ValueError("a page's header has no end")
        size <<= 4


def _columns(source: BinaryIO, path: Path) -> Iterator[tuple[str, bool, dict[int, Any]]]:
    """Yield the columns of all groups of rows, by the footer: name, whether it is of lists, its own data.

    Raises:
        InputError: a footer that is too long.
        IndexError, ValueError, TypeError, AttributeError: a damaged one.
    """
    end = source.seek(0, 2)
    source.seek(max(0, end - 8))
    tail = source.read(8)
    if len(tail) < 8 or tail[4:] != _MAGIC:
        return  # pyarrow says so
    (size,) = struct.unpack("<I", tail[:4])
    if size > FOOTER:
        raise InputError(f"a footer of {size} bytes; at most {FOOTER}", file=path)
    source.seek(max(0, end - 8 - size))
    for group in _fields(source.read(size), 0)[0].get(_GROUPS, ()):
        for column in group.get(_COLUMNS, ()):
            data = column[_DATA]
            yield data[_PATH][0].decode(), len(data[_PATH]) > 1, data


def _look(source: BinaryIO, path: Path) -> set[str]:
    """Look at the headers of all pages; returns the columns of bytes that have a dictionary.

    Raises:
        InputError: one asks for more than is allowed.
        IndexError, KeyError, ValueError, TypeError, AttributeError: a damaged one.
    """
    found = set()
    for name, lists, data in _columns(source, path):
        if not data[_COUNT]:
            continue  # pyarrow reads nothing of it
        dictionary = data.get(_DICTIONARY) or 0
        at = dictionary if 0 < dictionary < data[_BEGIN] else data[_BEGIN]
        end, values = at + data[_SIZE], 0
        while at < end:
            fields, at = _header(source, at)
            values += sum(fields.get(one, {}).get(1, 0) for one in _DATA_PAGES)
            if fields[_UNPACKED] > PAGE:
                text = f"column {name} has a page of {fields[_UNPACKED]} bytes, unpacked; at most {PAGE}"
                raise InputError(text, file=path)
            if lists and values > VALUES:
                raise InputError(f"column {name} has more than {VALUES} values in a group of rows", file=path)
            if fields[_PACKED] < 0:
                raise ValueError("a page of less than no bytes")
            at += fields[_PACKED]
            if data[_TYPE] == _BYTE_ARRAY and fields[_KIND] == _OF_DICTIONARY:
                found.add(name)
    return found


def opened(source: BinaryIO, path: Path, columns: Sequence[str] | None = None) -> Any:
    """Return a pyarrow file whose pages may be unpacked; its columns of bytes that have a dictionary stay dictionaries.

    Args:
        source: the open file.
        path: of it, for errors.
        columns: that are read as dictionaries; None: all that can be.

    Raises:
        InputError: a footer or a page that asks for more memory than is allowed, or is damaged.
        pyarrow.ArrowInvalid, OSError: it is no Parquet, or cut off.
    """
    from pyarrow import parquet  # noqa: PLC0415 - slow to load, and an extra

    try:
        texts = _look(source, path)
    except (IndexError, KeyError, ValueError, TypeError, AttributeError) as error:
        raise InputError(f"damaged: a header cannot be read ({type(error).__name__})", file=path) from error
    source.seek(0)
    wanted = sorted(texts if columns is None else texts.intersection(columns))
    return parquet.ParquetFile(source, pre_buffer=False, read_dictionary=wanted)  # noqa: TID251 - the bounded one


def batches(file: Any, path: Path, size: int, longest: int, columns: Sequence[str] | None = None) -> Iterator[Any]:
    """Yield the rows of a file in pieces, their dictionaries as plain columns.

    Args:
        file: of :func:`opened`.
        path: of it, for errors.
        size: rows of a piece at most.
        longest: bytes of a text at most.
        columns: to read; None: all.

    Raises:
        InputError: a longer text.
    """
    import pyarrow as pa  # noqa: PLC0415 - an extra

    for batch in file.iter_batches(size, columns=columns):
        plain = []
        for name, column in zip(batch.schema.names, batch.columns, strict=True):
            if pa.types.is_dictionary(column.type):
                found = longest_of(column)
                if found > longest:
                    raise InputError(f"a text of {found} bytes; at most {longest}", file=path, key=name)
                column = column.dictionary_decode()  # noqa: PLW2901
            plain.append(column)
        yield pa.RecordBatch.from_arrays(plain, names=batch.schema.names)


def longest_of(column: Any) -> int:
    """Return the length of the longest text or bytes in a column of dictionaries."""
    import pyarrow.compute as pc  # noqa: PLC0415 - an extra

    return int(pc.max(pc.binary_length(column.dictionary)).as_py() or 0) if len(column.dictionary) else 0
