"""Extended data records of a DTC (ISO 14229-1, 0x19 06), which ``gateway faults export`` describes too.

| record | bytes | what |
|---|---|---|
| 01 | 1 | occurrences, up to 255 |
| 02 | 1 | aging cycles counted |
| 03 | 1 | greatest fault detection counter since the clear, signed |
| 04 | 1 | failed operation cycles in a row |
| 05 | 1 | near misses, up to 255 |
| 10 | 8 | first failure, ns of the frames' clock, signed |
| 11 | 8 | latest failure, likewise |
| 20 | 16 + 8 n | evidence of the latest failure: value, threshold, and the n values that the monitor names, float64 |
| 21 | 8 n | inputs of the monitor at the latest failure, float64 |
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Iterable, Mapping
from typing import NamedTuple

from gateway.faults.entries import Entry


def _clipped(value: int) -> bytes:
    return bytes([min(max(value, 0), 255)])


def _time(t_ns: int | None) -> bytes:
    return struct.pack(">q", 0 if t_ns is None else t_ns)


def _numbers(values: Iterable[float | None]) -> bytes:
    return b"".join(struct.pack(">d", math.nan if value is None else value) for value in values)


class ExtendedData(NamedTuple):
    """One extended data record: name, bytes (None: as many as there are values), how it is made."""

    name: str
    length: int | None
    encode: Callable[[Entry], bytes]


#: Extended data records by number.
EXTENDED_DATA: Mapping[int, ExtendedData] = {
    0x01: ExtendedData("occurrence", 1, lambda entry: _clipped(entry.occurrence)),
    0x02: ExtendedData("aged_cycles", 1, lambda entry: _clipped(entry.aged_cycles)),
    0x03: ExtendedData("peak_fdc", 1, lambda entry: struct.pack(">b", entry.peak_fdc)),
    0x04: ExtendedData("failed_cycles", 1, lambda entry: _clipped(entry.failed_cycles)),
    0x05: ExtendedData("near_misses", 1, lambda entry: _clipped(entry.near_misses)),
    0x10: ExtendedData("first_ns", 8, lambda entry: _time(entry.first_ns)),
    0x11: ExtendedData("last_ns", 8, lambda entry: _time(entry.last_ns)),
    0x20: ExtendedData("evidence", None, lambda entry: _numbers(entry.evidence.values())),
    0x21: ExtendedData("inputs", None, lambda entry: _numbers(entry.inputs.values())),
}
