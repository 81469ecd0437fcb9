"""Formats of logs that other tools read and write, one file a reader: as :mod:`gateway.bus.readers` says.

``blf`` walks over the objects of unpacked containers, ``mf4`` takes groups of channels in bulk from asammdf.
"""

from collections.abc import Callable
from pathlib import Path

from gateway.bus.log_format import LogFormat, Sink
from gateway_logs.formats import writers
from gateway_logs.formats.asc import Asc
from gateway_logs.formats.blf import Blf
from gateway_logs.formats.csv import Csv
from gateway_logs.formats.mf4 import Mf4
from gateway_logs.formats.parquet import Parquet
from gateway_logs.formats.parquet_writer import ParquetWriter
from gateway_logs.formats.trc import Trc


def _numbered(writer: Callable[[Path], Sink]) -> Callable[..., Sink]:
    """Return the writer of a format that has numbers for buses, no names."""
    return lambda path, _: writer(path)


BLF = LogFormat("Vector BLF", Blf, _numbered(writers.BlfWriter), rank=0)
MF4 = LogFormat("ASAM MDF 4", Mf4, _numbered(writers.Mf4Writer), rank=1, extra=("mf4", "MF4 logs"))
PARQUET = LogFormat("Parquet", Parquet, ParquetWriter, rank=2, extra=("parquet", "logs in Parquet"))
TRC = LogFormat("PEAK trace", Trc, _numbered(writers.TrcWriter), rank=3)
ASC = LogFormat("Vector ASC", Asc, _numbered(writers.AscWriter), rank=4)
CSV = LogFormat("CSV", Csv, _numbered(writers.CsvWriter), rank=5)
