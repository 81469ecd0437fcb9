"""Writes frame logs in Parquet (see ``readers.parquet``): DuckDB, pandas and Spark read them directly."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from gateway.bus.frames import ID_MASK, Frames
from gateway_logs.formats.parquet import FLAGS, FLAGS_OF_ID

#: Frames of a row group: the part of a log that is held while it is written or read.
GROUP = 1 << 17


class ParquetWriter:
    """Writes a frame log; it can be read once it is closed. ``interfaces``: name of each bus."""

    def __init__(self, path: Path, interfaces: Mapping[int, str] | None = None) -> None:
        import pyarrow as pa  # noqa: PLC0415 - an extra, slow to load
        import pyarrow.parquet as pq  # noqa: PLC0415

        self._interfaces = interfaces or {}
        fields = [
            pa.field("t", pa.timestamp("ns", "UTC"), nullable=False),
            pa.field("id", pa.uint32(), nullable=False),
            pa.field("extended", pa.bool_(), nullable=False),
            pa.field("fd", pa.bool_(), nullable=False),
            pa.field("channel", pa.dictionary(pa.int32(), pa.string())),
            pa.field("data", pa.binary(), nullable=False),
            *(pa.field(name, pa.bool_(), nullable=False) for name in ("remote", "error", "brs", "esi", "own")),
        ]
        self._schema = pa.schema(fields)
        # Stamps nearly all differ: a dictionary of them is built for nothing.
        dictionaries = [name for name in self._schema.names if name != "t"]
        self._file = path.open("wb")
        self._writer = pq.ParquetWriter(
            self._file, self._schema, compression="zstd", compression_level=1, use_dictionary=dictionaries
        )
        self._held: list[Frames] = []
        self._count = 0

    def write(self, frames: Frames) -> None:
        """Append a batch."""
        self._held.append(frames.copy())
        self._count += len(frames)
        if self._count >= GROUP:
            self._flush()

    def _flush(self) -> None:
        import pyarrow as pa  # noqa: PLC0415 - an extra

        if not self._count:
            return
        frames = np.concatenate(self._held)
        self._held, self._count = [], 0
        buses, places = np.unique(frames["bus"], return_inverse=True)
        names = [self._interfaces.get(bus, f"can{bus}") for bus in buses.tolist()]
        lengths = frames["length"].astype(np.int32)
        ends = np.append(np.int32(0), np.cumsum(lengths, dtype=np.int32))
        width = int(lengths.max(initial=0))
        raw = frames["data"][:, :width][np.arange(width) < lengths[:, None]]
        buffers = [None, pa.py_buffer(ends), pa.py_buffer(raw.tobytes())]
        columns: dict[str, Any] = {
            "t": pa.array(np.ascontiguousarray(frames["t_ns"])).cast(pa.timestamp("ns", "UTC")),
            "id": pa.array(frames["can_id"] & ID_MASK),
            "channel": pa.DictionaryArray.from_arrays(pa.array(places.astype(np.int32)), pa.array(names, pa.string())),
            "data": pa.Array.from_buffers(pa.binary(), len(frames), buffers),
        }
        columns |= {name: pa.array(frames["can_id"] & flag != 0) for name, flag in FLAGS_OF_ID.items()}
        columns |= {name: pa.array(frames["flags"] & flag != 0) for name, flag in FLAGS.items()}
        self._writer.write_table(pa.table([columns[name] for name in self._schema.names], schema=self._schema))

    def close(self) -> None:
        """Finish the file."""
        self._flush()
        self._writer.close()
        self._file.close()
