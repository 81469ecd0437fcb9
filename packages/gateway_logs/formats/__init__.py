"""Formats of logs that other tools read and write, one file a reader: as :mod:`gateway.bus.readers` says.

``blf`` walks over the objects of unpacked containers, ``mf4`` takes groups of channels in bulk from asammdf.
"""

from gateway.bus.log_format import LogFormat
from gateway_logs.formats import writers
from gateway_logs.formats.asc import Asc
from gateway_logs.formats.blf import Blf
from gateway_logs.formats.csv import Csv
from gateway_logs.formats.mf4 import Mf4
from gateway_logs.formats.parquet import Parquet
from gateway_logs.formats.parquet_writer import ParquetWriter
from gateway_logs.formats.trc import Trc

BLF = LogFormat("Vector BLF", Blf, writers.BlfWriter, rank=0)
MF4 = LogFormat("ASAM MDF 4", Mf4, writers.Mf4Writer, rank=1, extra=("mf4", "MF4 logs"))
PARQUET = LogFormat("Parquet", Parquet, ParquetWriter, rank=2, extra=("parquet", "logs in Parquet"))
TRC = LogFormat("PEAK trace", Trc, writers.TrcWriter, rank=3)
ASC = LogFormat("Vector ASC", Asc, writers.AscWriter, rank=4)
CSV = LogFormat("CSV", Csv, writers.CsvWriter, rank=5)
