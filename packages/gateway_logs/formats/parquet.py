"""Frame logs in Parquet: a row a frame.

=============  ==========================================================================================
column         what
=============  ==========================================================================================
``t``          UTC: timestamp of any unit, or whole nanoseconds since 1970 (int64)
``id``         identifier without flags, a whole number
``data``       payload: binary, or a list of bytes
``extended``   boolean; missing: identifiers above 0x7FF are
``fd``         boolean; missing: payloads above 8 bytes are
``channel``    text, or a number; missing or null: none
``remote``, ``error``, ``brs``, ``esi``, ``own``  boolean; missing: false
=============  ==========================================================================================

The first three must be there. The footer is at the file's end: one that is cut off cannot be read at all.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from gateway.bus.frames import BRS, ERROR, ESI, EXTENDED, FD, ID_MASK, OWN, REMOTE, Frames, empty
from gateway.bus.log_source import CutOffError, compression_of
from gateway.bus.readers.batch import FormatReader, Names, Read, bytes_of, flags_of
from gateway.bus.readers.scan import scatter
from gateway.common.archives import whole
from gateway_fdi.errors import InputError, nearest
from gateway_replay.parquet import longest_of, opened

#: Columns that must be there, and those that may be.
NEEDED = ("t", "id", "data")
FLAGS_OF_ID = {"extended": EXTENDED, "remote": REMOTE, "error": ERROR}
FLAGS = {"fd": FD, "brs": BRS, "esi": ESI, "own": OWN}
#: Columns that are no numbers.
_OTHERS = ("t", "data", "channel")
_MAGIC = b"PAR1"
#: Bytes of a payload at most.
MOST = 64


def is_frame_log(path: Path) -> bool:
    """Return whether a Parquet file has the columns of frames, and not those of signals or anything else."""
    from pyarrow import ArrowException  # noqa: PLC0415 - an extra

    try:
        with path.open("rb") as source:
            return set(NEEDED) <= set(opened(source, path).schema_arrow.names)
    except (OSError, ArrowException, InputError):
        return path.stem.endswith(".frames")  # as we name them; its errors are told when it is read


class Parquet(FormatReader):
    """Reads Parquet (see :class:`gateway.bus.readers.batch.Reader`)."""

    @staticmethod
    def sniff(first: bytes) -> bool:
        """Return whether a log begins as Parquet does."""
        return first.startswith(_MAGIC)

    def read(self, stream: BinaryIO, names: Names, chunk: int) -> Iterator[Read]:
        """Yield a log's frames."""
        import pyarrow as pa  # noqa: PLC0415 - an extra

        source = whole(stream, self._path) if compression_of(self._path) else stream
        head = source.read(4)
        if head != _MAGIC and head:
            raise InputError("not a Parquet file: it does not begin with PAR1", file=self._path)
        source.seek(0)
        frames = 0
        try:
            file = opened(source, self._path, ("data", "channel"))
        except (pa.ArrowInvalid, OSError) as error:
            text = "cut off: its footer, which says where all is, is missing" if head else "no frame: the file is empty"
            raise CutOffError(text, file=self._path) from error
        with file:
            columns = self._columns(file.schema_arrow)
            for batch in file.iter_batches(batch_size=chunk, columns=columns):
                taken = self._frames({name: batch.column(name) for name in columns}, frames)
                yield taken, _channels(batch, len(taken), names)
                frames += len(taken)

    def _columns(self, schema: Any) -> list[str]:
        """Return the columns that are read.

        Raises:
            InputError: one that must be there is missing, or has another type.
        """
        has = list(schema.names)
        for name in NEEDED:
            if name not in has:
                known = f"it has {', '.join(has[:12])}{', ...' if len(has) > 12 else ''}"
                text = f"no such column; a log of frames has {', '.join(NEEDED)}, {known}{nearest(name, has)}"
                raise InputError(text, file=self._path, key=name)
        told = {"t": "a timestamp, or int64 nanoseconds", "id": "a whole number", "channel": "text or a whole number"}
        told["data"] = "binary, or a list of bytes"
        found = [name for name in (*NEEDED, "channel", *FLAGS_OF_ID, *FLAGS) if name in has]
        for name in found:
            kind = schema.field(name).type
            if not _fits(name, kind):
                text = f"this column is {told.get(name, 'boolean')}"
                raise InputError(text, file=self._path, key=name, value=str(kind))
        return found

    def _frames(self, columns: Mapping[str, Any], before: int) -> Frames:
        """Return the frames of a batch of columns."""
        for name in columns:
            if name != "channel" and columns[name].null_count:
                row = before + int(np.flatnonzero(columns[name].is_null().to_numpy(zero_copy_only=False))[0])
                raise InputError(f"no value in row {row}", file=self._path, key=name)
        values = {name: columns[name].to_numpy(zero_copy_only=False) for name in columns if name not in _OTHERS}
        ids = values["id"]
        if len(wrong := np.flatnonzero((ids < 0) | (ids > ID_MASK))):
            text, value = f"no identifier, in row {before + wrong[0]}: 0 to 0x1FFFFFFF", int(ids[wrong[0]])
            raise InputError(text, file=self._path, key="id", value=value)
        frames = empty(len(ids))
        frames["t_ns"] = self._times(columns["t"])
        self._put_payloads(frames, columns["data"], before)
        values = {"extended": ids > 0x7FF, "fd": frames["length"] > 8} | values
        frames["can_id"] = ids.astype(np.uint32) | flags_of(values, FLAGS_OF_ID, len(ids))
        frames["flags"] = flags_of(values, FLAGS, len(ids))
        return frames

    def _times(self, column: Any) -> NDArray[np.int64]:
        """Return stamps [ns].

        Raises:
            InputError: they are beyond the years that 64 bits of nanoseconds hold.
        """
        import pyarrow as pa  # noqa: PLC0415 - an extra

        try:
            if pa.types.is_timestamp(column.type):
                column = column.cast(pa.timestamp("ns", column.type.tz)).cast(pa.int64())
        except pa.ArrowInvalid as error:
            raise InputError(" ".join(str(error).split()), file=self._path, key="t") from error
        found: NDArray[np.int64] = column.to_numpy(zero_copy_only=False)
        return found

    def _put_payloads(self, frames: Frames, column: Any, before: int) -> None:
        """Put payloads into frames.

        Raises:
            InputError: one is longer than 64 bytes.
        """
        import pyarrow as pa  # noqa: PLC0415 - an extra

        kind = column.type
        if pa.types.is_dictionary(kind) and (longest := longest_of(column)) > MOST:
            import pyarrow.compute as pc  # noqa: PLC0415

            long = pc.greater(pc.binary_length(column.dictionary), MOST).take(column.indices)
            row = before + int(pc.index(long, True).as_py())
            raise InputError(f"a payload above 64 bytes, in row {row}", file=self._path, key="data", value=longest)
        if pa.types.is_list(kind) or pa.types.is_large_list(kind):
            ends = column.offsets.to_numpy()
            if column.values.null_count:
                raise InputError("a payload has bytes without a value", file=self._path, key="data")
            raw = column.values.to_numpy(zero_copy_only=False)
        else:
            column = column.cast(pa.large_binary())
            _, places, content = column.buffers()
            ends = np.frombuffer(places, np.int64)[column.offset :][: len(column) + 1]
            raw = np.frombuffer(content, np.uint8) if content is not None else np.zeros(0, np.uint8)
        ends = ends.astype(np.int64)
        counts = np.diff(ends)
        long = scatter(raw, ends[:-1], counts, bytes_of(frames))
        if long >= 0:
            text = f"a payload above 64 bytes, in row {before + long}"
            raise InputError(text, file=self._path, key="data", value=int(counts[long]))
        frames["length"] = counts


