"""The user-defined memory: interventions of testers."""

from __future__ import annotations

from gateway.faults.dtc import Dtc
from gateway.servers.uds.context import Context
from gateway.servers.uds.dtc_reports.common import ALL_RECORDS, available
from gateway.servers.uds.dtc_reports.records import record_of
from gateway.servers.uds.intervention_memory import SELECTION, InterventionMemory
from gateway.servers.uds.nrc import NegativeError, Nrc, refuse_unless


def _user_memory(c: Context, selection: int) -> InterventionMemory:
    refuse_unless(selection == SELECTION and c.trace_did is not None, Nrc.REQUEST_OUT_OF_RANGE)
    return InterventionMemory(c.memory.interventions(), c.trace_did or 0)


def user_by_status(c: Context, rest: bytes) -> bytes:
    """17 reportUserDefMemoryDTCByStatusMask: interventions of testers."""
    mask, selection = rest
    memory = _user_memory(c, selection)
    found = memory.by_status(mask & c.params.status_mask)
    return bytes([selection]) + available(c) + b"".join(bytes(dtc) + bytes([status]) for dtc, status in found)


def _user_dtc(c: Context, rest: bytes) -> tuple[InterventionMemory, Dtc, bytes]:
    """Return the memory, a DTC of it, and the answer's beginning."""
    memory, dtc = _user_memory(c, rest[4]), Dtc.from_bytes(rest[:3])
    status = memory.status(dtc)
    if status is None:
        raise NegativeError(Nrc.REQUEST_OUT_OF_RANGE)
    return memory, dtc, rest[4:] + bytes(dtc) + bytes([status & c.params.status_mask])


def user_snapshot(c: Context, rest: bytes) -> bytes:
    """18 reportUserDefMemoryDTCSnapshotRecordByDTCNumber."""
    memory, dtc, made = _user_dtc(c, rest)
    refuse_unless(rest[3] != 0, Nrc.REQUEST_OUT_OF_RANGE)
    for number, content in memory.snapshots(dtc):
        if rest[3] in (number, ALL_RECORDS):
            made += record_of(number, content)
    return made


def user_extended_data(c: Context, rest: bytes) -> bytes:
    """19 reportUserDefMemoryDTCExtDataRecordByDTCNumber."""
    memory, dtc, made = _user_dtc(c, rest)
    records = memory.extended_data(dtc)
    refuse_unless(rest[3] in records or rest[3] == ALL_RECORDS, Nrc.REQUEST_OUT_OF_RANGE)
    for number, data in records.items():
        if rest[3] in (number, ALL_RECORDS):
            made += bytes([number]) + data
    return made
