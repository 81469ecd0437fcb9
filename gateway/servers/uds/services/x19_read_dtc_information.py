"""0x19 ReadDTCInformation (ISO 14229-1, 11.3): everything that the fault memory knows.

DTCs are in the format of SAE J2012-DA with failure type byte (format identifier 0x00, in WWH-OBD 0x04); their order
is that of their codes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import get_args

from gateway.faults.dtc import Dtc
from gateway.faults.entries import Entry
from gateway.faults.settings import Readiness
from gateway.servers.uds.context import ANY_SESSION, Context, Service
from gateway.servers.uds.extended_data import EXTENDED_DATA
from gateway.servers.uds.intervention_memory import SELECTION, InterventionMemory
from gateway.servers.uds.nrc import NegativeError, Nrc, refuse_unless

#: DTCFormatIdentifier: SAE J2012-DA with failure type byte.
FORMAT = 0x00
#: The same in WWH-OBD.
WWH_FORMAT = 0x04
ALL_RECORDS = 0xFF
#: The greatest number of a record; above are "all" and what is reserved.
MOST_RECORDS = 0xFE
#: Readiness groups by number: in the order of the configuration's names (J1979-DA has numbers that are not public).
READINESS_GROUPS = dict(enumerate(get_args(Readiness), start=1))
#: Functional groups of WWH-OBD (ISO 27145-3): emission system, all of them.
EMISSION_GROUP, ALL_GROUPS = 0x33, 0xFF
#: Bits of the severity byte that are filled: severity and class.
SEVERITY_MASK = 0xFF

#: Data identifiers with their bytes.
Identified = Sequence[tuple[int, bytes]]
#: Handler of one sub-function: takes what follows the sub-function, returns what follows its echo.
Report = Callable[[Context, bytes], bytes]


def _status(c: Context, entry: Entry) -> int:
    return int(entry.status) & c.params.status_mask


def _matching(c: Context, mask: int) -> list[Entry]:
    """Return the DTCs with any of the bits set that are both asked for and shown."""
    return [entry for entry in c.memory.supported() if _status(c, entry) & mask]


def _with_status(c: Context, entries: Iterable[Entry]) -> bytes:
    return b"".join(bytes(entry.dtc) + bytes([_status(c, entry)]) for entry in entries)


def _available(c: Context) -> bytes:
    return bytes([c.params.status_mask])


def _number(c: Context, entries: list[Entry]) -> bytes:
    return _available(c) + bytes([FORMAT]) + len(entries).to_bytes(2, "big")


def _entry(c: Context, dtc: bytes) -> Entry:
    for entry in c.memory.supported():
        if bytes(entry.dtc) == dtc:
            return entry
    raise NegativeError(Nrc.REQUEST_OUT_OF_RANGE)


def _severity(c: Context, entry: Entry) -> int:
    return c.memory.definition(entry.fault).severity


def _number_by_status(c: Context, rest: bytes) -> bytes:
    """01 reportNumberOfDTCByStatusMask."""
    return _number(c, _matching(c, rest[0]))


def _by_status(c: Context, rest: bytes) -> bytes:
    """02 reportDTCByStatusMask."""
    return _available(c) + _with_status(c, _matching(c, rest[0]))


def _snapshot_identification(c: Context, _rest: bytes) -> bytes:
    """03 reportDTCSnapshotIdentification."""
    return b"".join(
        bytes(entry.dtc) + bytes([number]) for entry in c.memory.supported() for number, _ in _frames(c, entry)
    )


def _frames(c: Context, entry: Entry) -> list[tuple[int, Identified]]:
    """Return the freeze frames of an entry that hold anything: number, identifiers with their bytes."""
    found = [(frame.number, c.identifiers.freeze_frame(frame.content)) for frame in entry.freeze_frames]
    return [(number, content) for number, content in found if content]


def _record(number: int, content: Identified) -> bytes:
    """Return a record of identifiers: its number, how many they are, each with its bytes."""
    return bytes([number]) + _content(content)


def _content(content: Identified) -> bytes:
    return bytes([len(content)]) + b"".join(did.to_bytes(2, "big") + data for did, data in content)


def _snapshot_by_dtc(c: Context, rest: bytes) -> bytes:
    """04 reportDTCSnapshotRecordByDTCNumber."""
    entry, record = _entry(c, rest[:3]), rest[3]
    most = c.memory.definition(entry.fault).freeze_frames
    refuse_unless(1 <= record <= most or record == ALL_RECORDS, Nrc.REQUEST_OUT_OF_RANGE)
    made = _with_status(c, [entry])
    for number, content in _frames(c, entry):
        if record in (number, ALL_RECORDS):
            made += _record(number, content)
    return made


def _stored_data(c: Context, rest: bytes) -> bytes:
    """05 reportDTCStoredDataByRecordNumber: the first freeze frames, numbered in the order of the failures."""
    record = rest[0]
    refuse_unless(1 <= record <= MOST_RECORDS or record == ALL_RECORDS, Nrc.REQUEST_OUT_OF_RANGE)
    frames = [(entry, frames[0][1]) for entry in c.memory.in_order("first_failed") if (frames := _frames(c, entry))]
    made = b"".join(
        bytes([number]) + _with_status(c, [entry]) + _content(content)
        for number, (entry, content) in enumerate(frames[:MOST_RECORDS], start=1)
        if record in (number, ALL_RECORDS)
    )
    return made or rest


def _extended_data(c: Context, rest: bytes) -> bytes:
    """06 reportDTCExtDataRecordByDTCNumber."""
    c.memory.fold_statistics()
    c.memory.commit()
    entry, record = _entry(c, rest[:3]), rest[3]
    refuse_unless(record in EXTENDED_DATA or record == ALL_RECORDS, Nrc.REQUEST_OUT_OF_RANGE)
    made = _with_status(c, [entry])
    if not entry.occurrence:
        return made
    for number, kind in EXTENDED_DATA.items():
        data = kind.encode(entry)
        if data and record in (number, ALL_RECORDS):
            made += bytes([number]) + data
    return made


def _extended_by_record(c: Context, rest: bytes) -> bytes:
    """16 reportDTCExtDataRecordByRecordNumber: one record of every DTC that has it."""
    c.memory.fold_statistics()
    c.memory.commit()
    made = rest
    for entry, data in _having(c, rest[0]):
        made += _with_status(c, [entry]) + data
    return made


def _having(c: Context, record: int) -> list[tuple[Entry, bytes]]:
    """Return the entries that have an extended data record, with its bytes."""
    refuse_unless(record in EXTENDED_DATA, Nrc.REQUEST_OUT_OF_RANGE)
    encode = EXTENDED_DATA[record].encode
    found = [(entry, encode(entry)) for entry in c.memory.supported() if entry.occurrence]
    return [(entry, data) for entry, data in found if data]


def _extended_identification(c: Context, rest: bytes) -> bytes:
    """1A reportDTCExtendedDataRecordIdentification: the DTCs that have a record."""
    return _available(c) + rest + _with_status(c, [entry for entry, _ in _having(c, rest[0])])


def _user_memory(c: Context, selection: int) -> InterventionMemory:
    refuse_unless(selection == SELECTION and c.trace_did is not None, Nrc.REQUEST_OUT_OF_RANGE)
    return InterventionMemory(c.memory.interventions(), c.trace_did or 0)


def _user_by_status(c: Context, rest: bytes) -> bytes:
    """17 reportUserDefMemoryDTCByStatusMask: what testers did."""
    mask, selection = rest
    memory = _user_memory(c, selection)
    found = memory.by_status(mask & c.params.status_mask)
    return bytes([selection]) + _available(c) + b"".join(bytes(dtc) + bytes([status]) for dtc, status in found)


def _user_dtc(c: Context, rest: bytes) -> tuple[InterventionMemory, Dtc, bytes]:
    """Return the memory, a DTC of it, and the answer's beginning."""
    memory, dtc = _user_memory(c, rest[4]), Dtc.from_bytes(rest[:3])
    status = memory.status(dtc)
    if status is None:
        raise NegativeError(Nrc.REQUEST_OUT_OF_RANGE)
    return memory, dtc, rest[4:] + bytes(dtc) + bytes([status & c.params.status_mask])