def _fits(name: str, kind: Any) -> bool:
    """Return whether a column may be of a type of pyarrow."""
    from pyarrow import types  # noqa: PLC0415 - an extra

    if name == "t":
        return bool(types.is_timestamp(kind) or types.is_int64(kind))
    if name == "id":
        return bool(types.is_integer(kind))
    if name not in ("data", "channel"):
        return bool(types.is_boolean(kind))
    if name == "data" and (types.is_list(kind) or types.is_large_list(kind)):
        return bool(types.is_uint8(kind.value_type))
    plain = kind.value_type if types.is_dictionary(kind) else kind
    if name == "channel":
        return bool(types.is_string(plain) or types.is_large_string(plain) or types.is_integer(plain))
    fixed = types.is_fixed_size_binary(plain) and plain.byte_width <= MOST
    return bool(fixed or types.is_binary(plain) or types.is_large_binary(plain))


def _channels(batch: Any, count: int, names: Names) -> NDArray[np.int64]:
    """Return the places of the frames' channels among the names."""
    import pyarrow as pa  # noqa: PLC0415 - an extra

    if "channel" not in batch.schema.names:
        return np.full(count, names.place("none"), np.int64)
    column = batch.column("channel")
    if not pa.types.is_dictionary(column.type):
        column = column.dictionary_encode()
    used = column.indices.fill_null(-1).to_numpy(zero_copy_only=False)
    known = column.dictionary.to_pylist()
    places = np.zeros(len(known) + 1, np.int64)  # the last one: of those without a channel
    for place in np.unique(used).tolist():
        places[place] = names.place("none" if place < 0 or known[place] is None else str(known[place]))
    found: NDArray[np.int64] = places[used]
    return found
