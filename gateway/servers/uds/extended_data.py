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
| 30 | 6 + n causes | what explains it; see :func:`_cause` |
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Iterable, Mapping
from typing import NamedTuple

from gateway.faults.dtc import Dtc
from gateway.faults.entries import Entry
from gateway.faults.explanation import HOLDS, ROLES


def _clipped(value: int) -> bytes:
    return bytes([min(max(value, 0), 255)])


def _time(t_ns: int | None) -> bytes:
    return struct.pack(">q", 0 if t_ns is None else t_ns)


def _numbers(values: Iterable[float | None]) -> bytes:
    return b"".join(struct.pack(">d", math.nan if value is None else value) for value in values)


def _cause(entry: Entry) -> bytes:
    """Return what explains an entry; nothing while it is not known.

    Byte 0: role (0 open, 1 cause, 2 symptom); byte 1: its confirmation (0 as usual, 1 waits, 2 held); bytes 2 to 4: DTC
    of the entry that stands for the cause, 0: none; byte 5: number of causes, the likeliest first. Of each cause: its
    probability in 1/10000, 2 bytes; number of its components (0: a false alarm), 1 byte; of each component the number
    of bytes, 1 byte, and its name in UTF-8, "signal can0.SPEED.SPEED".
    """
    cause = entry.record.cause
    if cause is None and not entry.record.hold:
        return b""
    ranked = () if cause is None else cause.ranked
    role = 0 if cause is None else ROLES.index(cause.role)
    lead = bytes(Dtc.parse(cause.lead_dtc)) if cause is not None and cause.lead_dtc else bytes(3)
    made = bytes([role, HOLDS.index(entry.record.hold)]) + lead + bytes([len(ranked)])
    for components, probability in ranked:
        made += struct.pack(">HB", round(probability * 1e4), min(len(components), 255))
        for name in components[:255]:
            text = name.encode()[:255].decode(errors="ignore").encode()
            made += bytes([len(text)]) + text
    return made


class ExtendedData(NamedTuple):
    """One extended data record: name, struct's code ("": as many bytes as there are values), how it is made."""

    name: str
    code: str
    encode: Callable[[Entry], bytes]

    @property
    def length(self) -> int | None:
        """Its bytes; None: they vary."""
        return struct.calcsize(">" + self.code) or None


#: Extended data records by number.
EXTENDED_DATA: Mapping[int, ExtendedData] = {
    0x01: ExtendedData("occurrence", "B", lambda entry: _clipped(entry.record.occurrence)),
    0x02: ExtendedData("aged_cycles", "B", lambda entry: _clipped(entry.record.aged_cycles)),
    0x03: ExtendedData("peak_fdc", "b", lambda entry: struct.pack(">b", entry.record.peak_fdc)),
    0x04: ExtendedData("failed_cycles", "B", lambda entry: _clipped(entry.record.failed_cycles)),
    0x05: ExtendedData("near_misses", "B", lambda entry: _clipped(entry.record.near_misses)),
    0x10: ExtendedData("first_ns", "q", lambda entry: _time(entry.record.first_ns)),
    0x11: ExtendedData("last_ns", "q", lambda entry: _time(entry.record.last_ns)),
    0x20: ExtendedData("evidence", "", lambda entry: _numbers(entry.record.evidence.values())),
    0x21: ExtendedData("inputs", "", lambda entry: _numbers(entry.record.inputs.values())),
    0x30: ExtendedData("cause", "", _cause),
}