def _user_snapshot(c: Context, rest: bytes) -> bytes:
    """18 reportUserDefMemoryDTCSnapshotRecordByDTCNumber."""
    memory, dtc, made = _user_dtc(c, rest)
    refuse_unless(rest[3] != 0, Nrc.REQUEST_OUT_OF_RANGE)
    for number, content in memory.snapshots(dtc):
        if rest[3] in (number, ALL_RECORDS):
            made += _record(number, content)
    return made


def _user_extended_data(c: Context, rest: bytes) -> bytes:
    """19 reportUserDefMemoryDTCExtDataRecordByDTCNumber."""
    memory, dtc, made = _user_dtc(c, rest)
    records = memory.extended_data(dtc)
    refuse_unless(rest[3] in records or rest[3] == ALL_RECORDS, Nrc.REQUEST_OUT_OF_RANGE)
    for number, data in records.items():
        if rest[3] in (number, ALL_RECORDS):
            made += bytes([number]) + data
    return made


def _by_readiness_group(c: Context, rest: bytes) -> bytes:
    """56 reportDTCInformationByDTCReadinessGroupIdentifier: functional group, readiness group."""
    group, readiness = rest
    refuse_unless(readiness in READINESS_GROUPS, Nrc.REQUEST_OUT_OF_RANGE)
    name = READINESS_GROUPS[readiness]
    found = [
        entry
        for entry in _in_group(c, group, c.memory.supported())
        if c.memory.definition(entry.fault).readiness == name
    ]
    return bytes([group]) + _available(c) + bytes([WWH_FORMAT, readiness]) + _with_status(c, found)


def _by_severity(c: Context, severity: int, status: int) -> list[Entry]:
    return [entry for entry in _matching(c, status) if _severity(c, entry) & severity]


