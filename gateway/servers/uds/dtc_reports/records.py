"""Freeze frames and extended data records, by DTC and by number."""

from __future__ import annotations

from collections.abc import Sequence

from gateway.faults.entries import Entry
from gateway.servers.uds.context import Context
from gateway.servers.uds.dtc_reports.common import ALL_RECORDS, available, entry_of_dtc, with_status
from gateway.servers.uds.extended_data import EXTENDED_DATA
from gateway.servers.uds.nrc import Nrc, refuse_unless

#: The greatest number of a record; above are "all" and reserved ones.
MOST_RECORDS = 0xFE

#: Data identifiers with their bytes.
Identified = Sequence[tuple[int, bytes]]


def snapshot_identification(c: Context, _rest: bytes) -> bytes:
    """03 reportDTCSnapshotIdentification."""
    return b"".join(
        bytes(entry.dtc) + bytes([number]) for entry in c.memory.entries() for number, _ in _frames(c, entry)
    )


def _frames(c: Context, entry: Entry) -> list[tuple[int, Identified]]:
    """Return the freeze frames of an entry that hold anything: number, identifiers with their bytes."""
    found = [(frame.number, c.identifiers.freeze_frame(frame.content)) for frame in entry.freeze_frames]
    return [(number, content) for number, content in found if content]


def record_of(number: int, content: Identified) -> bytes:
    """Return a record of identifiers: its number, how many they are, each with its bytes."""
    return bytes([number]) + content_of(content)


def content_of(content: Identified) -> bytes:
    """Return how many identifiers there are, and each with its bytes."""
    return bytes([len(content)]) + b"".join(did.to_bytes(2, "big") + data for did, data in content)


def snapshot_by_dtc(c: Context, rest: bytes) -> bytes:
    """04 reportDTCSnapshotRecordByDTCNumber."""
    entry, record = entry_of_dtc(c, rest[:3]), rest[3]
    most = c.memory.definition(entry.fault).freeze_frames
    refuse_unless(1 <= record <= most or record == ALL_RECORDS, Nrc.REQUEST_OUT_OF_RANGE)
    made = with_status(c, [entry.listed])
    for number, content in _frames(c, entry):
        if record in (number, ALL_RECORDS):
            made += record_of(number, content)
    return made


def stored_data(c: Context, rest: bytes) -> bytes:
    """05 reportDTCStoredDataByRecordNumber: the first freeze frames, numbered in the order of the failures."""
    record = rest[0]
    refuse_unless(1 <= record <= MOST_RECORDS or record == ALL_RECORDS, Nrc.REQUEST_OUT_OF_RANGE)
    frames = [(entry, frames[0][1]) for entry in c.memory.in_order("first_failed") if (frames := _frames(c, entry))]
    made = b"".join(
        bytes([number]) + with_status(c, [entry.listed]) + content_of(content)
        for number, (entry, content) in enumerate(frames[:MOST_RECORDS], start=1)
        if record in (number, ALL_RECORDS)
    )
    return made or rest


def extended_data(c: Context, rest: bytes) -> bytes:
    """06 reportDTCExtDataRecordByDTCNumber."""
    c.memory.fold_statistics()
    c.memory.commit()
    entry, record = entry_of_dtc(c, rest[:3]), rest[3]
    refuse_unless(record in EXTENDED_DATA or record == ALL_RECORDS, Nrc.REQUEST_OUT_OF_RANGE)
    made = with_status(c, [entry.listed])
    if not entry.record.occurrence:
        return made
    for number, kind in EXTENDED_DATA.items():
        data = kind.encode(entry)
        if data and record in (number, ALL_RECORDS):
            made += bytes([number]) + data
    return made


def extended_by_record(c: Context, rest: bytes) -> bytes:
    """16 reportDTCExtDataRecordByRecordNumber: one record of every DTC that has it."""
    c.memory.fold_statistics()
    c.memory.commit()
    made = rest
    for entry, data in _having(c, rest[0]):
        made += with_status(c, [entry.listed]) + data
    return made


def _having(c: Context, record: int) -> list[tuple[Entry, bytes]]:
    """Return the entries that have an extended data record, with its bytes."""
    refuse_unless(record in EXTENDED_DATA, Nrc.REQUEST_OUT_OF_RANGE)
    encode = EXTENDED_DATA[record].encode
    found = [(entry, encode(entry)) for entry in c.memory.entries()]
    return [(entry, data) for entry, data in found if data]


def extended_identification(c: Context, rest: bytes) -> bytes:
    """1A reportDTCExtendedDataRecordIdentification: the DTCs that have a record."""
    return available(c) + rest + with_status(c, (entry.listed for entry, _ in _having(c, rest[0])))