def _number_by_severity(c: Context, rest: bytes) -> bytes:
    """07 reportNumberOfDTCBySeverityMaskRecord."""
    return _number(c, _by_severity(c, rest[0], rest[1]))


def _with_severity(c: Context, entry: Entry) -> bytes:
    unit = c.memory.definition(entry.fault).functional_unit
    return bytes([_severity(c, entry), unit]) + _with_status(c, [entry])


def _by_severity_mask(c: Context, rest: bytes) -> bytes:
    """08 reportDTCBySeverityMaskRecord."""
    found = _by_severity(c, rest[0], rest[1])
    return _available(c) + b"".join(_with_severity(c, entry) for entry in found)


def _severity_of_dtc(c: Context, rest: bytes) -> bytes:
    """09 reportSeverityInformationOfDTC."""
    return _available(c) + _with_severity(c, _entry(c, rest))


def _supported(c: Context, _rest: bytes) -> bytes:
    """0A reportSupportedDTC."""
    return _available(c) + _with_status(c, c.memory.supported())


def _ordered(what: str, place: int) -> Report:
    """0B to 0E: the first or most recent DTC to fail, or to be confirmed, since the last clear."""

    def report(c: Context, _rest: bytes) -> bytes:
        return _available(c) + _with_status(c, c.memory.in_order(what)[place:][:1])

    return report


def _fault_detection_counters(c: Context, _rest: bytes) -> bytes:
    """14 reportDTCFaultDetectionCounter: those on their way, neither passed nor failed."""
    made = b""
    for entry in c.memory.supported():
        counter = c.control.fault_detection_counter(entry.fault)
        if 0 < counter < 127:
            made += bytes(entry.dtc) + bytes([counter])
    return made


def _permanent(c: Context) -> list[Entry]:
    faults = {permanent.fault for permanent in c.memory.permanent()}
    return sorted((c.memory.entry(fault) for fault in faults), key=lambda entry: entry.dtc)


def _permanent_status(c: Context, _rest: bytes) -> bytes:
    """15 reportDTCWithPermanentStatus."""
    return _available(c) + _with_status(c, _permanent(c))


def _in_group(c: Context, group: int, entries: Iterable[Entry]) -> list[Entry]:
    refuse_unless(group in (EMISSION_GROUP, ALL_GROUPS), Nrc.REQUEST_OUT_OF_RANGE)
    return [entry for entry in entries if group == ALL_GROUPS or c.memory.definition(entry.fault).emission_related]


def _wwh_by_mask(c: Context, rest: bytes) -> bytes:
    """42 reportWWHOBDDTCByMaskRecord: group, status mask, severity mask."""
    group, status, severity = rest
    found = _in_group(c, group, _by_severity(c, severity, status))
    made = bytes([group]) + _available(c) + bytes([SEVERITY_MASK, WWH_FORMAT])
    for entry in found:
        made += bytes([_severity(c, entry)]) + _with_status(c, [entry])
    return made


def _wwh_permanent(c: Context, rest: bytes) -> bytes:
    """55 reportWWHOBDDTCWithPermanentStatus: group."""
    found = _in_group(c, rest[0], _permanent(c))
    return rest + _available(c) + bytes([WWH_FORMAT]) + _with_status(c, found)


#: Sub-functions: how many bytes follow each, and what it reports.
REPORTS: dict[int, tuple[int, Report]] = {
    0x01: (1, _number_by_status),
    0x02: (1, _by_status),
    0x03: (0, _snapshot_identification),
    0x04: (4, _snapshot_by_dtc),
    0x05: (1, _stored_data),
    0x06: (4, _extended_data),
    0x07: (2, _number_by_severity),
    0x08: (2, _by_severity_mask),
    0x09: (3, _severity_of_dtc),
    0x0A: (0, _supported),
    0x0B: (0, _ordered("first_failed", 0)),
    0x0C: (0, _ordered("first_confirmed", 0)),
    0x0D: (0, _ordered("last_failed", -1)),
    0x0E: (0, _ordered("last_confirmed", -1)),
    0x14: (0, _fault_detection_counters),
    0x15: (0, _permanent_status),
    0x16: (1, _extended_by_record),
    0x17: (2, _user_by_status),
    0x18: (5, _user_snapshot),
    0x19: (5, _user_extended_data),
    0x1A: (1, _extended_identification),
    0x42: (3, _wwh_by_mask),
    0x55: (1, _wwh_permanent),
    0x56: (2, _by_readiness_group),
}


def _handle(c: Context, request: bytes) -> bytes:
    number = request[1] & 0x7F
    length, report = REPORTS[number]
    refuse_unless(len(request) == 2 + length, Nrc.INCORRECT_LENGTH)
    c.check_conditions()
    return bytes([number]) + report(c, request[2:])


SERVICE = Service(
    0x19,
    "ReadDTCInformation",
    _handle,
    lambda _: dict.fromkeys(REPORTS, ANY_SESSION),
    shortest=2,
    action="read_dtcs",
)
